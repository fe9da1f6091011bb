/* Generated from wheel.dbc by `python -m firmware_protocol.generate`; do not edit. */

#include "wheel_messages.h"

/* False for a NaN as well. */
static bool within(float value, float minimum, float maximum) {
    return value >= minimum && value <= maximum;
}

/* Half of a truncated double: the nearest integer, halves away from zero. */
static uint32_t nearest(float doubled) {
    const int32_t twice = (int32_t)doubled;
    return (uint32_t)(twice < 0 ? (twice - 1) / 2 : (twice + 1) / 2);
}

/* Byte by byte: the same on a machine of either byte order. */
static void store(uint8_t *payload, size_t length, uint64_t bits) {
    for (size_t i = 0; i < length; i++) {
        payload[i] = (uint8_t)((bits >> (8 * i)) & 0xFFu);
    }
}

static uint64_t load(const uint8_t *payload, size_t length) {
    uint64_t bits = 0;
    for (size_t i = 0; i < length; i++) {
        bits |= (uint64_t)payload[i] << (8 * i);
    }
    return bits;
}

static uint32_t field(uint64_t bits, unsigned start, unsigned length) {
    return (uint32_t)(bits >> start) & (0xFFFFFFFFu >> (32 - length));
}

/* Two's complement. */
static int32_t signed_field(uint64_t bits, unsigned start, unsigned length) {
    const uint32_t sign = 1u << (length - 1);
    return (int32_t)(field(bits, start, length) ^ sign) - (int32_t)sign;
}

int wp_payload_length(uint16_t id) {
    switch (id) {
    case WP_ESTOP_ID:
        return (int)WP_ESTOP_LENGTH;
    case WP_HOST_HEARTBEAT_ID:
        return (int)WP_HOST_HEARTBEAT_LENGTH;
    case WP_TORQUE_FEEDFORWARD_ID:
        return (int)WP_TORQUE_FEEDFORWARD_LENGTH;
    case WP_WHEEL_COMMAND_ID:
        return (int)WP_WHEEL_COMMAND_LENGTH;
    case WP_TORQUE_COMMAND_ID:
        return (int)WP_TORQUE_COMMAND_LENGTH;
    case WP_TICK_ID:
        return (int)WP_TICK_LENGTH;
    case WP_ENCODERS_ID:
        return (int)WP_ENCODERS_LENGTH;
    case WP_WHEEL_SPEEDS_ID:
        return (int)WP_WHEEL_SPEEDS_LENGTH;
    case WP_CURRENTS_ID:
        return (int)WP_CURRENTS_LENGTH;
    case WP_ACCELEROMETER_ID:
        return (int)WP_ACCELEROMETER_LENGTH;
    case WP_GYRO_ID:
        return (int)WP_GYRO_LENGTH;
    case WP_STATUS_ID:
        return (int)WP_STATUS_LENGTH;
    case WP_POWER_ID:
        return (int)WP_POWER_LENGTH;
    case WP_TEMPERATURES_ID:
        return (int)WP_TEMPERATURES_LENGTH;
    case WP_LINK_COUNTERS_ID:
        return (int)WP_LINK_COUNTERS_LENGTH;
    case WP_ABSOLUTE_FRONT_ID:
        return (int)WP_ABSOLUTE_FRONT_LENGTH;
    case WP_ABSOLUTE_REAR_ID:
        return (int)WP_ABSOLUTE_REAR_LENGTH;
    case WP_PORT_COUNTERS_ID:
        return (int)WP_PORT_COUNTERS_LENGTH;
    case WP_TIME_SYNC_REQUEST_ID:
        return (int)WP_TIME_SYNC_REQUEST_LENGTH;
    case WP_TIME_SYNC_RESPONSE_ID:
        return (int)WP_TIME_SYNC_RESPONSE_LENGTH;
    case WP_PARAMETER_REQUEST_ID:
        return (int)WP_PARAMETER_REQUEST_LENGTH;
    case WP_PARAMETER_RESPONSE_ID:
        return (int)WP_PARAMETER_RESPONSE_LENGTH;
    case WP_STEP_ID:
        return (int)WP_STEP_LENGTH;
    case WP_STEP_DONE_ID:
        return (int)WP_STEP_DONE_LENGTH;
    case WP_HELLO_REQUEST_ID:
        return (int)WP_HELLO_REQUEST_LENGTH;
    case WP_HELLO_IDENTITY_ID:
        return (int)WP_HELLO_IDENTITY_LENGTH;
    case WP_HELLO_FIRMWARE_ID:
        return (int)WP_HELLO_FIRMWARE_LENGTH;
    case WP_HELLO_PARAMETERS_ID:
        return (int)WP_HELLO_PARAMETERS_LENGTH;
    case WP_HELLO_GEOMETRY_ID:
        return (int)WP_HELLO_GEOMETRY_LENGTH;
    case WP_HELLO_LIMITS_ID:
        return (int)WP_HELLO_LIMITS_LENGTH;
    case WP_HELLO_FAULT_STATUS_ID:
        return (int)WP_HELLO_FAULT_STATUS_LENGTH;
    case WP_HELLO_FAULT_PLACE_ID:
        return (int)WP_HELLO_FAULT_PLACE_LENGTH;
    case WP_HELLO_FAULT_ADDRESS_ID:
        return (int)WP_HELLO_FAULT_ADDRESS_LENGTH;
    default:
        return -1;
    }
}

bool wp_estop_encode(const wp_estop *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->source;
    bits |= (uint64_t)message->reason << 8;
    store(payload, WP_ESTOP_LENGTH, bits);
    return true;
}

bool wp_estop_decode(const uint8_t *payload, size_t length, wp_estop *message) {
    if (length != WP_ESTOP_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_source = field(bits, 0, 8);
    const uint32_t raw_reason = field(bits, 8, 8);
    message->source = (uint8_t)raw_source;
    message->reason = (uint8_t)raw_reason;
    return true;
}

bool wp_host_heartbeat_encode(const wp_host_heartbeat *message, uint8_t *payload) {
    if (message->nonce < 1u) {
        return false;
    }
    if (message->request > 2u) {
        return false;
    }
    if (message->mode > 1u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->nonce;
    bits |= (uint64_t)message->schema_hash << 16;
    bits |= (uint64_t)message->request << 48;
    bits |= (uint64_t)message->mode << 52;
    bits |= (uint64_t)message->parameter_check << 56;
    store(payload, WP_HOST_HEARTBEAT_LENGTH, bits);
    return true;
}

bool wp_host_heartbeat_decode(const uint8_t *payload, size_t length, wp_host_heartbeat *message) {
    if (length != WP_HOST_HEARTBEAT_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_nonce = field(bits, 0, 16);
    const uint32_t raw_schema_hash = field(bits, 16, 32);
    const uint32_t raw_request = field(bits, 48, 4);
    const uint32_t raw_mode = field(bits, 52, 4);
    const uint32_t raw_parameter_check = field(bits, 56, 8);
    if (raw_nonce < 1u) {
        return false;
    }
    if (raw_request > 2u) {
        return false;
    }
    if (raw_mode > 1u) {
        return false;
    }
    message->nonce = (uint16_t)raw_nonce;
    message->schema_hash = raw_schema_hash;
    message->request = (uint8_t)raw_request;
    message->mode = (uint8_t)raw_mode;
    message->parameter_check = (uint8_t)raw_parameter_check;
    return true;
}

bool wp_torque_feedforward_encode(const wp_torque_feedforward *message, uint8_t *payload) {
    if (!within(message->fl_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->fr_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->rr_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->rl_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (message->session > 15u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_n_m * 512.0f) & 0x1FFFu);
    bits |= (uint64_t)(nearest(message->fr_n_m * 512.0f) & 0x1FFFu) << 13;
    bits |= (uint64_t)(nearest(message->rr_n_m * 512.0f) & 0x1FFFu) << 26;
    bits |= (uint64_t)(nearest(message->rl_n_m * 512.0f) & 0x1FFFu) << 39;
    bits |= (uint64_t)message->sequence << 52;
    bits |= (uint64_t)message->session << 60;
    store(payload, WP_TORQUE_FEEDFORWARD_LENGTH, bits);
    return true;
}

bool wp_torque_feedforward_decode(const uint8_t *payload, size_t length, wp_torque_feedforward *message) {
    if (length != WP_TORQUE_FEEDFORWARD_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_n_m = signed_field(bits, 0, 13);
    const int32_t raw_fr_n_m = signed_field(bits, 13, 13);
    const int32_t raw_rr_n_m = signed_field(bits, 26, 13);
    const int32_t raw_rl_n_m = signed_field(bits, 39, 13);
    const uint32_t raw_sequence = field(bits, 52, 8);
    const uint32_t raw_session = field(bits, 60, 4);
    if (raw_fl_n_m < -4095) {
        return false;
    }
    if (raw_fr_n_m < -4095) {
        return false;
    }
    if (raw_rr_n_m < -4095) {
        return false;
    }
    if (raw_rl_n_m < -4095) {
        return false;
    }
    message->fl_n_m = (float)raw_fl_n_m * 0.00390625f;
    message->fr_n_m = (float)raw_fr_n_m * 0.00390625f;
    message->rr_n_m = (float)raw_rr_n_m * 0.00390625f;
    message->rl_n_m = (float)raw_rl_n_m * 0.00390625f;
    message->sequence = (uint8_t)raw_sequence;
    message->session = (uint8_t)raw_session;
    return true;
}

bool wp_wheel_command_encode(const wp_wheel_command *message, uint8_t *payload) {
    if (!within(message->fl_rad_s, -63.984375f, 63.984375f)) {
        return false;
    }
    if (!within(message->fr_rad_s, -63.984375f, 63.984375f)) {
        return false;
    }
    if (!within(message->rr_rad_s, -63.984375f, 63.984375f)) {
        return false;
    }
    if (!within(message->rl_rad_s, -63.984375f, 63.984375f)) {
        return false;
    }
    if (message->session > 15u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_rad_s * 128.0f) & 0x1FFFu);
    bits |= (uint64_t)(nearest(message->fr_rad_s * 128.0f) & 0x1FFFu) << 13;
    bits |= (uint64_t)(nearest(message->rr_rad_s * 128.0f) & 0x1FFFu) << 26;
    bits |= (uint64_t)(nearest(message->rl_rad_s * 128.0f) & 0x1FFFu) << 39;
    bits |= (uint64_t)message->sequence << 52;
    bits |= (uint64_t)message->session << 60;
    store(payload, WP_WHEEL_COMMAND_LENGTH, bits);
    return true;
}

bool wp_wheel_command_decode(const uint8_t *payload, size_t length, wp_wheel_command *message) {
    if (length != WP_WHEEL_COMMAND_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_rad_s = signed_field(bits, 0, 13);
    const int32_t raw_fr_rad_s = signed_field(bits, 13, 13);
    const int32_t raw_rr_rad_s = signed_field(bits, 26, 13);
    const int32_t raw_rl_rad_s = signed_field(bits, 39, 13);
    const uint32_t raw_sequence = field(bits, 52, 8);
    const uint32_t raw_session = field(bits, 60, 4);
    if (raw_fl_rad_s < -4095) {
        return false;
    }
    if (raw_fr_rad_s < -4095) {
        return false;
    }
    if (raw_rr_rad_s < -4095) {
        return false;
    }
    if (raw_rl_rad_s < -4095) {
        return false;
    }
    message->fl_rad_s = (float)raw_fl_rad_s * 0.015625f;
    message->fr_rad_s = (float)raw_fr_rad_s * 0.015625f;
    message->rr_rad_s = (float)raw_rr_rad_s * 0.015625f;
    message->rl_rad_s = (float)raw_rl_rad_s * 0.015625f;
    message->sequence = (uint8_t)raw_sequence;
    message->session = (uint8_t)raw_session;
    return true;
}

bool wp_torque_command_encode(const wp_torque_command *message, uint8_t *payload) {
    if (!within(message->fl_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->fr_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->rr_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (!within(message->rl_n_m, -15.99609375f, 15.99609375f)) {
        return false;
    }
    if (message->session > 15u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_n_m * 512.0f) & 0x1FFFu);
    bits |= (uint64_t)(nearest(message->fr_n_m * 512.0f) & 0x1FFFu) << 13;
    bits |= (uint64_t)(nearest(message->rr_n_m * 512.0f) & 0x1FFFu) << 26;
    bits |= (uint64_t)(nearest(message->rl_n_m * 512.0f) & 0x1FFFu) << 39;
    bits |= (uint64_t)message->sequence << 52;
    bits |= (uint64_t)message->session << 60;
    store(payload, WP_TORQUE_COMMAND_LENGTH, bits);
    return true;
}

bool wp_torque_command_decode(const uint8_t *payload, size_t length, wp_torque_command *message) {
    if (length != WP_TORQUE_COMMAND_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_n_m = signed_field(bits, 0, 13);
    const int32_t raw_fr_n_m = signed_field(bits, 13, 13);
    const int32_t raw_rr_n_m = signed_field(bits, 26, 13);
    const int32_t raw_rl_n_m = signed_field(bits, 39, 13);
    const uint32_t raw_sequence = field(bits, 52, 8);
    const uint32_t raw_session = field(bits, 60, 4);
    if (raw_fl_n_m < -4095) {
        return false;
    }
    if (raw_fr_n_m < -4095) {
        return false;
    }
    if (raw_rr_n_m < -4095) {
        return false;
    }
    if (raw_rl_n_m < -4095) {
        return false;
    }
    message->fl_n_m = (float)raw_fl_n_m * 0.00390625f;
    message->fr_n_m = (float)raw_fr_n_m * 0.00390625f;
    message->rr_n_m = (float)raw_rr_n_m * 0.00390625f;
    message->rl_n_m = (float)raw_rl_n_m * 0.00390625f;
    message->sequence = (uint8_t)raw_sequence;
    message->session = (uint8_t)raw_session;
    return true;
}

bool wp_tick_encode(const wp_tick *message, uint8_t *payload) {
    if (message->state > 6u) {
        return false;
    }
    if (message->parts > 31u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->time_us;
    bits |= (uint64_t)message->sequence << 32;
    bits |= (uint64_t)message->command_age_ms << 40;
    bits |= (uint64_t)message->state << 48;
    bits |= (uint64_t)message->parts << 51;
    bits |= (uint64_t)message->snapshot << 56;
    store(payload, WP_TICK_LENGTH, bits);
    return true;
}

bool wp_tick_decode(const uint8_t *payload, size_t length, wp_tick *message) {
    if (length != WP_TICK_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_time_us = field(bits, 0, 32);
    const uint32_t raw_sequence = field(bits, 32, 8);
    const uint32_t raw_command_age_ms = field(bits, 40, 8);
    const uint32_t raw_state = field(bits, 48, 3);
    const uint32_t raw_parts = field(bits, 51, 5);
    const uint32_t raw_snapshot = field(bits, 56, 8);
    if (raw_state > 6u) {
        return false;
    }
    message->time_us = raw_time_us;
    message->sequence = (uint8_t)raw_sequence;
    message->command_age_ms = (uint8_t)raw_command_age_ms;
    message->state = (uint8_t)raw_state;
    message->parts = (uint8_t)raw_parts;
    message->snapshot = (uint8_t)raw_snapshot;
    return true;
}

bool wp_encoders_encode(const wp_encoders *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->fl_count;
    bits |= (uint64_t)message->fr_count << 16;
    bits |= (uint64_t)message->rr_count << 32;
    bits |= (uint64_t)message->rl_count << 48;
    store(payload, WP_ENCODERS_LENGTH, bits);
    return true;
}

bool wp_encoders_decode(const uint8_t *payload, size_t length, wp_encoders *message) {
    if (length != WP_ENCODERS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_fl_count = field(bits, 0, 16);
    const uint32_t raw_fr_count = field(bits, 16, 16);
    const uint32_t raw_rr_count = field(bits, 32, 16);
    const uint32_t raw_rl_count = field(bits, 48, 16);
    message->fl_count = (uint16_t)raw_fl_count;
    message->fr_count = (uint16_t)raw_fr_count;
    message->rr_count = (uint16_t)raw_rr_count;
    message->rl_count = (uint16_t)raw_rl_count;
    return true;
}

bool wp_wheel_speeds_encode(const wp_wheel_speeds *message, uint8_t *payload) {
    if (!within(message->fl_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->fr_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->rr_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->rl_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_rad_s * 512.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->fr_rad_s * 512.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->rr_rad_s * 512.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)(nearest(message->rl_rad_s * 512.0f) & 0xFFFFu) << 48;
    store(payload, WP_WHEEL_SPEEDS_LENGTH, bits);
    return true;
}

bool wp_wheel_speeds_decode(const uint8_t *payload, size_t length, wp_wheel_speeds *message) {
    if (length != WP_WHEEL_SPEEDS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_rad_s = signed_field(bits, 0, 16);
    const int32_t raw_fr_rad_s = signed_field(bits, 16, 16);
    const int32_t raw_rr_rad_s = signed_field(bits, 32, 16);
    const int32_t raw_rl_rad_s = signed_field(bits, 48, 16);
    if (raw_fl_rad_s < -32767) {
        return false;
    }
    if (raw_fr_rad_s < -32767) {
        return false;
    }
    if (raw_rr_rad_s < -32767) {
        return false;
    }
    if (raw_rl_rad_s < -32767) {
        return false;
    }
    message->fl_rad_s = (float)raw_fl_rad_s * 0.00390625f;
    message->fr_rad_s = (float)raw_fr_rad_s * 0.00390625f;
    message->rr_rad_s = (float)raw_rr_rad_s * 0.00390625f;
    message->rl_rad_s = (float)raw_rl_rad_s * 0.00390625f;
    return true;
}

bool wp_currents_encode(const wp_currents *message, uint8_t *payload) {
    if (!within(message->fl_a, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    if (!within(message->fr_a, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    if (!within(message->rr_a, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    if (!within(message->rl_a, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_a * 2048.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->fr_a * 2048.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->rr_a * 2048.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)(nearest(message->rl_a * 2048.0f) & 0xFFFFu) << 48;
    store(payload, WP_CURRENTS_LENGTH, bits);
    return true;
}

bool wp_currents_decode(const uint8_t *payload, size_t length, wp_currents *message) {
    if (length != WP_CURRENTS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_a = signed_field(bits, 0, 16);
    const int32_t raw_fr_a = signed_field(bits, 16, 16);
    const int32_t raw_rr_a = signed_field(bits, 32, 16);
    const int32_t raw_rl_a = signed_field(bits, 48, 16);
    if (raw_fl_a < -32767) {
        return false;
    }
    if (raw_fr_a < -32767) {
        return false;
    }
    if (raw_rr_a < -32767) {
        return false;
    }
    if (raw_rl_a < -32767) {
        return false;
    }
    message->fl_a = (float)raw_fl_a * 0.0009765625f;
    message->fr_a = (float)raw_fr_a * 0.0009765625f;
    message->rr_a = (float)raw_rr_a * 0.0009765625f;
    message->rl_a = (float)raw_rl_a * 0.0009765625f;
    return true;
}

bool wp_accelerometer_encode(const wp_accelerometer *message, uint8_t *payload) {
    if (!within(message->x_m_s2, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->y_m_s2, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->z_m_s2, -127.99609375f, 127.99609375f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->x_m_s2 * 512.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->y_m_s2 * 512.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->z_m_s2 * 512.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)message->tick << 48;
    store(payload, WP_ACCELEROMETER_LENGTH, bits);
    return true;
}

bool wp_accelerometer_decode(const uint8_t *payload, size_t length, wp_accelerometer *message) {
    if (length != WP_ACCELEROMETER_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_x_m_s2 = signed_field(bits, 0, 16);
    const int32_t raw_y_m_s2 = signed_field(bits, 16, 16);
    const int32_t raw_z_m_s2 = signed_field(bits, 32, 16);
    const uint32_t raw_tick = field(bits, 48, 16);
    if (raw_x_m_s2 < -32767) {
        return false;
    }
    if (raw_y_m_s2 < -32767) {
        return false;
    }
    if (raw_z_m_s2 < -32767) {
        return false;
    }
    message->x_m_s2 = (float)raw_x_m_s2 * 0.00390625f;
    message->y_m_s2 = (float)raw_y_m_s2 * 0.00390625f;
    message->z_m_s2 = (float)raw_z_m_s2 * 0.00390625f;
    message->tick = (uint16_t)raw_tick;
    return true;
}

bool wp_gyro_encode(const wp_gyro *message, uint8_t *payload) {
    if (!within(message->x_rad_s, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    if (!within(message->y_rad_s, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    if (!within(message->z_rad_s, -31.9990234375f, 31.9990234375f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->x_rad_s * 2048.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->y_rad_s * 2048.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->z_rad_s * 2048.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)message->tick << 48;
    store(payload, WP_GYRO_LENGTH, bits);
    return true;
}

bool wp_gyro_decode(const uint8_t *payload, size_t length, wp_gyro *message) {
    if (length != WP_GYRO_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_x_rad_s = signed_field(bits, 0, 16);
    const int32_t raw_y_rad_s = signed_field(bits, 16, 16);
    const int32_t raw_z_rad_s = signed_field(bits, 32, 16);
    const uint32_t raw_tick = field(bits, 48, 16);
    if (raw_x_rad_s < -32767) {
        return false;
    }
    if (raw_y_rad_s < -32767) {
        return false;
    }
    if (raw_z_rad_s < -32767) {
        return false;
    }
    message->x_rad_s = (float)raw_x_rad_s * 0.0009765625f;
    message->y_rad_s = (float)raw_y_rad_s * 0.0009765625f;
    message->z_rad_s = (float)raw_z_rad_s * 0.0009765625f;
    message->tick = (uint16_t)raw_tick;
    return true;
}

bool wp_status_encode(const wp_status *message, uint8_t *payload) {
    if (message->state > 6u) {
        return false;
    }
    if (message->mode > 1u) {
        return false;
    }
    if (message->fault > 8u) {
        return false;
    }
    if (message->fault_wheel > 4u) {
        return false;
    }
    if (message->stop_reason > 5u) {
        return false;
    }
    if (message->reset_cause > 7u) {
        return false;
    }
    if (message->arm_refusal > 7u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->state;
    bits |= (uint64_t)message->mode << 4;
    bits |= (uint64_t)message->fault << 8;
    bits |= (uint64_t)message->fault_wheel << 13;
    bits |= (uint64_t)message->stop_reason << 16;
    bits |= (uint64_t)message->reset_cause << 20;
    bits |= (uint64_t)message->nonce << 24;
    bits |= (uint64_t)message->arm_refusal << 40;
    bits |= (uint64_t)message->limited << 48;
    store(payload, WP_STATUS_LENGTH, bits);
    return true;
}

bool wp_status_decode(const uint8_t *payload, size_t length, wp_status *message) {
    if (length != WP_STATUS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_state = field(bits, 0, 4);
    const uint32_t raw_mode = field(bits, 4, 4);
    const uint32_t raw_fault = field(bits, 8, 5);
    const uint32_t raw_fault_wheel = field(bits, 13, 3);
    const uint32_t raw_stop_reason = field(bits, 16, 4);
    const uint32_t raw_reset_cause = field(bits, 20, 4);
    const uint32_t raw_nonce = field(bits, 24, 16);
    const uint32_t raw_arm_refusal = field(bits, 40, 8);
    const uint32_t raw_limited = field(bits, 48, 16);
    if (raw_state > 6u) {
        return false;
    }
    if (raw_mode > 1u) {
        return false;
    }
    if (raw_fault > 8u) {
        return false;
    }
    if (raw_fault_wheel > 4u) {
        return false;
    }
    if (raw_stop_reason > 5u) {
        return false;
    }
    if (raw_reset_cause > 7u) {
        return false;
    }
    if (raw_arm_refusal > 7u) {
        return false;
    }
    message->state = (uint8_t)raw_state;
    message->mode = (uint8_t)raw_mode;
    message->fault = (uint8_t)raw_fault;
    message->fault_wheel = (uint8_t)raw_fault_wheel;
    message->stop_reason = (uint8_t)raw_stop_reason;
    message->reset_cause = (uint8_t)raw_reset_cause;
    message->nonce = (uint16_t)raw_nonce;
    message->arm_refusal = (uint8_t)raw_arm_refusal;
    message->limited = (uint16_t)raw_limited;
    return true;
}

bool wp_power_encode(const wp_power *message, uint8_t *payload) {
    if (!within(message->battery_v, -255.9921875f, 255.9921875f)) {
        return false;
    }
    if (!within(message->battery_a, -255.9921875f, 255.9921875f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->battery_v * 256.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->battery_a * 256.0f) & 0xFFFFu) << 16;
    store(payload, WP_POWER_LENGTH, bits);
    return true;
}

bool wp_power_decode(const uint8_t *payload, size_t length, wp_power *message) {
    if (length != WP_POWER_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_battery_v = signed_field(bits, 0, 16);
    const int32_t raw_battery_a = signed_field(bits, 16, 16);
    if (raw_battery_v < -32767) {
        return false;
    }
    if (raw_battery_a < -32767) {
        return false;
    }
    message->battery_v = (float)raw_battery_v * 0.0078125f;
    message->battery_a = (float)raw_battery_a * 0.0078125f;
    return true;
}

bool wp_temperatures_encode(const wp_temperatures *message, uint8_t *payload) {
    if (!within(message->fl_degc, -255.9921875f, 255.9921875f)) {
        return false;
    }
    if (!within(message->fr_degc, -255.9921875f, 255.9921875f)) {
        return false;
    }
    if (!within(message->rr_degc, -255.9921875f, 255.9921875f)) {
        return false;
    }
    if (!within(message->rl_degc, -255.9921875f, 255.9921875f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->fl_degc * 256.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->fr_degc * 256.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->rr_degc * 256.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)(nearest(message->rl_degc * 256.0f) & 0xFFFFu) << 48;
    store(payload, WP_TEMPERATURES_LENGTH, bits);
    return true;
}

bool wp_temperatures_decode(const uint8_t *payload, size_t length, wp_temperatures *message) {
    if (length != WP_TEMPERATURES_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_fl_degc = signed_field(bits, 0, 16);
    const int32_t raw_fr_degc = signed_field(bits, 16, 16);
    const int32_t raw_rr_degc = signed_field(bits, 32, 16);
    const int32_t raw_rl_degc = signed_field(bits, 48, 16);
    if (raw_fl_degc < -32767) {
        return false;
    }
    if (raw_fr_degc < -32767) {
        return false;
    }
    if (raw_rr_degc < -32767) {
        return false;
    }
    if (raw_rl_degc < -32767) {
        return false;
    }
    message->fl_degc = (float)raw_fl_degc * 0.0078125f;
    message->fr_degc = (float)raw_fr_degc * 0.0078125f;
    message->rr_degc = (float)raw_rr_degc * 0.0078125f;
    message->rl_degc = (float)raw_rl_degc * 0.0078125f;
    return true;
}

bool wp_link_counters_encode(const wp_link_counters *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->cobs;
    bits |= (uint64_t)message->crc << 8;
    bits |= (uint64_t)message->length << 16;
    bits |= (uint64_t)message->unknown_id << 24;
    bits |= (uint64_t)message->range << 32;
    bits |= (uint64_t)message->session << 40;
    bits |= (uint64_t)message->stale << 48;
    bits |= (uint64_t)message->state << 56;
    store(payload, WP_LINK_COUNTERS_LENGTH, bits);
    return true;
}

bool wp_link_counters_decode(const uint8_t *payload, size_t length, wp_link_counters *message) {
    if (length != WP_LINK_COUNTERS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_cobs = field(bits, 0, 8);
    const uint32_t raw_crc = field(bits, 8, 8);
    const uint32_t raw_length = field(bits, 16, 8);
    const uint32_t raw_unknown_id = field(bits, 24, 8);
    const uint32_t raw_range = field(bits, 32, 8);
    const uint32_t raw_session = field(bits, 40, 8);
    const uint32_t raw_stale = field(bits, 48, 8);
    const uint32_t raw_state = field(bits, 56, 8);
    message->cobs = (uint8_t)raw_cobs;
    message->crc = (uint8_t)raw_crc;
    message->length = (uint8_t)raw_length;
    message->unknown_id = (uint8_t)raw_unknown_id;
    message->range = (uint8_t)raw_range;
    message->session = (uint8_t)raw_session;
    message->stale = (uint8_t)raw_stale;
    message->state = (uint8_t)raw_state;
    return true;
}

bool wp_absolute_front_encode(const wp_absolute_front *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->fl_count;
    bits |= (uint64_t)message->fr_count << 32;
    store(payload, WP_ABSOLUTE_FRONT_LENGTH, bits);
    return true;
}

bool wp_absolute_front_decode(const uint8_t *payload, size_t length, wp_absolute_front *message) {
    if (length != WP_ABSOLUTE_FRONT_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_fl_count = field(bits, 0, 32);
    const uint32_t raw_fr_count = field(bits, 32, 32);
    message->fl_count = raw_fl_count;
    message->fr_count = raw_fr_count;
    return true;
}

bool wp_absolute_rear_encode(const wp_absolute_rear *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->rr_count;
    bits |= (uint64_t)message->rl_count << 32;
    store(payload, WP_ABSOLUTE_REAR_LENGTH, bits);
    return true;
}

bool wp_absolute_rear_decode(const uint8_t *payload, size_t length, wp_absolute_rear *message) {
    if (length != WP_ABSOLUTE_REAR_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_rr_count = field(bits, 0, 32);
    const uint32_t raw_rl_count = field(bits, 32, 32);
    message->rr_count = raw_rr_count;
    message->rl_count = raw_rl_count;
    return true;
}

bool wp_port_counters_encode(const wp_port_counters *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->overrun;
    bits |= (uint64_t)message->feedforward_unmatched << 8;
    bits |= (uint64_t)message->transmit_overrun << 16;
    bits |= (uint64_t)message->serial_lost << 24;
    bits |= (uint64_t)message->can_errors << 32;
    bits |= (uint64_t)message->bus_off << 40;
    store(payload, WP_PORT_COUNTERS_LENGTH, bits);
    return true;
}

bool wp_port_counters_decode(const uint8_t *payload, size_t length, wp_port_counters *message) {
    if (length != WP_PORT_COUNTERS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_overrun = field(bits, 0, 8);
    const uint32_t raw_feedforward_unmatched = field(bits, 8, 8);
    const uint32_t raw_transmit_overrun = field(bits, 16, 8);
    const uint32_t raw_serial_lost = field(bits, 24, 8);
    const uint32_t raw_can_errors = field(bits, 32, 8);
    const uint32_t raw_bus_off = field(bits, 40, 8);
    message->overrun = (uint8_t)raw_overrun;
    message->feedforward_unmatched = (uint8_t)raw_feedforward_unmatched;
    message->transmit_overrun = (uint8_t)raw_transmit_overrun;
    message->serial_lost = (uint8_t)raw_serial_lost;
    message->can_errors = (uint8_t)raw_can_errors;
    message->bus_off = (uint8_t)raw_bus_off;
    return true;
}

bool wp_time_sync_request_encode(const wp_time_sync_request *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->sequence;
    store(payload, WP_TIME_SYNC_REQUEST_LENGTH, bits);
    return true;
}

bool wp_time_sync_request_decode(const uint8_t *payload, size_t length, wp_time_sync_request *message) {
    if (length != WP_TIME_SYNC_REQUEST_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_sequence = field(bits, 0, 8);
    message->sequence = (uint8_t)raw_sequence;
    return true;
}

bool wp_time_sync_response_encode(const wp_time_sync_response *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->received_us;
    bits |= (uint64_t)message->held_us << 32;
    bits |= (uint64_t)message->sequence << 48;
    store(payload, WP_TIME_SYNC_RESPONSE_LENGTH, bits);
    return true;
}

bool wp_time_sync_response_decode(const uint8_t *payload, size_t length, wp_time_sync_response *message) {
    if (length != WP_TIME_SYNC_RESPONSE_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_received_us = field(bits, 0, 32);
    const uint32_t raw_held_us = field(bits, 32, 16);
    const uint32_t raw_sequence = field(bits, 48, 8);
    message->received_us = raw_received_us;
    message->held_us = (uint16_t)raw_held_us;
    message->sequence = (uint8_t)raw_sequence;
    return true;
}

bool wp_parameter_request_encode(const wp_parameter_request *message, uint8_t *payload) {
    if (message->operation > 5u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->parameter;
    bits |= (uint64_t)message->operation << 8;
    bits |= (uint64_t)message->transaction << 16;
    bits |= (uint64_t)message->value << 24;
    store(payload, WP_PARAMETER_REQUEST_LENGTH, bits);
    return true;
}

bool wp_parameter_request_decode(const uint8_t *payload, size_t length, wp_parameter_request *message) {
    if (length != WP_PARAMETER_REQUEST_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_parameter = field(bits, 0, 8);
    const uint32_t raw_operation = field(bits, 8, 8);
    const uint32_t raw_transaction = field(bits, 16, 8);
    const uint32_t raw_value = field(bits, 24, 32);
    if (raw_operation > 5u) {
        return false;
    }
    message->parameter = (uint8_t)raw_parameter;
    message->operation = (uint8_t)raw_operation;
    message->transaction = (uint8_t)raw_transaction;
    message->value = raw_value;
    return true;
}

bool wp_parameter_response_encode(const wp_parameter_response *message, uint8_t *payload) {
    if (message->operation > 5u) {
        return false;
    }
    if (message->result > 4u) {
        return false;
    }
    if (message->type > 1u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->parameter;
    bits |= (uint64_t)message->operation << 8;
    bits |= (uint64_t)message->transaction << 16;
    bits |= (uint64_t)message->result << 24;
    bits |= (uint64_t)message->type << 28;
    bits |= (uint64_t)message->value << 32;
    store(payload, WP_PARAMETER_RESPONSE_LENGTH, bits);
    return true;
}

bool wp_parameter_response_decode(const uint8_t *payload, size_t length, wp_parameter_response *message) {
    if (length != WP_PARAMETER_RESPONSE_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_parameter = field(bits, 0, 8);
    const uint32_t raw_operation = field(bits, 8, 8);
    const uint32_t raw_transaction = field(bits, 16, 8);
    const uint32_t raw_result = field(bits, 24, 4);
    const uint32_t raw_type = field(bits, 28, 4);
    const uint32_t raw_value = field(bits, 32, 32);
    if (raw_operation > 5u) {
        return false;
    }
    if (raw_result > 4u) {
        return false;
    }
    if (raw_type > 1u) {
        return false;
    }
    message->parameter = (uint8_t)raw_parameter;
    message->operation = (uint8_t)raw_operation;
    message->transaction = (uint8_t)raw_transaction;
    message->result = (uint8_t)raw_result;
    message->type = (uint8_t)raw_type;
    message->value = raw_value;
    return true;
}

bool wp_step_encode(const wp_step *message, uint8_t *payload) {
    if (message->substeps > 1000u) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)message->tick;
    bits |= (uint64_t)message->substeps << 32;
    store(payload, WP_STEP_LENGTH, bits);
    return true;
}

bool wp_step_decode(const uint8_t *payload, size_t length, wp_step *message) {
    if (length != WP_STEP_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_tick = field(bits, 0, 32);
    const uint32_t raw_substeps = field(bits, 32, 16);
    if (raw_substeps > 1000u) {
        return false;
    }
    message->tick = raw_tick;
    message->substeps = (uint16_t)raw_substeps;
    return true;
}

bool wp_step_done_encode(const wp_step_done *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->tick;
    store(payload, WP_STEP_DONE_LENGTH, bits);
    return true;
}

bool wp_step_done_decode(const uint8_t *payload, size_t length, wp_step_done *message) {
    if (length != WP_STEP_DONE_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_tick = field(bits, 0, 32);
    message->tick = raw_tick;
    return true;
}

bool wp_hello_request_encode(const wp_hello_request *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->protocol_version;
    store(payload, WP_HELLO_REQUEST_LENGTH, bits);
    return true;
}

bool wp_hello_request_decode(const uint8_t *payload, size_t length, wp_hello_request *message) {
    if (length != WP_HELLO_REQUEST_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_protocol_version = field(bits, 0, 8);
    message->protocol_version = (uint8_t)raw_protocol_version;
    return true;
}

bool wp_hello_identity_encode(const wp_hello_identity *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->protocol_version;
    bits |= (uint64_t)message->pages << 8;
    bits |= (uint64_t)message->capabilities << 16;
    bits |= (uint64_t)message->schema_hash << 32;
    store(payload, WP_HELLO_IDENTITY_LENGTH, bits);
    return true;
}

bool wp_hello_identity_decode(const uint8_t *payload, size_t length, wp_hello_identity *message) {
    if (length != WP_HELLO_IDENTITY_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_protocol_version = field(bits, 0, 8);
    const uint32_t raw_pages = field(bits, 8, 8);
    const uint32_t raw_capabilities = field(bits, 16, 16);
    const uint32_t raw_schema_hash = field(bits, 32, 32);
    message->protocol_version = (uint8_t)raw_protocol_version;
    message->pages = (uint8_t)raw_pages;
    message->capabilities = (uint16_t)raw_capabilities;
    message->schema_hash = raw_schema_hash;
    return true;
}

bool wp_hello_firmware_encode(const wp_hello_firmware *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->major;
    bits |= (uint64_t)message->minor << 8;
    bits |= (uint64_t)message->patch << 16;
    bits |= (uint64_t)message->board << 24;
    bits |= (uint64_t)message->build << 32;
    store(payload, WP_HELLO_FIRMWARE_LENGTH, bits);
    return true;
}

bool wp_hello_firmware_decode(const uint8_t *payload, size_t length, wp_hello_firmware *message) {
    if (length != WP_HELLO_FIRMWARE_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_major = field(bits, 0, 8);
    const uint32_t raw_minor = field(bits, 8, 8);
    const uint32_t raw_patch = field(bits, 16, 8);
    const uint32_t raw_board = field(bits, 24, 8);
    const uint32_t raw_build = field(bits, 32, 32);
    message->major = (uint8_t)raw_major;
    message->minor = (uint8_t)raw_minor;
    message->patch = (uint8_t)raw_patch;
    message->board = (uint8_t)raw_board;
    message->build = raw_build;
    return true;
}

bool wp_hello_parameters_encode(const wp_hello_parameters *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->parameter_hash;
    bits |= (uint64_t)message->watchdog_ms << 32;
    bits |= (uint64_t)message->feedback_period_ms << 48;
    store(payload, WP_HELLO_PARAMETERS_LENGTH, bits);
    return true;
}

bool wp_hello_parameters_decode(const uint8_t *payload, size_t length, wp_hello_parameters *message) {
    if (length != WP_HELLO_PARAMETERS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_parameter_hash = field(bits, 0, 32);
    const uint32_t raw_watchdog_ms = field(bits, 32, 16);
    const uint32_t raw_feedback_period_ms = field(bits, 48, 16);
    message->parameter_hash = raw_parameter_hash;
    message->watchdog_ms = (uint16_t)raw_watchdog_ms;
    message->feedback_period_ms = (uint16_t)raw_feedback_period_ms;
    return true;
}

bool wp_hello_geometry_encode(const wp_hello_geometry *message, uint8_t *payload) {
    if (!within(message->wheel_radius_m, -3.9998779296875f, 3.9998779296875f)) {
        return false;
    }
    if (!within(message->half_length_m, -3.9998779296875f, 3.9998779296875f)) {
        return false;
    }
    if (!within(message->half_width_m, -3.9998779296875f, 3.9998779296875f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->wheel_radius_m * 16384.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->half_length_m * 16384.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->half_width_m * 16384.0f) & 0xFFFFu) << 32;
    bits |= (uint64_t)message->counts_per_revolution << 48;
    store(payload, WP_HELLO_GEOMETRY_LENGTH, bits);
    return true;
}

bool wp_hello_geometry_decode(const uint8_t *payload, size_t length, wp_hello_geometry *message) {
    if (length != WP_HELLO_GEOMETRY_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_wheel_radius_m = signed_field(bits, 0, 16);
    const int32_t raw_half_length_m = signed_field(bits, 16, 16);
    const int32_t raw_half_width_m = signed_field(bits, 32, 16);
    const uint32_t raw_counts_per_revolution = field(bits, 48, 16);
    if (raw_wheel_radius_m < -32767) {
        return false;
    }
    if (raw_half_length_m < -32767) {
        return false;
    }
    if (raw_half_width_m < -32767) {
        return false;
    }
    message->wheel_radius_m = (float)raw_wheel_radius_m * 0.0001220703125f;
    message->half_length_m = (float)raw_half_length_m * 0.0001220703125f;
    message->half_width_m = (float)raw_half_width_m * 0.0001220703125f;
    message->counts_per_revolution = (uint16_t)raw_counts_per_revolution;
    return true;
}

bool wp_hello_limits_encode(const wp_hello_limits *message, uint8_t *payload) {
    if (!within(message->speed_limit_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->overspeed_rad_s, -127.99609375f, 127.99609375f)) {
        return false;
    }
    if (!within(message->torque_limit_n_m, -127.99609375f, 127.99609375f)) {
        return false;
    }
    uint64_t bits = 0;
    bits |= (uint64_t)(nearest(message->speed_limit_rad_s * 512.0f) & 0xFFFFu);
    bits |= (uint64_t)(nearest(message->overspeed_rad_s * 512.0f) & 0xFFFFu) << 16;
    bits |= (uint64_t)(nearest(message->torque_limit_n_m * 512.0f) & 0xFFFFu) << 32;
    store(payload, WP_HELLO_LIMITS_LENGTH, bits);
    return true;
}

bool wp_hello_limits_decode(const uint8_t *payload, size_t length, wp_hello_limits *message) {
    if (length != WP_HELLO_LIMITS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const int32_t raw_speed_limit_rad_s = signed_field(bits, 0, 16);
    const int32_t raw_overspeed_rad_s = signed_field(bits, 16, 16);
    const int32_t raw_torque_limit_n_m = signed_field(bits, 32, 16);
    if (raw_speed_limit_rad_s < -32767) {
        return false;
    }
    if (raw_overspeed_rad_s < -32767) {
        return false;
    }
    if (raw_torque_limit_n_m < -32767) {
        return false;
    }
    message->speed_limit_rad_s = (float)raw_speed_limit_rad_s * 0.00390625f;
    message->overspeed_rad_s = (float)raw_overspeed_rad_s * 0.00390625f;
    message->torque_limit_n_m = (float)raw_torque_limit_n_m * 0.00390625f;
    return true;
}

bool wp_hello_fault_status_encode(const wp_hello_fault_status *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->cfsr;
    bits |= (uint64_t)message->hfsr << 32;
    store(payload, WP_HELLO_FAULT_STATUS_LENGTH, bits);
    return true;
}

bool wp_hello_fault_status_decode(const uint8_t *payload, size_t length, wp_hello_fault_status *message) {
    if (length != WP_HELLO_FAULT_STATUS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_cfsr = field(bits, 0, 32);
    const uint32_t raw_hfsr = field(bits, 32, 32);
    message->cfsr = raw_cfsr;
    message->hfsr = raw_hfsr;
    return true;
}

bool wp_hello_fault_place_encode(const wp_hello_fault_place *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->pc;
    bits |= (uint64_t)message->lr << 32;
    store(payload, WP_HELLO_FAULT_PLACE_LENGTH, bits);
    return true;
}

bool wp_hello_fault_place_decode(const uint8_t *payload, size_t length, wp_hello_fault_place *message) {
    if (length != WP_HELLO_FAULT_PLACE_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_pc = field(bits, 0, 32);
    const uint32_t raw_lr = field(bits, 32, 32);
    message->pc = raw_pc;
    message->lr = raw_lr;
    return true;
}

bool wp_hello_fault_address_encode(const wp_hello_fault_address *message, uint8_t *payload) {
    uint64_t bits = 0;
    bits |= (uint64_t)message->mmfar;
    bits |= (uint64_t)message->bfar << 32;
    store(payload, WP_HELLO_FAULT_ADDRESS_LENGTH, bits);
    return true;
}

bool wp_hello_fault_address_decode(const uint8_t *payload, size_t length, wp_hello_fault_address *message) {
    if (length != WP_HELLO_FAULT_ADDRESS_LENGTH) {
        return false;
    }
    const uint64_t bits = load(payload, length);
    const uint32_t raw_mmfar = field(bits, 0, 32);
    const uint32_t raw_bfar = field(bits, 32, 32);
    message->mmfar = raw_mmfar;
    message->bfar = raw_bfar;
    return true;
}
