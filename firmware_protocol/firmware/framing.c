#include "framing.h"

#include <string.h>

#include "crc.h"

#define HEADER 3u /* id16, sequence8 */
#define CRC 2u

static uint16_t load16(const uint8_t *bytes) {
    return (uint16_t)(bytes[0] | (bytes[1] << 8));
}

static void store16(uint8_t *bytes, uint16_t value) {
    bytes[0] = (uint8_t)(value & 0xFFu);
    bytes[1] = (uint8_t)(value >> 8);
}

void wheel_deframer_init(wheel_deframer *deframer) {
    *deframer = (wheel_deframer){0};
}

/* A distance of half the circle or more is a repeated frame or a sender that began anew: nothing was lost. */
static void count_lost(wheel_deframer *deframer, uint8_t sequence) {
    const uint8_t missing = (uint8_t)(sequence - deframer->next_sequence);
    if (deframer->synchronised && missing < 128u) {
        deframer->lost += missing;
    }
    deframer->next_sequence = (uint8_t)(sequence + 1u);
    deframer->synchronised = true;
}

/* Checks the bytes between two zeros. The sequence counts as soon as the CRC holds, whatever the frame is. */
static bool parse(wheel_deframer *deframer, size_t length, wheel_frame *frame) {
    uint8_t *body = deframer->buffer;
    if (!wheel_cobs_decode(body, &length)) {
        deframer->cobs++;
        return false;
    }
    if (length < HEADER + CRC) {
        deframer->length_errors++;
        return false;
    }
    if (wheel_crc16(body, length - CRC) != load16(body + length - CRC)) {
        deframer->crc++;
        return false;
    }
    count_lost(deframer, body[2]);
    const uint16_t id = load16(body);
    const int expected = wp_payload_length(id);
    if (expected < 0) {
        deframer->unknown_id++;
        return false;
    }
    if (length != HEADER + (size_t)expected + CRC) {
        deframer->length_errors++;
        return false;
    }
    frame->id = id;
    frame->length = (uint8_t)expected;
    memcpy(frame->payload, body + HEADER, (size_t)expected);
    deframer->frames++;
    return true;
}

/* Adds bytes that are not zero to the open frame. */
static void add(wheel_deframer *deframer, const uint8_t *bytes, size_t count) {
    const size_t room = sizeof deframer->buffer - deframer->length;
    if (deframer->overrun) {
        return;
    }
    if (count > room) {
        deframer->overrun = true;
        deframer->overruns++;
        return;
    }
    memcpy(deframer->buffer + deframer->length, bytes, count);
    deframer->length = (uint8_t)(deframer->length + count);
}

/* Ends the open frame; true when it is valid. */
static bool end(wheel_deframer *deframer, wheel_frame *frame) {
    const size_t length = deframer->overrun ? 0 : deframer->length;
    deframer->length = 0;
    deframer->overrun = false;
    /* Two zeros in a row are no error: a sender may begin with one to clear the line. */
    return length > 0 && parse(deframer, length, frame);
}

bool wheel_deframer_feed(wheel_deframer *deframer, uint8_t byte, wheel_frame *frame) {
    if (byte != 0) {
        add(deframer, &byte, 1);
        return false;
    }
    return end(deframer, frame);
}

bool wheel_deframer_take(wheel_deframer *deframer, const uint8_t *bytes, size_t length, size_t *at,
                         wheel_frame *frame) {
    while (*at < length) {
        const size_t begin = *at;
        while (*at < length && bytes[*at] != 0) {
            ++*at;
        }
        add(deframer, bytes + begin, *at - begin);
        if (*at < length) {
            ++*at;
            if (end(deframer, frame)) {
                return true;
            }
        }
    }
    return false;
}

size_t wheel_frame_encode(const wheel_frame *frame, uint8_t sequence, uint8_t *out) {
    if ((int)frame->length != wp_payload_length(frame->id)) {
        return 0;
    }
    uint8_t body[WHEEL_FRAME_BODY_MAX];
    store16(body, frame->id);
    body[2] = sequence;
    memcpy(body + HEADER, frame->payload, frame->length);
    const size_t covered = HEADER + (size_t)frame->length;
    store16(body + covered, wheel_crc16(body, covered));
    const size_t encoded = wheel_cobs_encode(body, covered + CRC, out);
    out[encoded] = 0;
    return encoded + 1u;
}
