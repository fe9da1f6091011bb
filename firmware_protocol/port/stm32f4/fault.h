/* What the core leaves of a fault: a record that is kept over the reset. */
#ifndef STM32F4_FAULT_H
#define STM32F4_FAULT_H

#include <stdbool.h>
#include <stdint.h>

#include "../../firmware/node.h"

/* The end of every exception that nobody handles, with the registers that fault() finds: switches the motors
 * off, leaves a record, and resets the chip. */
_Noreturn void fault_taken(const uint32_t *stack, uint32_t link);

/* Returns true, with the cause of the reset, when a record is there; it is gone then. `fault` stays zero
 * where it was no fault of the processor. */
bool fault_take(uint8_t *cause, wheel_processor_fault *fault);

#endif
