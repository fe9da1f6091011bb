/* Fault status and addresses: ARMv7-M architecture reference manual, B3.2.15 to B3.2.19. */
#include "fault.h"

#include <stddef.h>
#include <string.h>

#include "../../firmware/crc.h"
#include "plant.h"
#include "registers/core.h"
#include "registers/pwr.h"

#define MARK 0x4641554Cu /* RAM after a power-on has it, and the CRC too, once in 2^48 times */
#define EXCEPTION_RETURN 0xFFFFFFE0u
#define FRAME_WORDS 8u /* r0 to r3, r12, lr, pc, xPSR */
enum { FRAME_LR = 5, FRAME_PC = 6 };

typedef struct {
    uint32_t mark;
    uint32_t cause;
    wheel_processor_fault fault;
    uint32_t crc; /* over all before it */
} fault_record;

/* Nobody clears this memory. */
static fault_record record __attribute__((section(".noinit")));

/* Set by the linker script; only their addresses mean something. */
extern uint32_t stack_start[], stack_top[];

static uint32_t record_crc(void) {
    return wheel_crc16((const uint8_t *)&record, offsetof(fault_record, crc));
}

/* The registers lie on the stack where an exception has stacked them, and the stack has not left the RAM. */
static bool is_stacked(const uint32_t *stack, uint32_t link, uint32_t cfsr) {
    const uintptr_t at = (uintptr_t)stack;
    return (link & EXCEPTION_RETURN) == EXCEPTION_RETURN && (cfsr & SCB_CFSR_STACKING) == 0u &&
           at >= (uintptr_t)stack_start && at + 4u * FRAME_WORDS <= (uintptr_t)stack_top;
}

_Noreturn void fault_taken(const uint32_t *stack, uint32_t link) {
    plant_off();
    memset(&record, 0, sizeof record);
    if ((SCB_ICSR & SCB_ICSR_VECTACTIVE) == 16u + PVD_IRQ) {
        record.cause = WP_RESET_CAUSE_BROWN_OUT;
    } else {
        record.cause = WP_RESET_CAUSE_PROCESSOR_FAULT;
        record.fault =
            (wheel_processor_fault){.cfsr = SCB_CFSR, .hfsr = SCB_HFSR, .mmfar = SCB_MMFAR, .bfar = SCB_BFAR};
        if (is_stacked(stack, link, record.fault.cfsr)) {
            record.fault.lr = stack[FRAME_LR];
            record.fault.pc = stack[FRAME_PC];
        }
    }
    record.mark = MARK;
    record.crc = record_crc();
    barrier();
    SCB_AIRCR = SCB_AIRCR_RESET;
    for (;;) {
    }
}

bool fault_take(uint8_t *cause, wheel_processor_fault *fault) {
    const bool is_there = record.mark == MARK && record.crc == record_crc();
    if (is_there) {
        *cause = (uint8_t)record.cause;
        *fault = record.fault;
    }
    record.mark = 0;
    return is_there;
}
