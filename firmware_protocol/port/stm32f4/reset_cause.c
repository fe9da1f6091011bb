/* The reset flags (RM0090, 7.3.21). One reset may set several: the most particular one tells. What a fault
 * has left is more particular than any: its reset is one by software, or by the watchdog where that came
 * first. */
#include "reset_cause.h"

#include <stddef.h>

#include "../../generated/wheel_messages.h"
#include "registers/rcc.h"

static const struct {
    uint32_t flags;
    uint8_t cause;
} causes[] = {
    {RCC_CSR_IWDGRSTF | RCC_CSR_WWDGRSTF, WP_RESET_CAUSE_WATCHDOG},
    {RCC_CSR_SFTRSTF, WP_RESET_CAUSE_SOFTWARE},
    {RCC_CSR_LPWRRSTF, WP_RESET_CAUSE_LOW_POWER},
    {RCC_CSR_PORRSTF, WP_RESET_CAUSE_POWER_ON},
    {RCC_CSR_BORRSTF, WP_RESET_CAUSE_BROWN_OUT},
    {RCC_CSR_PINRSTF, WP_RESET_CAUSE_PIN},
};

static uint8_t cause_of(uint32_t flags) {
    for (size_t i = 0; i < sizeof causes / sizeof causes[0]; i++) {
        if ((flags & causes[i].flags) != 0u) {
            return causes[i].cause;
        }
    }
    return WP_RESET_CAUSE_UNKNOWN; /* a boot loader may have removed them */
}

uint8_t reset_cause_take(const clock_tree *clocks, wheel_processor_fault *fault) {
    uint8_t cause = cause_of(RCC->CSR);
    RCC->CSR |= RCC_CSR_RMVF;
    if (!fault_take(&cause, fault) && cause == WP_RESET_CAUSE_UNKNOWN) {
        cause = cause_of(clocks->assumed_reset_flags);
    }
    return cause;
}
