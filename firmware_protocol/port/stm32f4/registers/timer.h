/* Timers 1 to 5 and 8 (RM0090, sections 17.4 and 18.4). */
#ifndef STM32F4_REGISTERS_TIMER_H
#define STM32F4_REGISTERS_TIMER_H

#include <stdint.h>

typedef struct {
    volatile uint32_t CR1;  /* 00 */
    volatile uint32_t CR2;  /* 04 */
    volatile uint32_t SMCR; /* 08 */
    volatile uint32_t DIER; /* 0C */
    volatile uint32_t SR;   /* 10 */
    volatile uint32_t EGR;  /* 14 */
    volatile uint32_t CCMR[2];
    volatile uint32_t CCER; /* 20, four bits a channel */
    volatile uint32_t CNT;  /* 24 */
    volatile uint32_t PSC;  /* 28 */
    volatile uint32_t ARR;  /* 2C */
    volatile uint32_t RCR;  /* 30 */
    volatile uint32_t CCR[4];
    volatile uint32_t BDTR; /* 44, timers 1 and 8 only */
} timer_registers;

#define TIM1 ((timer_registers *)0x40010000u)
#define TIM2 ((timer_registers *)0x40000000u)
#define TIM3 ((timer_registers *)0x40000400u)
#define TIM4 ((timer_registers *)0x40000800u)
#define TIM5 ((timer_registers *)0x40000C00u)
#define TIM8 ((timer_registers *)0x40010400u)

#define TIMER_CR1_CEN (1u << 0)
#define TIMER_CR1_CENTRE (1u << 5) /* up and down; compare flags while counting down */
#define TIMER_CR1_ARPE (1u << 7)
#define TIMER_SMCR_ENCODER 3u  /* counts every edge of both inputs */
#define TIMER_SR_BIF (1u << 7) /* a break has switched the outputs off */
#define TIMER_EGR_UG (1u << 0)
#define TIMER_CCMR_PWM1 (6u << 4) /* of a channel, to be shifted by 8 for the second of a register */
#define TIMER_CCMR_PRELOAD (1u << 3)
#define TIMER_CCMR_INPUT 1u
#define TIMER_CCMR_FILTER(x) ((uint32_t)(x) << 4)
#define TIMER_CCER_E 1u
#define TIMER_CCER_P 2u
#define TIMER_CCER_NE 4u
#define TIMER_BDTR_LOCK1 (1u << 8) /* dead time, idle levels and break stay as they are until a reset */
#define TIMER_BDTR_OSSI (1u << 10) /* with the outputs off, the pins are driven to their idle level: low */
/* Outputs off at a break: when the crystal fails, and at a high level of a pin BKIN, which is low where no
 * pin is one. */
#define TIMER_BDTR_BREAK ((1u << 12) | (1u << 13))
#define TIMER_BDTR_MOE (1u << 15) /* outputs on */

#endif
