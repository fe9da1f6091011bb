#include "wire_mutator.h"

#include <stdbool.h>
#include <string.h>

#include "../../../firmware_protocol/firmware/crc.h"
#include "../../../firmware_protocol/firmware/framing.h"

#define STREAM_MAX 4096u
#define HEADER 3u /* id16, sequence8 */
#define CRC 2u
#define FIRST_NONCE 0x1231u /* a few nonces, so that they are met again */

typedef struct {
    uint8_t bytes[STREAM_MAX + WHEEL_FRAME_MAX];
    size_t size;
} stream;

/* What the host said last before a place in the stream. */
typedef struct {
    uint16_t nonce;
    uint8_t sequence;
} context;

static uint32_t draw(uint32_t *random, uint32_t below) {
    *random ^= *random << 13;
    *random ^= *random >> 17;
    *random ^= *random << 5;
    return *random % below;
}

static const uint16_t host_ids[] = {
    WP_ESTOP_ID,          WP_HOST_HEARTBEAT_ID,    WP_TORQUE_FEEDFORWARD_ID,
    WP_WHEEL_COMMAND_ID,  WP_TORQUE_COMMAND_ID,    WP_TIME_SYNC_REQUEST_ID,
    WP_STEP_ID,           WP_PARAMETER_REQUEST_ID, WP_HELLO_REQUEST_ID,
    WP_HOST_HEARTBEAT_ID, WP_WHEEL_COMMAND_ID,     WP_TORQUE_COMMAND_ID,
};

static uint16_t any_host_id(uint32_t *random) {
    return host_ids[draw(random, sizeof host_ids / sizeof host_ids[0])];
}

/* The bytes up to the next zero, without it. */
static size_t segment_length(const uint8_t *bytes, size_t size) {
    const uint8_t *zero = memchr(bytes, 0, size);
    return zero == NULL ? size : (size_t)(zero - bytes);
}

static void append(stream *s, const uint8_t *bytes, size_t size) {
    const size_t room = sizeof s->bytes - s->size;
    const size_t taken = size < room ? size : room;
    memcpy(s->bytes + s->size, bytes, taken);
    s->size += taken;
}

static void append_frame(stream *s, const wheel_frame *frame, uint8_t sequence) {
    uint8_t out[WHEEL_FRAME_MAX];
    append(s, out, wheel_frame_encode(frame, sequence, out));
}

/* A frame with a right CRC and nothing else: any id, any length. */
static void append_checked(stream *s, uint8_t *body, size_t length) {
    uint8_t out[WHEEL_COBS_MAX(WHEEL_FRAME_BODY_MAX + 1u) + 1u];
    const uint16_t crc = wheel_crc16(body, length);
    body[length] = (uint8_t)(crc & 0xFFu);
    body[length + 1u] = (uint8_t)(crc >> 8);
    const size_t encoded = wheel_cobs_encode(body, length + CRC, out);
    out[encoded] = 0;
    append(s, out, encoded + 1u);
}

/* Makes a frame of anything: its first bytes are taken for an id and a payload. */
static void append_repaired(stream *s, const uint8_t *segment, size_t length, uint32_t *random) {
    uint8_t body[WHEEL_FRAME_BODY_MAX + 1u] = {0};
    size_t decoded = length < sizeof body ? length : sizeof body;
    memcpy(body, segment, decoded);
    if (!wheel_cobs_decode(body, &decoded)) {
        memcpy(body, segment, length < sizeof body ? length : sizeof body);
    }
    if (draw(random, 8) == 0u) {
        append_checked(s, body, draw(random, WHEEL_FRAME_BODY_MAX));
        return;
    }
    wheel_frame frame = {.id = (uint16_t)(body[0] | body[1] << 8)};
    if (wp_payload_length(frame.id) < 0) {
        frame.id = any_host_id(random);
    }
    frame.length = (uint8_t)wp_payload_length(frame.id);
    memcpy(frame.payload, body + HEADER, frame.length);
    append_frame(s, &frame, body[2]);
}

static void plausible_command(wheel_frame *frame, const context *said, uint32_t *random) {
    float value[4];
    const float step = frame->id == WP_WHEEL_COMMAND_ID ? 1.0f / 64.0f : 1.0f / 256.0f;
    const bool zero = draw(random, 3) == 0u;
    for (size_t i = 0; i < 4u; i++) {
        value[i] = zero ? 0.0f : step * (float)((int32_t)draw(random, 8191u) - 4095);
    }
    const uint8_t sequence = (uint8_t)(said->sequence + draw(random, draw(random, 2) == 0u ? 3u : 36u));
    const uint8_t session = (uint8_t)(said->nonce & 0xFu);
    if (frame->id == WP_WHEEL_COMMAND_ID) {
        const wp_wheel_command m = {value[0], value[1], value[2], value[3], sequence, session};
        (void)wp_wheel_command_encode(&m, frame->payload);
    } else {
        const wp_torque_command m = {value[0], value[1], value[2], value[3], sequence, session};
        (void)wp_torque_command_encode(&m, frame->payload);
    }
}

static void append_plausible(stream *s, const context *said, uint32_t *random) {
    wheel_frame frame = {.id = any_host_id(random)};
    frame.length = (uint8_t)wp_payload_length(frame.id);
    for (size_t i = 0; i < frame.length; i++) {
        frame.payload[i] = (uint8_t)draw(random, 256u);
    }
    if (frame.id == WP_HOST_HEARTBEAT_ID) {
        const bool same = draw(random, 2) == 0u;
        const wp_host_heartbeat m = {
            .nonce = same ? said->nonce : (uint16_t)(FIRST_NONCE + draw(random, 4)),
            .schema_hash = WP_SCHEMA_HASH,
            .request = (uint8_t)draw(random, 3),
            .mode = (uint8_t)draw(random, 2),
            .parameter_check = wire_parameter_check(),
        };
        (void)wp_host_heartbeat_encode(&m, frame.payload);
    } else if (frame.id == WP_WHEEL_COMMAND_ID || frame.id == WP_TORQUE_COMMAND_ID) {
        plausible_command(&frame, said, random);
    } else if (frame.id == WP_PARAMETER_REQUEST_ID) {
        frame.payload[0] = (uint8_t)draw(random, 22);
        frame.payload[1] = (uint8_t)draw(random, 6);
    } else if (frame.id == WP_STEP_ID) {
        const wp_step m = {.tick = draw(random, 64), .substeps = (uint16_t)draw(random, 16)};
        (void)wp_step_encode(&m, frame.payload);
    }
    append_frame(s, &frame, (uint8_t)draw(random, 256u));
}

static void listen(context *said, const uint8_t *segment, size_t length) {
    uint8_t body[WHEEL_FRAME_BODY_MAX + 1u] = {0};
    if (length > sizeof body) {
        return;
    }
    memcpy(body, segment, length);
    if (!wheel_cobs_decode(body, &length) || length != HEADER + 8u + CRC) {
        return;
    }
    const uint16_t id = (uint16_t)(body[0] | body[1] << 8);
    wp_wheel_command command;
    wp_host_heartbeat heartbeat;
    if (id == WP_HOST_HEARTBEAT_ID && wp_host_heartbeat_decode(body + HEADER, 8u, &heartbeat)) {
        said->nonce = heartbeat.nonce;
    } else if ((id == WP_WHEEL_COMMAND_ID || id == WP_TORQUE_COMMAND_ID) &&
               wp_wheel_command_decode(body + HEADER, 8u, &command)) {
        said->sequence = command.sequence;
    }
}

enum { REPAIR, INSERT, REPLAY, DROP, EDITS };

/* Copies the stream frame by frame, and edits it at one place or, when repairing, everywhere. */
static void edit(stream *s, const uint8_t *wire, size_t size, uint32_t *random) {
    const uint32_t kind = draw(random, EDITS);
    const size_t place = size == 0u ? 0u : draw(random, (uint32_t)size + 1u);
    context said = {.nonce = FIRST_NONCE};
    bool done = false;
    size_t at = 0;
    while (at < size) {
        const size_t length = segment_length(wire + at, size - at);
        const size_t whole = at + length < size ? length + 1u : length;
        const bool here = !done && at + whole >= place;
        listen(&said, wire + at, length);
        if (kind == REPAIR && length > 0u) {
            append_repaired(s, wire + at, length, random);
        } else if (!(kind == DROP && here)) {
            append(s, wire + at, whole);
        }
        if (here) {
            done = true;
            if (kind == INSERT) {
                append_plausible(s, &said, random);
            } else if (kind == REPLAY) {
                const size_t from = draw(random, (uint32_t)size);
                append(s, wire + from, size - from < 48u ? size - from : 48u);
            }
        }
        at += whole;
    }
    if (size == 0u) {
        append_plausible(s, &said, random);
    }
}

size_t LLVMFuzzerCustomMutator(uint8_t *data, size_t size, size_t max_size, unsigned seed) {
    uint32_t random = seed * 2654435761u + 1u;
    if (draw(&random, 4) == 0u || max_size <= wire_header_size) {
        size = LLVMFuzzerMutate(data, size, max_size);
    }
    if (size < wire_header_size || draw(&random, 8) == 0u) {
        return size;
    }
    const size_t wire = size - wire_header_size;
    stream s = {.size = 0};
    edit(&s, data + wire_header_size, wire < STREAM_MAX ? wire : STREAM_MAX, &random);
    const size_t room = max_size - wire_header_size;
    const size_t kept = s.size < room ? s.size : room;
    memcpy(data + wire_header_size, s.bytes, kept);
    return wire_header_size + kept;
}
