#include "wheel_line.h"

#include "packed.h"

#include <string.h>

_Static_assert(WHEEL_LINE_OPEN >= WHEEL_FRAME_MAX, "what is open may be a whole frame but its zero");
/* id, sequence, CRC, what COBS adds, the zero, and that of an ESTOP; packed it is id and length */
_Static_assert(WHEEL_LINE_GROWTH *WHEEL_PACKED_HEADER >= 2u + 1u + 2u + 1u + 1u + 1u, "an empty frame");

size_t wheel_line_size(void) {
    return sizeof(wheel_line);
}

void wheel_line_init(wheel_line *line) {
    wheel_deframer_init(&line->deframer);
    line->sequence = 0;
}

size_t wheel_line_feed(wheel_line *line, const uint8_t *bytes, size_t length, uint8_t *packed, size_t *used) {
    wheel_frame frame;
    size_t count = 0;
    size_t at = 0;
    uint8_t *out = packed;
    while (wheel_deframer_take(&line->deframer, bytes, length, &at, &frame)) {
        out[0] = (uint8_t)(frame.id & 0xFFu);
        out[1] = (uint8_t)(frame.id >> 8);
        out[2] = frame.length;
        memcpy(out + WHEEL_PACKED_HEADER, frame.payload, frame.length);
        out += WHEEL_PACKED_HEADER + frame.length;
        count++;
    }
    *used = (size_t)(out - packed);
    return count;
}

size_t wheel_line_encode(wheel_line *line, const uint8_t *packed, size_t length, uint8_t *out) {
    wheel_packed next;
    size_t written = 0;
    size_t at = 0;
    while (wheel_packed_take(packed, at, length, &next) && wp_payload_length(next.id) == (int)next.length) {
        at = next.next;
    }
    if (at != length) {
        return 0;
    }
    for (at = 0; wheel_packed_take(packed, at, length, &next); at = next.next) {
        wheel_frame frame = {.id = next.id, .length = next.length};
        memcpy(frame.payload, next.payload, next.length);
        /* An emergency stop is not to be lost behind half a frame that the line still holds. */
        if (next.id == WP_ESTOP_ID) {
            out[written++] = 0;
        }
        written += wheel_frame_encode(&frame, line->sequence++, out + written);
    }
    return written;
}

static size_t copy_group(const uint8_t *packed, size_t length, uint16_t limit, bool below, uint8_t *out) {
    wheel_packed frame;
    size_t written = 0;
    for (size_t at = 0; wheel_packed_take(packed, at, length, &frame); at = frame.next) {
        if ((frame.id < limit) == below) {
            memcpy(out + written, packed + at, frame.next - at);
            written += frame.next - at;
        }
    }
    return written;
}

size_t wheel_packed_split(const uint8_t *packed, size_t length, uint16_t limit, uint8_t *out, size_t *used) {
    const size_t below = copy_group(packed, length, limit, true, out);
    *used = below + copy_group(packed, length, limit, false, out + below);
    return below;
}

void wheel_line_count(const wheel_line *line, wheel_line_counts *counts) {
    const wheel_deframer *deframer = &line->deframer;
    *counts = (wheel_line_counts){
        .frames = deframer->frames,
        .lost = deframer->lost,
        .cobs = deframer->cobs,
        .crc = deframer->crc,
        .length = deframer->length_errors,
        .unknown_id = deframer->unknown_id,
        .overrun = deframer->overruns,
    };
}
