/* Four quadrature encoders, each counted by a timer of its own. */
#ifndef STM32F4_ENCODERS_H
#define STM32F4_ENCODERS_H

#include <stdint.h>

void encoders_open(void);

/* Counts of FL, FR, RR, RL, wrapping: four a line of the encoder. */
void encoders_read(uint16_t count[4]);

#endif
