/* The programmable voltage detector (RM0090, 5.2.3). Its interrupt is fault() in the vector table, which
 * leaves a record of it. */
#include "supply.h"

#include "registers/core.h"
#include "registers/pwr.h"
#include "registers/rcc.h"

void supply_open(void) {
    clock_enable(&RCC->APB1ENR, RCC_APB1ENR_PWR);
    PWR->CR = (PWR->CR & ~PWR_CR_PLS_MASK) | PWR_CR_PLS_2V8 | PWR_CR_PVDE;
    while ((PWR->CSR & PWR_CSR_PVDO) != 0u) { /* for longer than the watchdog allows, it begins anew */
    }
    EXTI->RTSR |= EXTI_PVD; /* the detector's output rises when the supply sinks */
    EXTI->PR = EXTI_PVD;
    EXTI->IMR |= EXTI_PVD;
    interrupt_enable(PVD_IRQ);
}
