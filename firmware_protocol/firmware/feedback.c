/* What the robot tells: HELLO, the feedback snapshot, STATUS and LINK_COUNTERS. */
#include "node.h"

enum { PART_ENCODERS = 1, PART_WHEEL_SPEEDS = 2, PART_CURRENTS = 4, PART_GYRO = 8 };

/* Encodes one message and queues it. A message that its own encoder refuses is not sent. */
#define SEND(node, NAME, name, ...)                                                                          \
    do {                                                                                                     \
        const wp_##name message = {__VA_ARGS__};                                                             \
        uint8_t payload[WP_##NAME##_LENGTH];                                                                 \
        if (wp_##name##_encode(&message, payload)) {                                                         \
            wheel_node_queue(node, WP_##NAME##_ID, WP_##NAME##_LENGTH, payload);                             \
        }                                                                                                    \
    } while (0)

static float clamp(float x, float limit) {
    return x > limit ? limit : (x < -limit ? -limit : x);
}

static uint8_t at_most_255(uint32_t x) {
    return x > 255u ? 255u : (uint8_t)x;
}

void wheel_node_send_hello(wheel_node *node) {
    SEND(node, HELLO_IDENTITY, hello_identity, .protocol_version = WP_PROTOCOL_VERSION, .pages = 3u,
         .capabilities = node->identity.capabilities, .schema_hash = WP_SCHEMA_HASH);
    SEND(node, HELLO_FIRMWARE, hello_firmware, .major = node->identity.version[0],
         .minor = node->identity.version[1], .patch = node->identity.version[2],
         .board = node->identity.board, .build = node->identity.build);
    SEND(node, HELLO_PARAMETERS, hello_parameters, .parameter_hash = wheel_parameters_hash(&node->parameters),
         .watchdog_ms = (uint16_t)wheel_ticks(node->parameters.watchdog_s),
         .feedback_period_ms = (uint16_t)wheel_ticks(node->parameters.feedback_period_s));
}

void wheel_node_send_status(wheel_node *node) {
    SEND(node, STATUS, status, .state = node->state, .mode = node->mode, .fault = node->fault,
         .stop_reason = node->stop_reason, .nonce = node->session_nonce, .arm_refusal = node->arm_refusal,
         .limited = (uint16_t)node->limited_ticks);
}

static void send_link_counters(wheel_node *node) {
    const wheel_rejections *own = &node->rejections;
    const wheel_transport_rejections *transport = &node->transport;
    SEND(node, LINK_COUNTERS, link_counters, .cobs = (uint8_t)transport->cobs, .crc = (uint8_t)transport->crc,
         .length = (uint8_t)(transport->length + own->length),
         .unknown_id = (uint8_t)(transport->unknown_id + own->unknown_id), .range = (uint8_t)own->range,
         .session = (uint8_t)own->session, .stale = (uint8_t)own->stale, .state = (uint8_t)own->state);
}

static void send_snapshot(wheel_node *node, const wheel_sense *sense, bool slow_parts) {
    const uint8_t parts = slow_parts ? PART_ENCODERS | PART_WHEEL_SPEEDS | PART_CURRENTS | PART_GYRO
                                     : PART_ENCODERS | PART_WHEEL_SPEEDS;
    const uint32_t time_us = node->tick * 1000u; /* wraps, as it does on the wire */
    SEND(node, TICK, tick, .time_us = time_us, .sequence = node->setting.sequence,
         .command_age_ms = at_most_255(node->setting.age_ticks * WHEEL_TICK_MS), .state = node->state,
         .parts = parts, .snapshot = node->snapshot++);
    SEND(node, ENCODERS, encoders, .fl_count = sense->count[0], .fr_count = sense->count[1],
         .rr_count = sense->count[2], .rl_count = sense->count[3]);
    SEND(node, WHEEL_SPEEDS, wheel_speeds, .fl_rad_s = clamp(node->speed_rad_s[0], 127.99609375f),
         .fr_rad_s = clamp(node->speed_rad_s[1], 127.99609375f),
         .rr_rad_s = clamp(node->speed_rad_s[2], 127.99609375f),
         .rl_rad_s = clamp(node->speed_rad_s[3], 127.99609375f));
    if (!slow_parts) {
        return;
    }
    SEND(node, CURRENTS, currents, .fl_a = clamp(sense->current_a[0], 31.9990234375f),
         .fr_a = clamp(sense->current_a[1], 31.9990234375f),
         .rr_a = clamp(sense->current_a[2], 31.9990234375f),
         .rl_a = clamp(sense->current_a[3], 31.9990234375f));
    SEND(node, GYRO, gyro, .x_rad_s = clamp(sense->gyro_rad_s[0], 31.9990234375f),
         .y_rad_s = clamp(sense->gyro_rad_s[1], 31.9990234375f),
         .z_rad_s = clamp(sense->gyro_rad_s[2], 31.9990234375f), .tick = (uint16_t)(time_us / 1000u));
}

void wheel_node_send_feedback(wheel_node *node, const wheel_sense *sense) {
    const uint32_t period = wheel_ticks(node->parameters.feedback_period_s);
    if (period > 0u && node->tick % period == 0u) {
        const bool due =
            period >= WHEEL_SLOW_PART_PERIOD_TICKS || node->tick % WHEEL_SLOW_PART_PERIOD_TICKS == 0u;
        /* A value that is no number cannot be sent: its part is not announced, so that the rest still counts.
         */
        const bool slow_parts = due && wheel_sense_is_finite(sense);
        send_snapshot(node, sense, slow_parts);
    }
    if (node->tick % WHEEL_STATUS_PERIOD_TICKS == 0u) {
        wheel_node_send_status(node);
        send_link_counters(node);
    }
}
