/* Pins: the only code that writes the registers of a GPIO port. */
#ifndef STM32F4_PINS_H
#define STM32F4_PINS_H

#include <stdbool.h>

#include "board.h"

/* Hands a pin to its peripheral, pulled up while nothing drives it: an idle serial line or CAN bus is high.
 */
void pin_to_peripheral(pin which);

/* Hands a pin to a timer that drives a bridge, pulled down: while nothing drives it, the bridge is off. */
void pin_to_bridge(pin which);

void pin_to_analog(pin which);

/* Makes a pin an output that is low. */
void pin_output(pin which);
void pin_write(pin which, bool high);

/* Whether an output is high. */
bool pin_is_high(pin which);

#endif
