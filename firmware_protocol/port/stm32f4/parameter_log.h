/* Parameters that survive a reset and a power cut at any moment: a log over two flash sectors.
 *
 * A record is 128 bytes: what the core stores, and as its last three words a CRC-16 over that, a sequence
 * number and the number's complement, programmed when the rest is in place. Each STORE appends one; the
 * newest whole one counts. What is not needed any more is erased when the robot starts. One that stores more
 * than a thousand times without a reset erases once in so many, before the record is written: the core stands
 * still for up to 2 s then, with the drives off, as a STORE is done in IDLE alone.
 */
#ifndef STM32F4_PARAMETER_LOG_H
#define STM32F4_PARAMETER_LOG_H

#include <stdbool.h>
#include <stdint.h>

#include "../../firmware/parameters.h"

/* Returns the newest stored bytes, WHEEL_STORED_SIZE of them, or NULL when there are none. Erases what is not
 * needed any more, which takes up to 4 s. */
const uint8_t *parameter_log_open(void);

/* True when the next record needs an erasure first, which takes up to 2 s. */
bool parameter_log_is_full(void);

/* True when the bytes are kept. */
bool parameter_log_append(const uint8_t bytes[WHEEL_STORED_SIZE]);

#endif
