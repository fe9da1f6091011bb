/* A counter of 32 bits, as an encoder's. */
#ifndef PLANT_COUNTER_H
#define PLANT_COUNTER_H

#include <stdint.h>

#include "hidden.h"

HIDDEN_BEGIN

/* Rounds down and wraps. Past 2^53 a double no longer tells one count from the next, and the counter stands
 * still. */
int32_t plant_counter(double value);

HIDDEN_END

#endif
