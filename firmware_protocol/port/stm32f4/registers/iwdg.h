/* Independent watchdog (RM0090, section 21.4). */
#ifndef STM32F4_REGISTERS_IWDG_H
#define STM32F4_REGISTERS_IWDG_H

#include <stdint.h>

typedef struct {
    volatile uint32_t KR;  /* 00 */
    volatile uint32_t PR;  /* 04 */
    volatile uint32_t RLR; /* 08 */
    volatile uint32_t SR;  /* 0C */
} iwdg_registers;

#define IWDG ((iwdg_registers *)0x40003000u)

#define IWDG_KR_START 0xCCCCu
#define IWDG_KR_RELOAD 0xAAAAu
#define IWDG_KR_UNLOCK 0x5555u
#define IWDG_PR_DIV32 3u
#define IWDG_RLR_MAX 0xFFFu

#endif
