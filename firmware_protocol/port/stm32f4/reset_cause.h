/* Why the chip was reset, for STATUS.reset_cause. */
#ifndef STM32F4_RESET_CAUSE_H
#define STM32F4_RESET_CAUSE_H

#include "clock.h"

/* Returns WP_RESET_CAUSE_..., and removes the chip's flags: the next reset sets its own. */
uint8_t reset_cause_take(const clock_tree *clocks);

#endif
