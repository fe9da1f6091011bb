/* A serial line: frames to bytes, and bytes to frames. PROTOCOL.md, "Serial framing". Frames are packed one
 * after the other: id16 little-endian, length8, payload.
 */
#ifndef WHEEL_LINE_H
#define WHEEL_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../firmware/framing.h"

#ifdef __cplusplus
extern "C" {
#endif

/* cffi: begin */
/* Both directions of a line. */
typedef struct wheel_line wheel_line;

/* Frames that were received, and what was dropped, by cause. */
typedef struct {
    uint32_t frames;
    uint32_t lost; /* missing in the sender's count */
    uint32_t cobs;
    uint32_t crc;
    uint32_t length;
    uint32_t unknown_id;
    uint32_t overrun;
} wheel_line_counts;

size_t wheel_line_size(void);
void wheel_line_init(wheel_line *line);

/* Takes bytes in pieces of any size and packs the frames that they complete; returns their number.
 * `packed` has room for `length` bytes and WHEEL_LINE_OPEN more; `*used` becomes how many were written. */
size_t wheel_line_feed(wheel_line *line, const uint8_t *bytes, size_t length, uint8_t *packed, size_t *used);
#define WHEEL_LINE_OPEN 16

/* Writes packed frames as bytes of the line, each numbered and with its zero; an ESTOP begins with a zero
 * too. Returns the number of bytes, at most WHEEL_LINE_GROWTH times `length`; 0, with nothing numbered, if a
 * frame is cut or its length is not its id's. */
size_t wheel_line_encode(wheel_line *line, const uint8_t *packed, size_t length, uint8_t *out);
#define WHEEL_LINE_GROWTH 3

/* Copies packed frames in two groups, each in its order: those with an id below `limit`, then the others.
 * Returns where the others begin; `*used` becomes how many bytes were written, at most `length`. A frame that
 * is cut is not copied. `out` has room for `length` bytes. */
size_t wheel_packed_split(const uint8_t *packed, size_t length, uint16_t limit, uint8_t *out, size_t *used);

void wheel_line_count(const wheel_line *line, wheel_line_counts *counts);
/* cffi: end */

/* Complete here so that it can be a variable or a member. */
struct wheel_line {
    wheel_deframer deframer;
    uint8_t sequence;
};

#ifdef __cplusplus
}
#endif

#endif
