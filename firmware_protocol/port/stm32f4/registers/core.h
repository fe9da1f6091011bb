/* Cortex-M4 system registers (ARMv7-M architecture reference manual, B3.2 to B3.4). */
#ifndef STM32F4_REGISTERS_CORE_H
#define STM32F4_REGISTERS_CORE_H

#include <stdint.h>

typedef struct {
    volatile uint32_t CTRL;
    volatile uint32_t LOAD;
    volatile uint32_t VAL;
} systick_registers;

#define SYSTICK ((systick_registers *)0xE000E010u)
#define SYSTICK_ENABLE (1u << 0)
#define SYSTICK_INTERRUPT (1u << 1)
#define SYSTICK_CORE_CLOCK (1u << 2)

/* Interrupt set-enable, 32 a word. */
#define NVIC_ISER ((volatile uint32_t *)0xE000E100u)

/* Where the vector table lies. */
#define SCB_VTOR (*(volatile uint32_t *)0xE000ED08u)

/* Coprocessor access: full access to CP10 and CP11 is the floating-point unit. */
#define SCB_CPACR (*(volatile uint32_t *)0xE000ED88u)
#define SCB_CPACR_FPU (0xFu << 20)

/* The exception that is being handled; 16 and more are interrupts. */
#define SCB_ICSR (*(volatile uint32_t *)0xE000ED04u)
#define SCB_ICSR_VECTACTIVE 0x1FFu

#define SCB_AIRCR (*(volatile uint32_t *)0xE000ED0Cu)
#define SCB_AIRCR_RESET 0x05FA0004u /* with its key */

/* Fault status and addresses. */
#define SCB_CFSR (*(volatile uint32_t *)0xE000ED28u)
#define SCB_CFSR_STACKING ((1u << 4) | (1u << 12)) /* the stack could not be written: MSTKERR, STKERR */
#define SCB_HFSR (*(volatile uint32_t *)0xE000ED2Cu)
#define SCB_MMFAR (*(volatile uint32_t *)0xE000ED34u)
#define SCB_BFAR (*(volatile uint32_t *)0xE000ED38u)

static inline void interrupt_enable(uint8_t number) {
    NVIC_ISER[number / 32u] = 1u << (number % 32u);
}

static inline void interrupts_off(void) {
    __asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void) {
    __asm volatile("cpsie i" ::: "memory");
}

/* Sleeps until an interrupt is pending, also while interrupts are off. */
static inline void wait_for_interrupt(void) {
    __asm volatile("dsb\n\twfi" ::: "memory");
}

static inline void barrier(void) {
    __asm volatile("dsb\n\tisb" ::: "memory");
}

#endif
