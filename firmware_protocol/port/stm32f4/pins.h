/* Pins: the only code that writes the registers of a GPIO port. */
#ifndef STM32F4_PINS_H
#define STM32F4_PINS_H

#include <stdbool.h>

#include "board.h"

/* Hands a pin to its peripheral, pulled up while nothing drives it: an idle serial line or CAN bus is high.
 */
void pin_to_peripheral(pin which);

#endif
