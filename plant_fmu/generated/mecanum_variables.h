/* Made from variables.toml by generate.py; do not edit. */
#ifndef MECANUM_VARIABLES_H
#define MECANUM_VARIABLES_H

#include <math.h>
#include <stdint.h>

#define MECANUM_MODEL_NAME "mecanum"
#define MECANUM_GUID "{b841e770-1f65-17c0-66f6-b77ff035ed32}"
#define MECANUM_WHEELS 4
#define MECANUM_VARIABLE_COUNT 47

enum {
    MECANUM_CORIOLIS_RIGID = 1,
    MECANUM_CORIOLIS_PAPER = 2,
};

typedef struct {
    double wheel_torque_n_m[MECANUM_WHEELS];
} mecanum_inputs;

typedef struct {
    double pose_x_m;
    double pose_y_m;
    double pose_heading_rad;
    double twist_vx_m_s;
    double twist_vy_m_s;
    double twist_yaw_rate_rad_s;
    double wheel_speed_rad_s[MECANUM_WHEELS];
    double wheel_angle_rad[MECANUM_WHEELS];
    int32_t wheel_count[MECANUM_WHEELS];
    double wheel_current_a[MECANUM_WHEELS];
    double gyro_x_rad_s;
    double gyro_y_rad_s;
    double gyro_z_rad_s;
} mecanum_outputs;

typedef struct {
    double mass_kg;
    double inertia_kg_m2;
    double wheel_radius_m;
    double half_length_m;
    double half_width_m;
    double wheel_inertia_kg_m2;
    double friction_coefficient;
    double friction_speed_rad_s;
    double viscous_n_m_s_rad;
    double torque_constant_n_m_a;
    int32_t counts_per_revolution;
    double start_x_m;
    double start_y_m;
    double start_heading_rad;
    double start_vx_m_s;
    double start_vy_m_s;
    double start_yaw_rate_rad_s;
    int32_t coriolis;
} mecanum_parameters;

/* X(value reference, type, causality, member of the snapshot, start, min, max, name) */
/* clang-format off */
#define MECANUM_VARIABLES(X) \
    X(0, REAL, INPUT, inputs.wheel_torque_n_m[0], 0.0, -INFINITY, INFINITY, "wheel.fl.torque_n_m") \
    X(1, REAL, INPUT, inputs.wheel_torque_n_m[1], 0.0, -INFINITY, INFINITY, "wheel.fr.torque_n_m") \
    X(2, REAL, INPUT, inputs.wheel_torque_n_m[2], 0.0, -INFINITY, INFINITY, "wheel.rr.torque_n_m") \
    X(3, REAL, INPUT, inputs.wheel_torque_n_m[3], 0.0, -INFINITY, INFINITY, "wheel.rl.torque_n_m") \
    X(4, REAL, OUTPUT, outputs.pose_x_m, 0.0, -INFINITY, INFINITY, "pose.x_m") \
    X(5, REAL, OUTPUT, outputs.pose_y_m, 0.0, -INFINITY, INFINITY, "pose.y_m") \
    X(6, REAL, OUTPUT, outputs.pose_heading_rad, 0.0, -INFINITY, INFINITY, "pose.heading_rad") \
    X(7, REAL, OUTPUT, outputs.twist_vx_m_s, 0.0, -INFINITY, INFINITY, "twist.vx_m_s") \
    X(8, REAL, OUTPUT, outputs.twist_vy_m_s, 0.0, -INFINITY, INFINITY, "twist.vy_m_s") \
    X(9, REAL, OUTPUT, outputs.twist_yaw_rate_rad_s, 0.0, -INFINITY, INFINITY, "twist.yaw_rate_rad_s") \
    X(10, REAL, OUTPUT, outputs.wheel_speed_rad_s[0], 0.0, -INFINITY, INFINITY, "wheel.fl.speed_rad_s") \
    X(11, REAL, OUTPUT, outputs.wheel_speed_rad_s[1], 0.0, -INFINITY, INFINITY, "wheel.fr.speed_rad_s") \
    X(12, REAL, OUTPUT, outputs.wheel_speed_rad_s[2], 0.0, -INFINITY, INFINITY, "wheel.rr.speed_rad_s") \
    X(13, REAL, OUTPUT, outputs.wheel_speed_rad_s[3], 0.0, -INFINITY, INFINITY, "wheel.rl.speed_rad_s") \
    X(14, REAL, OUTPUT, outputs.wheel_angle_rad[0], 0.0, -INFINITY, INFINITY, "wheel.fl.angle_rad") \
    X(15, REAL, OUTPUT, outputs.wheel_angle_rad[1], 0.0, -INFINITY, INFINITY, "wheel.fr.angle_rad") \
    X(16, REAL, OUTPUT, outputs.wheel_angle_rad[2], 0.0, -INFINITY, INFINITY, "wheel.rr.angle_rad") \
    X(17, REAL, OUTPUT, outputs.wheel_angle_rad[3], 0.0, -INFINITY, INFINITY, "wheel.rl.angle_rad") \
    X(18, INTEGER, OUTPUT, outputs.wheel_count[0], 0.0, -2147483648.0, 2147483647.0, "wheel.fl.count") \
    X(19, INTEGER, OUTPUT, outputs.wheel_count[1], 0.0, -2147483648.0, 2147483647.0, "wheel.fr.count") \
    X(20, INTEGER, OUTPUT, outputs.wheel_count[2], 0.0, -2147483648.0, 2147483647.0, "wheel.rr.count") \
    X(21, INTEGER, OUTPUT, outputs.wheel_count[3], 0.0, -2147483648.0, 2147483647.0, "wheel.rl.count") \
    X(22, REAL, OUTPUT, outputs.wheel_current_a[0], 0.0, -INFINITY, INFINITY, "wheel.fl.current_a") \
    X(23, REAL, OUTPUT, outputs.wheel_current_a[1], 0.0, -INFINITY, INFINITY, "wheel.fr.current_a") \
    X(24, REAL, OUTPUT, outputs.wheel_current_a[2], 0.0, -INFINITY, INFINITY, "wheel.rr.current_a") \
    X(25, REAL, OUTPUT, outputs.wheel_current_a[3], 0.0, -INFINITY, INFINITY, "wheel.rl.current_a") \
    X(26, REAL, OUTPUT, outputs.gyro_x_rad_s, 0.0, -INFINITY, INFINITY, "gyro.x_rad_s") \
    X(27, REAL, OUTPUT, outputs.gyro_y_rad_s, 0.0, -INFINITY, INFINITY, "gyro.y_rad_s") \
    X(28, REAL, OUTPUT, outputs.gyro_z_rad_s, 0.0, -INFINITY, INFINITY, "gyro.z_rad_s") \
    X(29, REAL, PARAMETER, parameters.mass_kg, 20.0, 0.01, 10000.0, "mass_kg") \
    X(30, REAL, PARAMETER, parameters.inertia_kg_m2, 0.56, 1e-06, 10000.0, "inertia_kg_m2") \
    X(31, REAL, PARAMETER, parameters.wheel_radius_m, 0.075, 0.001, 10.0, "wheel_radius_m") \
    X(32, REAL, PARAMETER, parameters.half_length_m, 0.3, 0.001, 10.0, "half_length_m") \
    X(33, REAL, PARAMETER, parameters.half_width_m, 0.3, 0.001, 10.0, "half_width_m") \
    X(34, REAL, PARAMETER, parameters.wheel_inertia_kg_m2, 0.005, 0.0, 100.0, "wheel_inertia_kg_m2") \
    X(35, REAL, PARAMETER, parameters.friction_coefficient, 0.0, 0.0, 2.0, "friction_coefficient") \
    X(36, REAL, PARAMETER, parameters.friction_speed_rad_s, 0.1, 0.01, 100.0, "friction_speed_rad_s") \
    X(37, REAL, PARAMETER, parameters.viscous_n_m_s_rad, 0.0, 0.0, 10.0, "viscous_n_m_s_rad") \
    X(38, REAL, PARAMETER, parameters.torque_constant_n_m_a, 1.25, 1e-06, 10000.0, "torque_constant_n_m_a") \
    X(39, INTEGER, PARAMETER, parameters.counts_per_revolution, 4096.0, 1.0, 16777216.0, "counts_per_revolution") \
    X(40, REAL, PARAMETER, parameters.start_x_m, 0.0, -INFINITY, INFINITY, "start_x_m") \
    X(41, REAL, PARAMETER, parameters.start_y_m, 0.0, -INFINITY, INFINITY, "start_y_m") \
    X(42, REAL, PARAMETER, parameters.start_heading_rad, 0.0, -INFINITY, INFINITY, "start_heading_rad") \
    X(43, REAL, PARAMETER, parameters.start_vx_m_s, 0.0, -INFINITY, INFINITY, "start_vx_m_s") \
    X(44, REAL, PARAMETER, parameters.start_vy_m_s, 0.0, -INFINITY, INFINITY, "start_vy_m_s") \
    X(45, REAL, PARAMETER, parameters.start_yaw_rate_rad_s, 0.0, -INFINITY, INFINITY, "start_yaw_rate_rad_s") \
    X(46, INTEGER, PARAMETER, parameters.coriolis, 1.0, 1.0, 2.0, "coriolis")
/* clang-format on */

#endif
