#include "watchdog.h"

#include "registers/iwdg.h"

void watchdog_set(uint32_t limit_ms) {
    IWDG->KR = IWDG_KR_START; /* first, because it starts the oscillator that the two updates need */
    IWDG->KR = IWDG_KR_UNLOCK;
    IWDG->PR = IWDG_PR_DIV32; /* 1 ms a count */
    IWDG->RLR = limit_ms < IWDG_RLR_MAX ? limit_ms : IWDG_RLR_MAX;
    while (IWDG->SR != 0u) { /* the updates take some periods of that oscillator */
    }
    watchdog_feed();
}

void watchdog_feed(void) {
    IWDG->KR = IWDG_KR_RELOAD;
}
