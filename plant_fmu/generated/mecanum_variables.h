/* Made from variables.toml by generate.py; do not edit. */
#ifndef MECANUM_VARIABLES_H
#define MECANUM_VARIABLES_H

#include <math.h>
#include <stdint.h>

#define MECANUM_MODEL_NAME "mecanum"
#define MECANUM_GUID "{bff8a517-7ec8-e1a4-4e08-c69e67ef1897}"
#define MECANUM_WHEELS 4
#define MECANUM_VARIABLE_COUNT 155

enum {
    MECANUM_CORIOLIS_RIGID = 1,
    MECANUM_CORIOLIS_PAPER = 2,
    MECANUM_CONTACT_RIGID = 1,
    MECANUM_CONTACT_SLIP = 2,
    MECANUM_ROLLERS_X = 1,
    MECANUM_ROLLERS_O = 2,
    MECANUM_DRIVE_TORQUE = 1,
    MECANUM_DRIVE_CURRENT = 2,
    MECANUM_DRIVE_VOLTAGE = 3,
};

typedef struct {
    double wheel_torque_n_m[MECANUM_WHEELS];
    double wheel_duty[MECANUM_WHEELS];
    double drive_enabled;
    double push_force_x_n;
    double push_force_y_n;
    double push_moment_n_m;
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
    int32_t wheel_index[MECANUM_WHEELS];
    double wheel_current_a[MECANUM_WHEELS];
    double wheel_axle_torque_n_m[MECANUM_WHEELS];
    double wheel_temperature_degc[MECANUM_WHEELS];
    double wheel_load_n[MECANUM_WHEELS];
    double wheel_slip_m_s[MECANUM_WHEELS];
    double tip_margin;
    double tip_rad;
    double gyro_x_rad_s;
    double gyro_y_rad_s;
    double gyro_z_rad_s;
    double accelerometer_x_m_s2;
    double accelerometer_y_m_s2;
    double accelerometer_z_m_s2;
    double battery_voltage_v;
    double battery_current_a;
    double energy_supplied_j;
    double energy_stored_j;
    double energy_lost_j;
} mecanum_outputs;

typedef struct {
    double mass_kg;
    double inertia_kg_m2;
    double com_x_m;
    double com_y_m;
    double com_height_m;
    double wheel_radius_m;
    double wheel_radius_factor[MECANUM_WHEELS];
    double half_length_m;
    double half_width_m;
    double wheel_inertia_kg_m2;
    double friction_coefficient;
    double viscous_n_m_s_rad;
    double wheel_friction_factor[MECANUM_WHEELS];
    double slope_rad;
    double slope_direction_rad;
    int32_t contact;
    int32_t rollers;
    int32_t coriolis;
    int32_t drive;
    double grip_coefficient;
    double wheel_grip_factor[MECANUM_WHEELS];
    double wheel_lifted[MECANUM_WHEELS];
    double blocks;
    double sideways_loss;
    double roller_friction_coefficient;
    double roller_stiffness_n_m;
    double roller_damping_n_s_m;
    double gear_ratio;
    double rotor_inertia_kg_m2;
    double motor_constant_n_m_a;
    double wheel_torque_factor[MECANUM_WHEELS];
    double motor_resistance_ohm;
    double motor_inductance_h;
    double winding_heat_capacity_j_k;
    double winding_to_air_k_w;
    double air_degc;
    double current_limit_a;
    double battery_voltage_v;
    double battery_fall_v_c;
    double battery_resistance_ohm;
    int32_t counts_per_revolution;
    double wheel_counts_factor[MECANUM_WHEELS];
    double wheel_encoder_error_rad[MECANUM_WHEELS];
    double imu_rate_hz;
    double gyro_noise_rad_s;
    double gyro_scale;
    double gyro_drift_rad_s2;
    double gyro_walk_rad_s;
    double gyro_bias_x_rad_s;
    double gyro_bias_y_rad_s;
    double gyro_bias_z_rad_s;
    double accelerometer_noise_m_s2;
    double accelerometer_bias_x_m_s2;
    double accelerometer_bias_y_m_s2;
    double accelerometer_bias_z_m_s2;
    double imu_roll_rad;
    double imu_pitch_rad;
    double imu_yaw_rad;
    int32_t seed;
    double start_x_m;
    double start_y_m;
    double start_heading_rad;
    double start_vx_m_s;
    double start_vy_m_s;
    double start_yaw_rate_rad_s;
    double longest_step_s;
} mecanum_parameters;

/* X(value reference, type, causality, member of the snapshot, start, min, max, name) */
/* clang-format off */
#define MECANUM_VARIABLES(X) \
    X(0, REAL, INPUT, inputs.wheel_torque_n_m[0], 0.0, -INFINITY, INFINITY, "wheel.fl.torque_n_m") \
    X(1, REAL, INPUT, inputs.wheel_torque_n_m[1], 0.0, -INFINITY, INFINITY, "wheel.fr.torque_n_m") \
    X(2, REAL, INPUT, inputs.wheel_torque_n_m[2], 0.0, -INFINITY, INFINITY, "wheel.rr.torque_n_m") \
    X(3, REAL, INPUT, inputs.wheel_torque_n_m[3], 0.0, -INFINITY, INFINITY, "wheel.rl.torque_n_m") \
    X(4, REAL, INPUT, inputs.wheel_duty[0], 0.0, -1.0, 1.0, "wheel.fl.duty") \
    X(5, REAL, INPUT, inputs.wheel_duty[1], 0.0, -1.0, 1.0, "wheel.fr.duty") \
    X(6, REAL, INPUT, inputs.wheel_duty[2], 0.0, -1.0, 1.0, "wheel.rr.duty") \
    X(7, REAL, INPUT, inputs.wheel_duty[3], 0.0, -1.0, 1.0, "wheel.rl.duty") \
    X(8, REAL, INPUT, inputs.drive_enabled, 1.0, 0.0, 1.0, "drive.enabled") \
    X(9, REAL, INPUT, inputs.push_force_x_n, 0.0, -INFINITY, INFINITY, "push.force_x_n") \
    X(10, REAL, INPUT, inputs.push_force_y_n, 0.0, -INFINITY, INFINITY, "push.force_y_n") \
    X(11, REAL, INPUT, inputs.push_moment_n_m, 0.0, -INFINITY, INFINITY, "push.moment_n_m") \
    X(12, REAL, OUTPUT, outputs.pose_x_m, 0.0, -INFINITY, INFINITY, "pose.x_m") \
    X(13, REAL, OUTPUT, outputs.pose_y_m, 0.0, -INFINITY, INFINITY, "pose.y_m") \
    X(14, REAL, OUTPUT, outputs.pose_heading_rad, 0.0, -INFINITY, INFINITY, "pose.heading_rad") \
    X(15, REAL, OUTPUT, outputs.twist_vx_m_s, 0.0, -INFINITY, INFINITY, "twist.vx_m_s") \
    X(16, REAL, OUTPUT, outputs.twist_vy_m_s, 0.0, -INFINITY, INFINITY, "twist.vy_m_s") \
    X(17, REAL, OUTPUT, outputs.twist_yaw_rate_rad_s, 0.0, -INFINITY, INFINITY, "twist.yaw_rate_rad_s") \
    X(18, REAL, OUTPUT, outputs.wheel_speed_rad_s[0], 0.0, -INFINITY, INFINITY, "wheel.fl.speed_rad_s") \
    X(19, REAL, OUTPUT, outputs.wheel_speed_rad_s[1], 0.0, -INFINITY, INFINITY, "wheel.fr.speed_rad_s") \
    X(20, REAL, OUTPUT, outputs.wheel_speed_rad_s[2], 0.0, -INFINITY, INFINITY, "wheel.rr.speed_rad_s") \
    X(21, REAL, OUTPUT, outputs.wheel_speed_rad_s[3], 0.0, -INFINITY, INFINITY, "wheel.rl.speed_rad_s") \
    X(22, REAL, OUTPUT, outputs.wheel_angle_rad[0], 0.0, -INFINITY, INFINITY, "wheel.fl.angle_rad") \
    X(23, REAL, OUTPUT, outputs.wheel_angle_rad[1], 0.0, -INFINITY, INFINITY, "wheel.fr.angle_rad") \
    X(24, REAL, OUTPUT, outputs.wheel_angle_rad[2], 0.0, -INFINITY, INFINITY, "wheel.rr.angle_rad") \
    X(25, REAL, OUTPUT, outputs.wheel_angle_rad[3], 0.0, -INFINITY, INFINITY, "wheel.rl.angle_rad") \
    X(26, INTEGER, OUTPUT, outputs.wheel_count[0], 0.0, -2147483648.0, 2147483647.0, "wheel.fl.count") \
    X(27, INTEGER, OUTPUT, outputs.wheel_count[1], 0.0, -2147483648.0, 2147483647.0, "wheel.fr.count") \
    X(28, INTEGER, OUTPUT, outputs.wheel_count[2], 0.0, -2147483648.0, 2147483647.0, "wheel.rr.count") \
    X(29, INTEGER, OUTPUT, outputs.wheel_count[3], 0.0, -2147483648.0, 2147483647.0, "wheel.rl.count") \
    X(30, INTEGER, OUTPUT, outputs.wheel_index[0], 0.0, -2147483648.0, 2147483647.0, "wheel.fl.index") \
    X(31, INTEGER, OUTPUT, outputs.wheel_index[1], 0.0, -2147483648.0, 2147483647.0, "wheel.fr.index") \
    X(32, INTEGER, OUTPUT, outputs.wheel_index[2], 0.0, -2147483648.0, 2147483647.0, "wheel.rr.index") \
    X(33, INTEGER, OUTPUT, outputs.wheel_index[3], 0.0, -2147483648.0, 2147483647.0, "wheel.rl.index") \
    X(34, REAL, OUTPUT, outputs.wheel_current_a[0], 0.0, -INFINITY, INFINITY, "wheel.fl.current_a") \
    X(35, REAL, OUTPUT, outputs.wheel_current_a[1], 0.0, -INFINITY, INFINITY, "wheel.fr.current_a") \
    X(36, REAL, OUTPUT, outputs.wheel_current_a[2], 0.0, -INFINITY, INFINITY, "wheel.rr.current_a") \
    X(37, REAL, OUTPUT, outputs.wheel_current_a[3], 0.0, -INFINITY, INFINITY, "wheel.rl.current_a") \
    X(38, REAL, OUTPUT, outputs.wheel_axle_torque_n_m[0], 0.0, -INFINITY, INFINITY, "wheel.fl.axle_torque_n_m") \
    X(39, REAL, OUTPUT, outputs.wheel_axle_torque_n_m[1], 0.0, -INFINITY, INFINITY, "wheel.fr.axle_torque_n_m") \
    X(40, REAL, OUTPUT, outputs.wheel_axle_torque_n_m[2], 0.0, -INFINITY, INFINITY, "wheel.rr.axle_torque_n_m") \
    X(41, REAL, OUTPUT, outputs.wheel_axle_torque_n_m[3], 0.0, -INFINITY, INFINITY, "wheel.rl.axle_torque_n_m") \
    X(42, REAL, OUTPUT, outputs.wheel_temperature_degc[0], 0.0, -INFINITY, INFINITY, "wheel.fl.temperature_degc") \
    X(43, REAL, OUTPUT, outputs.wheel_temperature_degc[1], 0.0, -INFINITY, INFINITY, "wheel.fr.temperature_degc") \
    X(44, REAL, OUTPUT, outputs.wheel_temperature_degc[2], 0.0, -INFINITY, INFINITY, "wheel.rr.temperature_degc") \
    X(45, REAL, OUTPUT, outputs.wheel_temperature_degc[3], 0.0, -INFINITY, INFINITY, "wheel.rl.temperature_degc") \
    X(46, REAL, OUTPUT, outputs.wheel_load_n[0], 0.0, -INFINITY, INFINITY, "wheel.fl.load_n") \
    X(47, REAL, OUTPUT, outputs.wheel_load_n[1], 0.0, -INFINITY, INFINITY, "wheel.fr.load_n") \
    X(48, REAL, OUTPUT, outputs.wheel_load_n[2], 0.0, -INFINITY, INFINITY, "wheel.rr.load_n") \
    X(49, REAL, OUTPUT, outputs.wheel_load_n[3], 0.0, -INFINITY, INFINITY, "wheel.rl.load_n") \
    X(50, REAL, OUTPUT, outputs.wheel_slip_m_s[0], 0.0, -INFINITY, INFINITY, "wheel.fl.slip_m_s") \
    X(51, REAL, OUTPUT, outputs.wheel_slip_m_s[1], 0.0, -INFINITY, INFINITY, "wheel.fr.slip_m_s") \
    X(52, REAL, OUTPUT, outputs.wheel_slip_m_s[2], 0.0, -INFINITY, INFINITY, "wheel.rr.slip_m_s") \
    X(53, REAL, OUTPUT, outputs.wheel_slip_m_s[3], 0.0, -INFINITY, INFINITY, "wheel.rl.slip_m_s") \
    X(54, REAL, OUTPUT, outputs.tip_margin, 0.0, -INFINITY, INFINITY, "tip_margin") \
    X(55, REAL, OUTPUT, outputs.tip_rad, 0.0, -INFINITY, INFINITY, "tip_rad") \
    X(56, REAL, OUTPUT, outputs.gyro_x_rad_s, 0.0, -INFINITY, INFINITY, "gyro.x_rad_s") \
    X(57, REAL, OUTPUT, outputs.gyro_y_rad_s, 0.0, -INFINITY, INFINITY, "gyro.y_rad_s") \
    X(58, REAL, OUTPUT, outputs.gyro_z_rad_s, 0.0, -INFINITY, INFINITY, "gyro.z_rad_s") \
    X(59, REAL, OUTPUT, outputs.accelerometer_x_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer.x_m_s2") \
    X(60, REAL, OUTPUT, outputs.accelerometer_y_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer.y_m_s2") \
    X(61, REAL, OUTPUT, outputs.accelerometer_z_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer.z_m_s2") \
    X(62, REAL, OUTPUT, outputs.battery_voltage_v, 0.0, -INFINITY, INFINITY, "battery.voltage_v") \
    X(63, REAL, OUTPUT, outputs.battery_current_a, 0.0, -INFINITY, INFINITY, "battery.current_a") \
    X(64, REAL, OUTPUT, outputs.energy_supplied_j, 0.0, -INFINITY, INFINITY, "energy.supplied_j") \
    X(65, REAL, OUTPUT, outputs.energy_stored_j, 0.0, -INFINITY, INFINITY, "energy.stored_j") \
    X(66, REAL, OUTPUT, outputs.energy_lost_j, 0.0, -INFINITY, INFINITY, "energy.lost_j") \
    X(67, REAL, TUNABLE, parameters.mass_kg, 20.0, 0.01, 10000.0, "mass_kg") \
    X(68, REAL, TUNABLE, parameters.inertia_kg_m2, 0.56, 1e-06, 10000.0, "inertia_kg_m2") \
    X(69, REAL, TUNABLE, parameters.com_x_m, 0.0, -10.0, 10.0, "com_x_m") \
    X(70, REAL, TUNABLE, parameters.com_y_m, 0.0, -10.0, 10.0, "com_y_m") \
    X(71, REAL, TUNABLE, parameters.com_height_m, 0.1, 0.0, 10.0, "com_height_m") \
    X(72, REAL, PARAMETER, parameters.wheel_radius_m, 0.075, 0.001, 10.0, "wheel_radius_m") \
    X(73, REAL, TUNABLE, parameters.wheel_radius_factor[0], 1.0, 0.1, 10.0, "wheel.fl.radius_factor") \
    X(74, REAL, TUNABLE, parameters.wheel_radius_factor[1], 1.0, 0.1, 10.0, "wheel.fr.radius_factor") \
    X(75, REAL, TUNABLE, parameters.wheel_radius_factor[2], 1.0, 0.1, 10.0, "wheel.rr.radius_factor") \
    X(76, REAL, TUNABLE, parameters.wheel_radius_factor[3], 1.0, 0.1, 10.0, "wheel.rl.radius_factor") \
    X(77, REAL, PARAMETER, parameters.half_length_m, 0.3, 0.001, 10.0, "half_length_m") \
    X(78, REAL, PARAMETER, parameters.half_width_m, 0.3, 0.001, 10.0, "half_width_m") \
    X(79, REAL, PARAMETER, parameters.wheel_inertia_kg_m2, 0.005, 0.0, 100.0, "wheel_inertia_kg_m2") \
    X(80, REAL, TUNABLE, parameters.friction_coefficient, 0.0, 0.0, 2.0, "friction_coefficient") \
    X(81, REAL, TUNABLE, parameters.viscous_n_m_s_rad, 0.0, 0.0, 10.0, "viscous_n_m_s_rad") \
    X(82, REAL, TUNABLE, parameters.wheel_friction_factor[0], 1.0, 0.0, 1000.0, "wheel.fl.friction_factor") \
    X(83, REAL, TUNABLE, parameters.wheel_friction_factor[1], 1.0, 0.0, 1000.0, "wheel.fr.friction_factor") \
    X(84, REAL, TUNABLE, parameters.wheel_friction_factor[2], 1.0, 0.0, 1000.0, "wheel.rr.friction_factor") \
    X(85, REAL, TUNABLE, parameters.wheel_friction_factor[3], 1.0, 0.0, 1000.0, "wheel.rl.friction_factor") \
    X(86, REAL, TUNABLE, parameters.slope_rad, 0.0, 0.0, 1.0, "slope_rad") \
    X(87, REAL, TUNABLE, parameters.slope_direction_rad, 0.0, -INFINITY, INFINITY, "slope_direction_rad") \
    X(88, ENUMERATION, PARAMETER, parameters.contact, 1.0, 1.0, 2.0, "contact") \
    X(89, ENUMERATION, PARAMETER, parameters.rollers, 1.0, 1.0, 2.0, "rollers") \
    X(90, ENUMERATION, PARAMETER, parameters.coriolis, 1.0, 1.0, 2.0, "coriolis") \
    X(91, ENUMERATION, PARAMETER, parameters.drive, 1.0, 1.0, 3.0, "drive") \
    X(92, REAL, TUNABLE, parameters.grip_coefficient, 0.7, 0.0, 5.0, "grip_coefficient") \
    X(93, REAL, TUNABLE, parameters.wheel_grip_factor[0], 1.0, 0.0, 10.0, "wheel.fl.grip_factor") \
    X(94, REAL, TUNABLE, parameters.wheel_grip_factor[1], 1.0, 0.0, 10.0, "wheel.fr.grip_factor") \
    X(95, REAL, TUNABLE, parameters.wheel_grip_factor[2], 1.0, 0.0, 10.0, "wheel.rr.grip_factor") \
    X(96, REAL, TUNABLE, parameters.wheel_grip_factor[3], 1.0, 0.0, 10.0, "wheel.rl.grip_factor") \
    X(97, REAL, TUNABLE, parameters.wheel_lifted[0], 0.0, 0.0, 1.0, "wheel.fl.lifted") \
    X(98, REAL, TUNABLE, parameters.wheel_lifted[1], 0.0, 0.0, 1.0, "wheel.fr.lifted") \
    X(99, REAL, TUNABLE, parameters.wheel_lifted[2], 0.0, 0.0, 1.0, "wheel.rr.lifted") \
    X(100, REAL, TUNABLE, parameters.wheel_lifted[3], 0.0, 0.0, 1.0, "wheel.rl.lifted") \
    X(101, REAL, TUNABLE, parameters.blocks, 1.0, 0.0, 1.0, "blocks") \
    X(102, REAL, TUNABLE, parameters.sideways_loss, 0.0, -1.0, 0.9, "sideways_loss") \
    X(103, REAL, TUNABLE, parameters.roller_friction_coefficient, 0.01, 0.0, 5.0, "roller_friction_coefficient") \
    X(104, REAL, PARAMETER, parameters.roller_stiffness_n_m, 200000.0, 1000.0, 10000000.0, "roller_stiffness_n_m") \
    X(105, REAL, PARAMETER, parameters.roller_damping_n_s_m, 500.0, 0.0, 100000.0, "roller_damping_n_s_m") \
    X(106, REAL, PARAMETER, parameters.gear_ratio, 1.0, 0.01, 10000.0, "gear_ratio") \
    X(107, REAL, PARAMETER, parameters.rotor_inertia_kg_m2, 0.0, 0.0, 1.0, "rotor_inertia_kg_m2") \
    X(108, REAL, PARAMETER, parameters.motor_constant_n_m_a, 1.25, 1e-06, 10000.0, "motor_constant_n_m_a") \
    X(109, REAL, TUNABLE, parameters.wheel_torque_factor[0], 1.0, 0.0, 10.0, "wheel.fl.torque_factor") \
    X(110, REAL, TUNABLE, parameters.wheel_torque_factor[1], 1.0, 0.0, 10.0, "wheel.fr.torque_factor") \
    X(111, REAL, TUNABLE, parameters.wheel_torque_factor[2], 1.0, 0.0, 10.0, "wheel.rr.torque_factor") \
    X(112, REAL, TUNABLE, parameters.wheel_torque_factor[3], 1.0, 0.0, 10.0, "wheel.rl.torque_factor") \
    X(113, REAL, PARAMETER, parameters.motor_resistance_ohm, 0.6, 0.0001, 10000.0, "motor_resistance_ohm") \
    X(114, REAL, PARAMETER, parameters.motor_inductance_h, 0.0005, 1e-06, 10.0, "motor_inductance_h") \
    X(115, REAL, PARAMETER, parameters.winding_heat_capacity_j_k, 100.0, 0.01, 1000000.0, "winding_heat_capacity_j_k") \
    X(116, REAL, PARAMETER, parameters.winding_to_air_k_w, 3.0, 0.001, 10000.0, "winding_to_air_k_w") \
    X(117, REAL, TUNABLE, parameters.air_degc, 25.0, -100.0, 200.0, "air_degc") \
    X(118, REAL, TUNABLE, parameters.current_limit_a, 4.0, 0.001, 100000.0, "current_limit_a") \
    X(119, REAL, TUNABLE, parameters.battery_voltage_v, 24.0, 0.0, 10000.0, "battery_voltage_v") \
    X(120, REAL, TUNABLE, parameters.battery_fall_v_c, 0.0, 0.0, 1000000.0, "battery_fall_v_c") \
    X(121, REAL, TUNABLE, parameters.battery_resistance_ohm, 0.05, 0.0, 1000.0, "battery_resistance_ohm") \
    X(122, INTEGER, PARAMETER, parameters.counts_per_revolution, 4096.0, 1.0, 16777216.0, "counts_per_revolution") \
    X(123, REAL, PARAMETER, parameters.wheel_counts_factor[0], 1.0, 0.01, 10.0, "wheel.fl.counts_factor") \
    X(124, REAL, PARAMETER, parameters.wheel_counts_factor[1], 1.0, 0.01, 10.0, "wheel.fr.counts_factor") \
    X(125, REAL, PARAMETER, parameters.wheel_counts_factor[2], 1.0, 0.01, 10.0, "wheel.rr.counts_factor") \
    X(126, REAL, PARAMETER, parameters.wheel_counts_factor[3], 1.0, 0.01, 10.0, "wheel.rl.counts_factor") \
    X(127, REAL, PARAMETER, parameters.wheel_encoder_error_rad[0], 0.0, 0.0, 0.5, "wheel.fl.encoder_error_rad") \
    X(128, REAL, PARAMETER, parameters.wheel_encoder_error_rad[1], 0.0, 0.0, 0.5, "wheel.fr.encoder_error_rad") \
    X(129, REAL, PARAMETER, parameters.wheel_encoder_error_rad[2], 0.0, 0.0, 0.5, "wheel.rr.encoder_error_rad") \
    X(130, REAL, PARAMETER, parameters.wheel_encoder_error_rad[3], 0.0, 0.0, 0.5, "wheel.rl.encoder_error_rad") \
    X(131, REAL, PARAMETER, parameters.imu_rate_hz, 1000.0, 1.0, 100000.0, "imu_rate_hz") \
    X(132, REAL, TUNABLE, parameters.gyro_noise_rad_s, 0.0, 0.0, 100.0, "gyro_noise_rad_s") \
    X(133, REAL, TUNABLE, parameters.gyro_scale, 1.0, 0.0, 10.0, "gyro_scale") \
    X(134, REAL, PARAMETER, parameters.gyro_drift_rad_s2, 0.0, -1.0, 1.0, "gyro_drift_rad_s2") \
    X(135, REAL, PARAMETER, parameters.gyro_walk_rad_s, 0.0, 0.0, 10.0, "gyro_walk_rad_s") \
    X(136, REAL, TUNABLE, parameters.gyro_bias_x_rad_s, 0.0, -INFINITY, INFINITY, "gyro_bias_x_rad_s") \
    X(137, REAL, TUNABLE, parameters.gyro_bias_y_rad_s, 0.0, -INFINITY, INFINITY, "gyro_bias_y_rad_s") \
    X(138, REAL, TUNABLE, parameters.gyro_bias_z_rad_s, 0.0, -INFINITY, INFINITY, "gyro_bias_z_rad_s") \
    X(139, REAL, TUNABLE, parameters.accelerometer_noise_m_s2, 0.0, 0.0, 1000.0, "accelerometer_noise_m_s2") \
    X(140, REAL, TUNABLE, parameters.accelerometer_bias_x_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer_bias_x_m_s2") \
    X(141, REAL, TUNABLE, parameters.accelerometer_bias_y_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer_bias_y_m_s2") \
    X(142, REAL, TUNABLE, parameters.accelerometer_bias_z_m_s2, 0.0, -INFINITY, INFINITY, "accelerometer_bias_z_m_s2") \
    X(143, REAL, TUNABLE, parameters.imu_roll_rad, 0.0, -3.2, 3.2, "imu_roll_rad") \
    X(144, REAL, TUNABLE, parameters.imu_pitch_rad, 0.0, -3.2, 3.2, "imu_pitch_rad") \
    X(145, REAL, TUNABLE, parameters.imu_yaw_rad, 0.0, -3.2, 3.2, "imu_yaw_rad") \
    X(146, INTEGER, PARAMETER, parameters.seed, 1.0, -2147483648.0, 2147483647.0, "seed") \
    X(147, REAL, PARAMETER, parameters.start_x_m, 0.0, -INFINITY, INFINITY, "start_x_m") \
    X(148, REAL, PARAMETER, parameters.start_y_m, 0.0, -INFINITY, INFINITY, "start_y_m") \
    X(149, REAL, PARAMETER, parameters.start_heading_rad, 0.0, -INFINITY, INFINITY, "start_heading_rad") \
    X(150, REAL, PARAMETER, parameters.start_vx_m_s, 0.0, -INFINITY, INFINITY, "start_vx_m_s") \
    X(151, REAL, PARAMETER, parameters.start_vy_m_s, 0.0, -INFINITY, INFINITY, "start_vy_m_s") \
    X(152, REAL, PARAMETER, parameters.start_yaw_rate_rad_s, 0.0, -INFINITY, INFINITY, "start_yaw_rate_rad_s") \
    X(153, REAL, PARAMETER, parameters.longest_step_s, 0.001, 1e-06, 0.01, "longest_step_s") \
    X(154, REAL, INDEPENDENT, time_s, 0.0, -INFINITY, INFINITY, "time")
/* clang-format on */

#endif
