/* The independent watchdog: resets the chip when it is not fed in time. Once started it cannot be stopped. */
#ifndef STM32F4_WATCHDOG_H
#define STM32F4_WATCHDOG_H

#include <stdint.h>

/* Starts it, or changes its limit. Its oscillator gives 17 to 47 kHz for a nominal 32 kHz (data sheet, table
 * 42), so that it bites after 0.7 to 1.9 times the limit; at most 4095 ms. */
void watchdog_set(uint32_t limit_ms);
void watchdog_feed(void);

#endif
