/* General-purpose I/O (RM0090, section 8.4). */
#ifndef STM32F4_REGISTERS_GPIO_H
#define STM32F4_REGISTERS_GPIO_H

#include <stdint.h>

typedef struct {
    volatile uint32_t MODER;   /* 00, two bits a pin */
    volatile uint32_t OTYPER;  /* 04 */
    volatile uint32_t OSPEEDR; /* 08, two bits a pin */
    volatile uint32_t PUPDR;   /* 0C, two bits a pin */
    volatile uint32_t IDR;     /* 10 */
    volatile uint32_t ODR;     /* 14 */
    volatile uint32_t BSRR;    /* 18, set by the low half, reset by the high half */
    volatile uint32_t LCKR;    /* 1C */
    volatile uint32_t AFR[2];  /* 20, four bits a pin */
} gpio_registers;

/* Ports A to I are 0 to 8. */
#define GPIO(port) ((gpio_registers *)(0x40020000u + 0x400u * (uint32_t)(port)))

enum { GPIO_MODE_OUTPUT = 1, GPIO_MODE_ALTERNATE = 2, GPIO_MODE_ANALOG = 3 };
enum { GPIO_PULL_UP = 1, GPIO_PULL_DOWN = 2 };
#define GPIO_SPEED_HIGH 2u

#endif
