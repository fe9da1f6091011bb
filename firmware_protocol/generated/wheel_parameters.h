/* Generated from parameters.toml by `python -m firmware_protocol.generate`; do not edit. */
#ifndef WHEEL_PARAMETERS_GENERATED_H
#define WHEEL_PARAMETERS_GENERATED_H

#define WP_PARAMETER_TABLE_HASH 0x23C7250Au

/* X(name, type, minimum, maximum) for every parameter. */
/* clang-format off */
#define WP_PARAMETERS(X) \
    X(counts_per_revolution, UINT32, 4.0f, 32768.0f) \
    X(wheel_radius_m, FLOAT32, 0.001f, 3.9f) \
    X(half_length_m, FLOAT32, 0.001f, 3.9f) \
    X(half_width_m, FLOAT32, 0.001f, 3.9f) \
    X(tracking_bandwidth_rad_s, FLOAT32, 1.0f, 500.0f) \
    X(speed_kp_n_m_s_rad, FLOAT32, 0.0f, 100.0f) \
    X(speed_ki_n_m_rad, FLOAT32, 0.0f, 10000.0f) \
    X(torque_limit_n_m, FLOAT32, 0.0f, 15.99609375f) \
    X(torque_constant_n_m_a, FLOAT32, 0.001f, 100.0f) \
    X(motor_resistance_ohm, FLOAT32, 0.001f, 1000.0f) \
    X(motor_inductance_h, FLOAT32, 1e-06f, 10.0f) \
    X(current_limit_a, FLOAT32, 0.0f, 21.0f) \
    X(current_bandwidth_rad_s, FLOAT32, 10.0f, 5000.0f) \
    X(temperature_limit_degc, FLOAT32, 0.0f, 200.0f) \
    X(undervoltage_v, FLOAT32, 0.0f, 200.0f) \
    X(overspeed_rad_s, FLOAT32, 1.0f, 127.0f) \
    X(encoder_fault_s, FLOAT32, 0.02f, 1.0f) \
    X(watchdog_s, FLOAT32, 0.02f, 0.1f) \
    X(ramp_s, FLOAT32, 0.001f, 2.0f) \
    X(feedback_period_s, FLOAT32, 0.001f, 0.2f)

/* cffi: begin */
typedef struct {
    float counts_per_revolution; /* encoder counts of one turn of the wheel, every edge counted */
    float wheel_radius_m; /* told in HELLO_GEOMETRY; the firmware does not reckon with it */
    float half_length_m; /* centre to axle, forward; told in HELLO_GEOMETRY */
    float half_width_m; /* centre to wheel, sideways; told in HELLO_GEOMETRY */
    float tracking_bandwidth_rad_s; /* of the filter that estimates the wheel speed */
    float speed_kp_n_m_s_rad; /* speed loop, proportional */
    float speed_ki_n_m_rad; /* speed loop, integral */
    float torque_limit_n_m; /* of one wheel; beyond it all four are scaled */
    float torque_constant_n_m_a; /* torque at the axle for one ampere, and back-EMF for one rad/s */
    float motor_resistance_ohm; /* of one motor, for the current loop */
    float motor_inductance_h; /* of one motor, for the current loop */
    float current_limit_a; /* of one motor; beyond it all four are scaled, half as much again is a fault */
    float current_bandwidth_rad_s; /* of the current loop */
    float temperature_limit_degc; /* of a winding: a fault; from 15 below on all four wheels are scaled */
    float undervoltage_v; /* a battery below this is a fault; 0 for never */
    float overspeed_rad_s; /* a wheel faster than this is a fault */
    float encoder_fault_s; /* an encoder that stands still or counts backward for so long is a fault */
    float watchdog_s; /* without a fresh command for so long the robot stops */
    float ramp_s; /* the set point reaches zero in this time */
    float feedback_period_s; /* between two snapshots */
} wheel_parameters;

#define WHEEL_PARAMETER_COUNT 20
/* cffi: end */
/* clang-format on */

#endif
