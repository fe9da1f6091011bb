/* Frames one after the other, as they travel between the functions of the host's end: id16 LE, length8,
 * payload. */
#ifndef WHEEL_PACKED_H
#define WHEEL_PACKED_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WHEEL_PACKED_HEADER 3u

typedef struct {
    uint16_t id;
    uint8_t length;
    const uint8_t *payload;
    size_t next; /* where the next one begins */
} wheel_packed;

/* Takes the packed frame that begins at `at`; false where none does that is whole. */
static inline bool wheel_packed_take(const uint8_t *packed, size_t at, size_t end, wheel_packed *frame) {
    if (at + WHEEL_PACKED_HEADER > end) {
        return false;
    }
    frame->id = (uint16_t)(packed[at] | (packed[at + 1u] << 8));
    frame->length = packed[at + 2u];
    frame->payload = packed + at + WHEEL_PACKED_HEADER;
    frame->next = at + WHEEL_PACKED_HEADER + frame->length;
    return frame->next <= end;
}

#endif
