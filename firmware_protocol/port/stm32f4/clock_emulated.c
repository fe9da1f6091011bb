/* In an emulator no oscillator ever gets ready, and real time means nothing: STEP makes robot time pass. */
#include "clock.h"
#include "registers/rcc.h"

clock_tree clock_init(void) {
    return (clock_tree){.core_hz = 168000000u,
                        .apb1_hz = 42000000u,
                        .apb2_hz = 84000000u,
                        .lockstep = true,
                        .assumed_reset_flags = RCC_CSR_PORRSTF};
}
