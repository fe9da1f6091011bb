/* What the robot tells: HELLO, the feedback snapshot, STATUS and LINK_COUNTERS. */
#include <string.h>

#include "node.h"

#define HELLO_PAGES 8u

enum {
    PART_ENCODERS = 1,
    PART_WHEEL_SPEEDS = 2,
    PART_CURRENTS = 4,
    PART_ACCELEROMETER = 8,
    PART_GYRO = 16,
    PARTS_FAST = PART_ENCODERS | PART_WHEEL_SPEEDS,
    PARTS_SLOW = PART_CURRENTS | PART_ACCELEROMETER | PART_GYRO,
};

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
    SEND(node, HELLO_IDENTITY, hello_identity, .protocol_version = WP_PROTOCOL_VERSION, .pages = HELLO_PAGES,
         .capabilities = node->identity.capabilities, .schema_hash = WP_SCHEMA_HASH);
    SEND(node, HELLO_FIRMWARE, hello_firmware, .major = node->identity.version[0],
         .minor = node->identity.version[1], .patch = node->identity.version[2],
         .board = node->identity.board, .build = node->identity.build);
    SEND(node, HELLO_PARAMETERS, hello_parameters, .parameter_hash = wheel_parameters_hash(&node->parameters),
         .watchdog_ms = (uint16_t)wheel_ticks(node->parameters.watchdog_s),
         .feedback_period_ms = (uint16_t)wheel_ticks(node->parameters.feedback_period_s));
    SEND(node, HELLO_GEOMETRY, hello_geometry, .wheel_radius_m = node->parameters.wheel_radius_m,
         .half_length_m = node->parameters.half_length_m, .half_width_m = node->parameters.half_width_m,
         .counts_per_revolution = (uint16_t)node->parameters.counts_per_revolution);
    SEND(node, HELLO_LIMITS, hello_limits, .speed_limit_rad_s = wheel_node_speed_limit(node),
         .overspeed_rad_s = node->parameters.overspeed_rad_s,
         .torque_limit_n_m = node->parameters.torque_limit_n_m);
    const wheel_processor_fault *fault = &node->identity.processor_fault;
    SEND(node, HELLO_FAULT_STATUS, hello_fault_status, .cfsr = fault->cfsr, .hfsr = fault->hfsr);
    SEND(node, HELLO_FAULT_PLACE, hello_fault_place, .pc = fault->pc, .lr = fault->lr);
    SEND(node, HELLO_FAULT_ADDRESS, hello_fault_address, .mmfar = fault->mmfar, .bfar = fault->bfar);
}

void wheel_node_send_status(wheel_node *node) {
    SEND(node, STATUS, status, .state = node->state, .mode = node->mode, .fault = node->fault,
         .fault_wheel = node->fault_wheel, .stop_reason = node->stop_reason,
         .reset_cause = node->identity.reset_cause, .nonce = node->session_nonce,
         .arm_refusal = node->arm_refusal, .limited = (uint16_t)node->limited_ticks);
}

static void send_counters(wheel_node *node) {
    const wheel_rejections *own = &node->rejections;
    const wheel_transport_counters *transport = &node->transport;
    SEND(node, LINK_COUNTERS, link_counters, .cobs = (uint8_t)transport->cobs, .crc = (uint8_t)transport->crc,
         .length = (uint8_t)(transport->length + own->length),
         .unknown_id = (uint8_t)(transport->unknown_id + own->unknown_id), .range = (uint8_t)own->range,
         .session = (uint8_t)own->session, .stale = (uint8_t)own->stale, .state = (uint8_t)own->state);
    SEND(node, PORT_COUNTERS, port_counters, .overrun = (uint8_t)transport->overrun,
         .feedforward_unmatched = (uint8_t)own->feedforward_unmatched,
         .transmit_overrun = (uint8_t)node->transmit_overruns, .serial_lost = (uint8_t)transport->serial_lost,
         .can_errors = (uint8_t)transport->can_errors, .bus_off = (uint8_t)transport->bus_off);
}

static void send_power(wheel_node *node) {
    const wheel_sense *sense = &node->sense;
    const wheel_measured *mean = &node->mean;
    const uint16_t capabilities = node->identity.capabilities;
    if ((capabilities & WHEEL_CAPABILITY_POWER) != 0u && node->has_mean) {
        SEND(node, POWER, power, .battery_v = clamp(mean->battery_v, 255.9921875f),
             .battery_a = clamp(mean->battery_a, 255.9921875f));
    }
    if ((capabilities & WHEEL_CAPABILITY_TEMPERATURES) != 0u) {
        SEND(node, TEMPERATURES, temperatures, .fl_degc = clamp(sense->temperature_degc[0], 255.9921875f),
             .fr_degc = clamp(sense->temperature_degc[1], 255.9921875f),
             .rr_degc = clamp(sense->temperature_degc[2], 255.9921875f),
             .rl_degc = clamp(sense->temperature_degc[3], 255.9921875f));
    }
}

static void send_absolute(wheel_node *node) {
    SEND(node, ABSOLUTE_FRONT, absolute_front, .fl_count = node->absolute_count[0],
         .fr_count = node->absolute_count[1]);
    SEND(node, ABSOLUTE_REAR, absolute_rear, .rr_count = node->absolute_count[2],
         .rl_count = node->absolute_count[3]);
}

static void send_slow_parts(wheel_node *node, uint8_t parts, uint16_t tick) {
    const wheel_sense *sense = &node->sense;
    const wheel_measured *mean = &node->mean;
    if ((parts & PART_CURRENTS) != 0u) {
        SEND(node, CURRENTS, currents, .fl_a = clamp(mean->current_a[0], 31.9990234375f),
             .fr_a = clamp(mean->current_a[1], 31.9990234375f),
             .rr_a = clamp(mean->current_a[2], 31.9990234375f),
             .rl_a = clamp(mean->current_a[3], 31.9990234375f));
    }
    if ((parts & PART_ACCELEROMETER) != 0u) {
        SEND(node, ACCELEROMETER, accelerometer, .x_m_s2 = clamp(mean->acceleration_m_s2[0], 127.99609375f),
             .y_m_s2 = clamp(mean->acceleration_m_s2[1], 127.99609375f),
             .z_m_s2 = clamp(mean->acceleration_m_s2[2], 127.99609375f), .tick = tick);
    }
    if ((parts & PART_GYRO) != 0u) {
        SEND(node, GYRO, gyro, .x_rad_s = clamp(sense->gyro_rad_s[0], 31.9990234375f),
             .y_rad_s = clamp(sense->gyro_rad_s[1], 31.9990234375f),
             .z_rad_s = clamp(sense->gyro_rad_s[2], 31.9990234375f), .tick = tick);
    }
}

/* The parts for which this robot has sensors. */
static uint8_t slow_parts(const wheel_node *node) {
    const uint16_t capabilities = node->identity.capabilities;
    uint8_t parts = 0;
    parts |= (capabilities & WHEEL_CAPABILITY_CURRENTS) != 0u ? PART_CURRENTS : 0u;
    parts |= (capabilities & WHEEL_CAPABILITY_ACCELEROMETER) != 0u ? PART_ACCELEROMETER : 0u;
    parts |= (capabilities & WHEEL_CAPABILITY_GYRO) != 0u ? PART_GYRO : 0u;
    return parts;
}

static void send_snapshot(wheel_node *node, bool slow) {
    const uint8_t parts = (uint8_t)(PARTS_FAST | (slow ? slow_parts(node) : 0));
    const uint32_t time_us = node->tick * 1000u; /* wraps, as it does on the wire */
    SEND(node, TICK, tick, .time_us = time_us, .sequence = node->setting.sequence,
         .command_age_ms = at_most_255(node->setting.age_ticks * WHEEL_TICK_MS), .state = node->state,
         .parts = parts, .snapshot = node->snapshot++);
    const uint16_t *count = node->sense.count;
    SEND(node, ENCODERS, encoders, .fl_count = count[0], .fr_count = count[1], .rr_count = count[2],
         .rl_count = count[3]);
    SEND(node, WHEEL_SPEEDS, wheel_speeds, .fl_rad_s = clamp(node->speed_rad_s[0], 127.99609375f),
         .fr_rad_s = clamp(node->speed_rad_s[1], 127.99609375f),
         .rr_rad_s = clamp(node->speed_rad_s[2], 127.99609375f),
         .rl_rad_s = clamp(node->speed_rad_s[3], 127.99609375f));
    send_slow_parts(node, parts, (uint16_t)(time_us / 1000u));
}

/* A value that no sensor measures is left out. */
static void add_to_means(wheel_node *node) {
    const wheel_sense *sense = &node->sense;
    wheel_measured *sum = &node->sum;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        sum->current_a[i] += sense->current_a[i];
    }
    for (size_t i = 0; i < 3u; i++) {
        sum->acceleration_m_s2[i] += sense->acceleration_m_s2[i];
    }
    sum->battery_v += sense->battery_v;
    sum->battery_a += sense->battery_a;
    node->summed_ticks++;
}

/* Ends a feedback period. */
static void take_means(wheel_node *node) {
    const float ticks = (float)node->summed_ticks;
    const wheel_measured *sum = &node->sum;
    wheel_measured *mean = &node->mean;
    node->has_mean = node->summed_ticks > 0u;
    if (node->has_mean) {
        for (size_t i = 0; i < WHEEL_COUNT; i++) {
            mean->current_a[i] = sum->current_a[i] / ticks;
        }
        for (size_t i = 0; i < 3u; i++) {
            mean->acceleration_m_s2[i] = sum->acceleration_m_s2[i] / ticks;
        }
        mean->battery_v = sum->battery_v / ticks;
        mean->battery_a = sum->battery_a / ticks;
    }
    memset(&node->sum, 0, sizeof node->sum);
    node->summed_ticks = 0u;
}

void wheel_node_send_feedback(wheel_node *node) {
    const uint32_t period = wheel_ticks(node->parameters.feedback_period_s);
    /* A value that no sensor measures is not sent: its part is not announced, so that the rest still counts.
     */
    const bool plausible = wheel_sense_is_plausible(&node->sense);
    if (plausible) {
        add_to_means(node);
    }
    if (node->tick % period == 0u) {
        take_means(node);
        const bool due =
            period >= WHEEL_SLOW_PART_PERIOD_TICKS || node->tick % WHEEL_SLOW_PART_PERIOD_TICKS == 0u;
        send_snapshot(node, due && plausible);
    }
    if (node->tick % WHEEL_STATUS_PERIOD_TICKS == 0u) {
        wheel_node_send_status(node);
        send_counters(node);
        if (plausible) {
            send_power(node);
        }
    }
    if (node->tick % WHEEL_ABSOLUTE_PERIOD_TICKS == 0u) {
        send_absolute(node);
    }
}
