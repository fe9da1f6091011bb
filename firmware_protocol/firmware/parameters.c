#include "parameters.h"

#include <string.h>

#include "../generated/wheel_messages.h"

const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT] = {
    {"counts_per_revolution", WP_TYPE_UINT32, 4.0f, 32768.0f},
    {"wheel_radius_m", WP_TYPE_FLOAT32, 0.001f, 3.9f},
    {"half_length_m", WP_TYPE_FLOAT32, 0.001f, 3.9f},
    {"half_width_m", WP_TYPE_FLOAT32, 0.001f, 3.9f},
    {"tracking_bandwidth_rad_s", WP_TYPE_FLOAT32, 1.0f, 500.0f},
    {"speed_kp_n_m_s_rad", WP_TYPE_FLOAT32, 0.0f, 100.0f},
    {"speed_ki_n_m_rad", WP_TYPE_FLOAT32, 0.0f, 10000.0f},
    {"torque_limit_n_m", WP_TYPE_FLOAT32, 0.0f, 15.99609375f},
    {"torque_constant_n_m_a", WP_TYPE_FLOAT32, 0.001f, 100.0f},
    {"motor_resistance_ohm", WP_TYPE_FLOAT32, 0.001f, 1000.0f},
    {"motor_inductance_h", WP_TYPE_FLOAT32, 0.000001f, 10.0f},
    {"current_limit_a", WP_TYPE_FLOAT32, 0.0f, 21.0f},
    {"current_bandwidth_rad_s", WP_TYPE_FLOAT32, 10.0f, 5000.0f},
    {"temperature_limit_degc", WP_TYPE_FLOAT32, 0.0f, 200.0f},
    {"undervoltage_v", WP_TYPE_FLOAT32, 0.0f, 200.0f},
    {"overspeed_rad_s", WP_TYPE_FLOAT32, 1.0f, 127.0f},
    {"encoder_fault_s", WP_TYPE_FLOAT32, 0.02f, 1.0f},
    {"watchdog_s", WP_TYPE_FLOAT32, 0.02f, 0.1f},
    {"ramp_s", WP_TYPE_FLOAT32, 0.001f, 2.0f},
    {"feedback_period_s", WP_TYPE_FLOAT32, 0.001f, 0.2f},
};

_Static_assert(sizeof(wheel_parameters) == WHEEL_PARAMETER_COUNT * sizeof(float),
               "the table and the structure have the same entries");

static const uint8_t MARK[4] = {'W', 'H', 'P', '1'};

static uint32_t crc32(uint32_t crc, const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length; i++) {
        crc ^= bytes[i];
        for (unsigned bit = 0; bit < 8u; bit++) {
            crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
        }
    }
    return crc;
}

static void put_u32(uint8_t *bytes, uint32_t value) {
    for (unsigned i = 0; i < 4u; i++) {
        bytes[i] = (uint8_t)(value >> (8u * i));
    }
}

static uint32_t get_u32(const uint8_t *bytes) {
    uint32_t value = 0;
    for (unsigned i = 0; i < 4u; i++) {
        value |= (uint32_t)bytes[i] << (8u * i);
    }
    return value;
}

static uint32_t bits_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static float float_of(uint32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

float wheel_parameter_get(const wheel_parameters *parameters, size_t index) {
    float value;
    memcpy(&value, (const unsigned char *)parameters + index * sizeof value, sizeof value);
    return value;
}

static bool in_range(size_t index, float value) {
    /* Written so that NaN fails too. */
    return value >= wheel_parameter_table[index].minimum && value <= wheel_parameter_table[index].maximum;
}

bool wheel_parameter_set(wheel_parameters *parameters, size_t index, float value) {
    if (!in_range(index, value)) {
        return false;
    }
    memcpy((unsigned char *)parameters + index * sizeof value, &value, sizeof value);
    return true;
}

uint32_t wheel_parameter_bits(size_t index, float value) {
    return wheel_parameter_table[index].type == WP_TYPE_UINT32 ? (uint32_t)value : bits_of(value);
}

bool wheel_parameter_from_bits(size_t index, uint32_t bits, float *value) {
    if (wheel_parameter_table[index].type != WP_TYPE_UINT32) {
        *value = float_of(bits);
        return true;
    }
    /* Whole numbers up to here are floats too. */
    *value = (float)bits;
    return bits <= 0x1000000u;
}

int wheel_parameters_invalid(const wheel_parameters *parameters) {
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        if (!in_range(i, wheel_parameter_get(parameters, i))) {
            return (int)i;
        }
    }
    return -1;
}

uint32_t wheel_parameters_hash(const wheel_parameters *parameters) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        uint8_t bytes[4];
        put_u32(bytes, bits_of(wheel_parameter_get(parameters, i)));
        crc = crc32(crc, bytes, sizeof bytes);
    }
    return crc ^ 0xFFFFFFFFu;
}

void wheel_parameters_store(const wheel_parameters *parameters, uint8_t bytes[WHEEL_STORED_SIZE]) {
    memcpy(bytes, MARK, sizeof MARK);
    put_u32(bytes + 4, WHEEL_PARAMETER_COUNT);
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        put_u32(bytes + 8u + 4u * i, bits_of(wheel_parameter_get(parameters, i)));
    }
    put_u32(bytes + WHEEL_STORED_SIZE - 4u, crc32(0xFFFFFFFFu, bytes, WHEEL_STORED_SIZE - 4u) ^ 0xFFFFFFFFu);
}

bool wheel_parameters_load(wheel_parameters *parameters, const uint8_t bytes[WHEEL_STORED_SIZE]) {
    const uint32_t crc = crc32(0xFFFFFFFFu, bytes, WHEEL_STORED_SIZE - 4u) ^ 0xFFFFFFFFu;
    if (memcmp(bytes, MARK, sizeof MARK) != 0 || get_u32(bytes + 4) != WHEEL_PARAMETER_COUNT ||
        get_u32(bytes + WHEEL_STORED_SIZE - 4u) != crc) {
        return false;
    }
    wheel_parameters loaded;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        if (!wheel_parameter_set(&loaded, i, float_of(get_u32(bytes + 8u + 4u * i)))) {
            return false;
        }
    }
    *parameters = loaded;
    return true;
}
