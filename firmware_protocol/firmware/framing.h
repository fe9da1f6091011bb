/* Serial framing: COBS(id16 LE | sequence8 | payload | CRC16-CCITT-FALSE LE) 00. PROTOCOL.md explains it. The
 * host's end, client/wheel_line.h, is made of it; framing.py is another implementation, which shares nothing
 * with it. */
#ifndef WHEEL_FRAMING_H
#define WHEEL_FRAMING_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../generated/wheel_messages.h"
#include "cobs.h"

#ifdef __cplusplus
extern "C" {
#endif

/* id, sequence, payload, CRC */
#define WHEEL_FRAME_BODY_MAX (2u + 1u + WP_PAYLOAD_MAX + 2u)
/* Bytes on the wire of the longest frame, with the zero: 15. */
#define WHEEL_FRAME_MAX (WHEEL_COBS_MAX(WHEEL_FRAME_BODY_MAX) + 1u)

typedef struct {
    uint16_t id;
    uint8_t length;
    uint8_t payload[WP_PAYLOAD_MAX];
} wheel_frame;

typedef struct {
    uint8_t buffer[WHEEL_FRAME_MAX - 1u];
    uint8_t length;
    bool overrun;      /* the open frame was too long and is dropped up to its zero */
    bool synchronised; /* a frame was received, next_sequence holds */
    uint8_t next_sequence;

    uint32_t frames; /* handed out */
    uint32_t lost;   /* missing in the sender's count */

    /* Dropped frames by cause. */
    uint32_t cobs;
    uint32_t crc;
    uint32_t length_errors; /* not the length that the id asks for, or too short for a frame */
    uint32_t unknown_id;
    uint32_t overruns; /* more bytes without a zero than the longest frame has */
} wheel_deframer;

void wheel_deframer_init(wheel_deframer *deframer);

/* Takes one byte, whatever it is; true when it completes a valid frame. */
bool wheel_deframer_feed(wheel_deframer *deframer, uint8_t byte, wheel_frame *frame);

/* Takes bytes from `*at` on, up to the end of the first valid frame, or all; `*at` is then behind them. True
 * when there was such a frame. */
bool wheel_deframer_take(wheel_deframer *deframer, const uint8_t *bytes, size_t length, size_t *at,
                         wheel_frame *frame);

/* Writes a frame with its zero and returns the number of bytes; 0 when the length is not the id's.
 * `sequence` counts the frames that this line has sent, wrapping. `out` holds WHEEL_FRAME_MAX bytes. */
size_t wheel_frame_encode(const wheel_frame *frame, uint8_t sequence, uint8_t *out);

#ifdef __cplusplus
}
#endif

#endif
