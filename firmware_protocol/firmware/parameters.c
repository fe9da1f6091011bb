#include "parameters.h"

#include <stddef.h>
#include <string.h>

const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT] = {
    {"counts_per_revolution", 4.0f, 32768.0f},
    {"tracking_bandwidth_rad_s", 1.0f, 500.0f},
    {"speed_kp_n_m_s_rad", 0.0f, 100.0f},
    {"speed_ki_n_m_rad", 0.0f, 10000.0f},
    {"torque_limit_n_m", 0.0f, 15.99609375f},
    {"overspeed_rad_s", 1.0f, 127.0f},
    {"watchdog_s", 0.02f, 0.1f},
    {"ramp_s", 0.001f, 2.0f},
    {"feedback_period_s", 0.001f, 0.2f},
};

_Static_assert(sizeof(wheel_parameters) == WHEEL_PARAMETER_COUNT * sizeof(float),
               "the table and the structure have the same entries");

static float value_at(const wheel_parameters *parameters, size_t index) {
    float value;
    memcpy(&value, (const unsigned char *)parameters + index * sizeof value, sizeof value);
    return value;
}

int wheel_parameters_invalid(const wheel_parameters *parameters) {
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        const float value = value_at(parameters, i);
        /* Written so that NaN fails too. */
        if (!(value >= wheel_parameter_table[i].minimum && value <= wheel_parameter_table[i].maximum)) {
            return (int)i;
        }
    }
    return -1;
}

uint32_t wheel_parameters_hash(const wheel_parameters *parameters) {
    uint32_t crc = 0xFFFFFFFFu;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        const float value = value_at(parameters, i);
        uint32_t bits;
        memcpy(&bits, &value, sizeof bits);
        for (unsigned byte = 0; byte < 4u; byte++) {
            crc ^= (bits >> (8u * byte)) & 0xFFu;
            for (unsigned bit = 0; bit < 8u; bit++) {
                crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
            }
        }
    }
    return crc ^ 0xFFFFFFFFu;
}
