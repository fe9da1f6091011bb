/* 168 MHz from the board's crystal. A crystal that does not start ends in the watchdog's reset: without it
 * neither the serial rate nor CAN's bit timing would hold. */
#include "board.h"
#include "clock.h"
#include "registers/flash.h"
#include "registers/rcc.h"

clock_tree clock_init(void) {
    const board_oscillator *o = &BOARD.oscillator;
    RCC->CR |= RCC_CR_HSEON;
    while ((RCC->CR & RCC_CR_HSERDY) == 0u) {
    }
    RCC->CR |= RCC_CR_CSSON; /* a crystal that fails later ends in fault(), with the motors off */
    /* 5 wait states for 168 MHz from 2.7 V on (RM0090, table 10). */
    FLASH->ACR = FLASH_ACR_LATENCY(5) | FLASH_ACR_PRFTEN | FLASH_ACR_ICEN | FLASH_ACR_DCEN;
    while ((FLASH->ACR & FLASH_ACR_LATENCY_MASK) != FLASH_ACR_LATENCY(5)) {
    }
    RCC->CFGR = RCC_CFGR_PPRE1_DIV4 | RCC_CFGR_PPRE2_DIV2;
    RCC->PLLCFGR = (RCC->PLLCFGR & RCC_PLLCFGR_RESERVED) | RCC_PLLCFGR_M(o->divider) |
                   RCC_PLLCFGR_N(o->multiplier) | RCC_PLLCFGR_P2 | RCC_PLLCFGR_HSE | RCC_PLLCFGR_Q(7);
    RCC->CR |= RCC_CR_PLLON;
    while ((RCC->CR & RCC_CR_PLLRDY) == 0u) {
    }
    RCC->CFGR |= RCC_CFGR_SW_PLL;
    while ((RCC->CFGR & RCC_CFGR_SWS) != RCC_CFGR_SWS_PLL) {
    }
    return (clock_tree){.core_hz = 168000000u, .apb1_hz = 42000000u, .apb2_hz = 84000000u};
}
