/* Fuzzes the decoder: any bytes as a serial line, as a COBS block, and as the payload of every message. */
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/firmware/framing.h"
#include "check.h"
#include "wire_mutator.h"

const size_t wire_header_size = 0;

uint8_t wire_parameter_check(void) {
    return 0u;
}

/* What is decoded encodes to the same bits: a payload has one meaning or none. */
#define DECODE(NAME, name)                                                                                   \
    {                                                                                                        \
        wp_##name message;                                                                                   \
        if (wp_##name##_decode(payload, size, &message)) {                                                   \
            uint8_t again[WP_##NAME##_LENGTH];                                                               \
            CHECK(size == WP_##NAME##_LENGTH);                                                               \
            CHECK(wp_##name##_encode(&message, again));                                                      \
            CHECK(memcmp(again, payload, size) == 0);                                                        \
        }                                                                                                    \
    }

static void decode_as_every_message(const uint8_t *bytes, size_t size) {
    uint8_t *payload = exactly(bytes, size);
    WP_MESSAGES(DECODE)
    free(payload);
}

static void check_frame(const wheel_deframer *deframer, const wheel_frame *frame) {
    uint8_t out[WHEEL_FRAME_MAX];
    wheel_deframer other;
    wheel_frame again;
    const size_t written = wheel_frame_encode(frame, (uint8_t)(deframer->next_sequence - 1u), out);
    CHECK(written == (size_t)frame->length + 7u);
    wheel_deframer_init(&other);
    for (size_t i = 0; i < written; i++) {
        CHECK(wheel_deframer_feed(&other, out[i], &again) == (i + 1u == written));
    }
    CHECK(again.id == frame->id && again.length == frame->length);
    CHECK(memcmp(again.payload, frame->payload, frame->length) == 0);
    decode_as_every_message(frame->payload, frame->length);
}

/* Every block that a zero ends is either a frame or counted once by its cause. */
static void feed_a_line(const uint8_t *data, size_t size) {
    wheel_deframer d;
    wheel_frame frame;
    uint32_t frames = 0;
    uint32_t blocks = 0;
    size_t length = 0; /* of the open block */
    wheel_deframer_init(&d);
    for (size_t i = 0; i < size; i++) {
        blocks += data[i] == 0u && i > 0u && data[i - 1u] != 0u ? 1u : 0u;
        if (wheel_deframer_feed(&d, data[i], &frame)) {
            CHECK(data[i] == 0u && length + 1u == (size_t)frame.length + 7u);
            check_frame(&d, &frame);
            frames++;
        }
        length = data[i] == 0u ? 0u : length + 1u;
        const uint32_t dropped = d.cobs + d.crc + d.length_errors + d.unknown_id + d.overruns;
        CHECK(frames == d.frames);
        CHECK(frames + dropped == blocks + (d.overrun ? 1u : 0u));
        CHECK(d.length <= sizeof d.buffer);
    }
}

static void decode_a_block(const uint8_t *data, size_t size) {
    uint8_t *block = exactly(data, size);
    size_t length = size;
    if (wheel_cobs_decode(block, &length)) {
        CHECK(length <= size);
    }
    free(block);
    uint8_t *encoded = malloc(WHEEL_COBS_MAX(size));
    CHECK(encoded != NULL);
    length = wheel_cobs_encode(data, size, encoded);
    CHECK(length <= WHEEL_COBS_MAX(size) && memchr(encoded, 0, length) == NULL);
    CHECK(wheel_cobs_decode(encoded, &length) && length == size && memcmp(encoded, data, size) == 0);
    free(encoded);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    feed_a_line(data, size);
    decode_a_block(data, size);
    decode_as_every_message(data, size < WP_PAYLOAD_MAX ? size : WP_PAYLOAD_MAX);
    return 0;
}
