/* From reset to main, and the vector table (RM0090, table 62). */
#include <stdint.h>
#include <string.h>

#include "fault.h"
#include "interrupts.h"
#include "registers/can.h"
#include "registers/core.h"
#include "registers/usart.h"

/* Set by the linker script; only their addresses mean something. */
extern uint32_t stack_top[];
extern unsigned char data_load[], data_start[], data_end[], bss_start[], bss_end[];

int main(void);
void reset(void);

/* Begins a new stack: the old one may have left the RAM, which is how an overflow ends up here. */
__attribute__((naked)) void fault(void) {
    __asm volatile("mov r0, sp\n\tmov r1, lr\n\tldr r2, =stack_top\n\tmov sp, r2\n\tb fault_taken");
}

#define UNLESS_DEFINED __attribute__((weak, alias("fault")))
UNLESS_DEFINED void usart1_interrupt(void);
UNLESS_DEFINED void usart2_interrupt(void);
UNLESS_DEFINED void usart3_interrupt(void);
UNLESS_DEFINED void uart4_interrupt(void);
UNLESS_DEFINED void uart5_interrupt(void);
UNLESS_DEFINED void usart6_interrupt(void);
UNLESS_DEFINED void can1_transmit_interrupt(void);
UNLESS_DEFINED void can1_receive_interrupt(void);
UNLESS_DEFINED void can1_status_interrupt(void);

typedef void (*handler)(void);

typedef struct {
    uint32_t *stack;
    handler exception[15]; /* from reset on */
    handler interrupt[82];
} vector_table;

static const vector_table vectors;

void reset(void) {
    SCB_VTOR = (uint32_t)(uintptr_t)&vectors; /* a boot loader leaves its own */
    SCB_CPACR |= SCB_CPACR_FPU;
    barrier();
    memcpy(data_start, data_load, (size_t)(data_end - data_start));
    memset(bss_start, 0, (size_t)(bss_end - bss_start));
    (void)main();
    fault();
}

__attribute__((section(".vectors"), used)) static const vector_table vectors = {
    .stack = stack_top,
    .exception = {[0] = reset, [1 ... 13] = fault, [14] = systick_interrupt},
    .interrupt =
        {
            [0 ... 18] = fault,
            [CAN1_TX_IRQ] = can1_transmit_interrupt,
            [CAN1_RX0_IRQ] = can1_receive_interrupt,
            [21] = fault,
            [CAN1_SCE_IRQ] = can1_status_interrupt,
            [23 ... 36] = fault,
            [USART1_IRQ] = usart1_interrupt,
            [USART2_IRQ] = usart2_interrupt,
            [USART3_IRQ] = usart3_interrupt,
            [40 ... 51] = fault,
            [UART4_IRQ] = uart4_interrupt,
            [UART5_IRQ] = uart5_interrupt,
            [54 ... 70] = fault,
            [USART6_IRQ] = usart6_interrupt,
            [72 ... 81] = fault,
        },
};
