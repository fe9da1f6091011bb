#include "uptime.h"

#include "interrupts.h"
#include "registers/core.h"

static volatile uint32_t milliseconds;

void uptime_start(uint32_t core_hz) {
    SYSTICK->LOAD = core_hz / 1000u - 1u;
    SYSTICK->VAL = 0;
    SYSTICK->CTRL = SYSTICK_ENABLE | SYSTICK_INTERRUPT | SYSTICK_CORE_CLOCK;
}

void systick_interrupt(void) {
    milliseconds++;
}

uint32_t uptime_ms(void) {
    return milliseconds;
}

uint32_t uptime_us(void) {
    uint32_t ms;
    uint32_t left;
    do { /* SysTick counts down and wraps with its interrupt */
        ms = milliseconds;
        left = SYSTICK->VAL;
    } while (ms != milliseconds);
    const uint32_t period = SYSTICK->LOAD + 1u;
    return ms * 1000u + (period - 1u - left) * 1000u / period;
}
