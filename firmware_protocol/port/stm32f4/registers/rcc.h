/* Reset and clock control (RM0090, section 7.3). */
#ifndef STM32F4_REGISTERS_RCC_H
#define STM32F4_REGISTERS_RCC_H

#include <stdint.h>

typedef struct {
    volatile uint32_t CR;      /* 00 */
    volatile uint32_t PLLCFGR; /* 04 */
    volatile uint32_t CFGR;    /* 08 */
    volatile uint32_t reserved_0c[9];
    volatile uint32_t AHB1ENR; /* 30 */
    volatile uint32_t reserved_34[3];
    volatile uint32_t APB1ENR; /* 40 */
    volatile uint32_t APB2ENR; /* 44 */
    volatile uint32_t reserved_48[10];
    volatile uint32_t BDCR; /* 70 */
    volatile uint32_t CSR;  /* 74 */
} rcc_registers;

#define RCC ((rcc_registers *)0x40023800u)

/* Reading back lets two bus cycles pass, which a peripheral needs before it answers (errata, 2.1.13). */
static inline void clock_enable(volatile uint32_t *enable_register, uint32_t bits) {
    *enable_register |= bits;
    (void)*enable_register;
}

#define RCC_CR_HSEON (1u << 16)
#define RCC_CR_HSERDY (1u << 17)
#define RCC_CR_CSSON (1u << 19) /* NMI and a timer's break when the crystal fails */
#define RCC_CR_PLLON (1u << 24)
#define RCC_CR_PLLRDY (1u << 25)

#define RCC_PLLCFGR_RESERVED 0xF0BC8000u /* "must be kept at reset value" */
#define RCC_PLLCFGR_M(x) ((uint32_t)(x) << 0)
#define RCC_PLLCFGR_N(x) ((uint32_t)(x) << 6)
#define RCC_PLLCFGR_P2 (0u << 16) /* the system clock is half of the oscillator's */
#define RCC_PLLCFGR_HSE (1u << 22)
#define RCC_PLLCFGR_Q(x) ((uint32_t)(x) << 24)

#define RCC_CFGR_SW_PLL (2u << 0)
#define RCC_CFGR_SWS (3u << 2)
#define RCC_CFGR_SWS_PLL (2u << 2)
#define RCC_CFGR_PPRE1_DIV4 (5u << 10)
#define RCC_CFGR_PPRE2_DIV2 (4u << 13)

#define RCC_AHB1ENR_GPIO(port) (1u << (port)) /* A is 0 */
#define RCC_AHB1ENR_DMA2 (1u << 22)
#define RCC_APB1ENR_TIM(number) (1u << ((number) - 2u)) /* 2 to 5 */
#define RCC_APB1ENR_USART2 (1u << 17)
#define RCC_APB1ENR_USART3 (1u << 18)
#define RCC_APB1ENR_UART4 (1u << 19)
#define RCC_APB1ENR_UART5 (1u << 20)
#define RCC_APB1ENR_CAN1 (1u << 25)
#define RCC_APB1ENR_PWR (1u << 28)
#define RCC_APB2ENR_TIM1 (1u << 0)
#define RCC_APB2ENR_TIM8 (1u << 1)
#define RCC_APB2ENR_USART1 (1u << 4)
#define RCC_APB2ENR_USART6 (1u << 5)
#define RCC_APB2ENR_ADC1 (1u << 8)

/* Why the chip was reset; they stay until they are removed. PIN is set by every reset but a low-power one, as
 * the chip pulls the pin itself. */
#define RCC_CSR_RMVF (1u << 24)
#define RCC_CSR_BORRSTF (1u << 25) /* by a power-on too */
#define RCC_CSR_PINRSTF (1u << 26)
#define RCC_CSR_PORRSTF (1u << 27)
#define RCC_CSR_SFTRSTF (1u << 28)
#define RCC_CSR_IWDGRSTF (1u << 29)
#define RCC_CSR_WWDGRSTF (1u << 30)
#define RCC_CSR_LPWRRSTF (1u << 31)

#endif
