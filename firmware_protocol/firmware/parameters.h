/* What the firmware runs with. Parameters change in IDLE only; the host compares their hash before it arms.
 */
#ifndef WHEEL_PARAMETERS_H
#define WHEEL_PARAMETERS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* cffi: begin */
typedef struct {
    float counts_per_revolution;    /* encoder counts a revolution of the wheel */
    float wheel_radius_m;           /* told in HELLO */
    float half_length_m;            /* told in HELLO */
    float half_width_m;             /* told in HELLO */
    float tracking_bandwidth_rad_s; /* of the filter that estimates the wheel speed */
    float speed_kp_n_m_s_rad;       /* speed loop, proportional */
    float speed_ki_n_m_rad;         /* speed loop, integral */
    float torque_limit_n_m;         /* a wheel; beyond it all four are scaled */
    float torque_constant_n_m_a;    /* torque at the axle for one ampere, and back-EMF for one rad/s */
    float motor_resistance_ohm;
    float motor_inductance_h;
    float current_limit_a;         /* a motor; beyond it all four are scaled, half as much again is a fault */
    float current_bandwidth_rad_s; /* of the current loop */
    float temperature_limit_degc;  /* a motor; all four are scaled from 15 below on, here it is a fault */
    float undervoltage_v;          /* a battery below this is a fault; 0 for never */
    float overspeed_rad_s;         /* a wheel faster than this is a fault */
    float encoder_fault_s;   /* an encoder that stands still or counts backward for so long is a fault */
    float watchdog_s;        /* without a fresh command for so long the robot stops */
    float ramp_s;            /* the set point reaches zero in this time */
    float feedback_period_s; /* between two snapshots */
} wheel_parameters;

typedef struct {
    const char *name;
    uint8_t type; /* of the value on the wire, enum wp_type */
    float minimum;
    float maximum;
} wheel_parameter_info;

#define WHEEL_PARAMETER_COUNT 20
/* cffi: end */

/* The parameters in the order of wheel_parameters, which is the order of their hash. */
extern const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT];

/* What a port keeps across a reset: a mark, the number of parameters, their values, and a CRC-32 over all. */
#define WHEEL_STORED_SIZE (8u + 4u * WHEEL_PARAMETER_COUNT + 4u)

float wheel_parameter_get(const wheel_parameters *parameters, size_t index);

/* False, and nothing changed, unless the value is a number within its range. */
bool wheel_parameter_set(wheel_parameters *parameters, size_t index, float value);

/* The value as it crosses the wire, and back; false when these bits are no value of the parameter's type. */
uint32_t wheel_parameter_bits(size_t index, float value);
bool wheel_parameter_from_bits(size_t index, uint32_t bits, float *value);

void wheel_parameters_store(const wheel_parameters *parameters, uint8_t bytes[WHEEL_STORED_SIZE]);

/* False, and nothing changed, unless the bytes are whole, of this table, and every value is in its range. */
bool wheel_parameters_load(wheel_parameters *parameters, const uint8_t bytes[WHEEL_STORED_SIZE]);

/* cffi: begin */
/* Index of the first parameter that is not finite or out of its range, or -1 when all are good. */
int wheel_parameters_invalid(const wheel_parameters *parameters);

/* CRC-32 (IEEE 802.3) over the values as little-endian binary32, in the order of the table. */
uint32_t wheel_parameters_hash(const wheel_parameters *parameters);
/* cffi: end */

#endif
