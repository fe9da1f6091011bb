/* Real time since the start, from SysTick. Read it from the main loop only. */
#ifndef STM32F4_UPTIME_H
#define STM32F4_UPTIME_H

#include <stdint.h>

void uptime_start(uint32_t core_hz);

/* Both wrap at 2^32. */
uint32_t uptime_ms(void);
uint32_t uptime_us(void);

#endif
