/* The clock tree. clock_init is what differs between a build for a chip and one for an emulator, and nothing
 * else does: clock_crystal.c or clock_emulated.c.
 */
#ifndef STM32F4_CLOCK_H
#define STM32F4_CLOCK_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    uint32_t core_hz;
    uint32_t apb1_hz;
    uint32_t apb2_hz;
    bool lockstep;                /* robot time comes from STEP, not from this clock */
    uint32_t assumed_reset_flags; /* of RCC_CSR, where none is set: an emulator may not keep them */
} clock_tree;

clock_tree clock_init(void);

#endif
