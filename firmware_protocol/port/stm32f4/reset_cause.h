/* Why the chip was reset, for STATUS.reset_cause. */
#ifndef STM32F4_RESET_CAUSE_H
#define STM32F4_RESET_CAUSE_H

#include "clock.h"
#include "fault.h"

/* Returns WP_RESET_CAUSE_..., and what the fault was if it was one. Removes the chip's flags and the record
 * of the fault: the next reset has its own. */
uint8_t reset_cause_take(const clock_tree *clocks, wheel_processor_fault *fault);

#endif
