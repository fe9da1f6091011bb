/* An STM32F405RG with four full bridges of its own: each gate driver takes CHx for one diagonal and CHxN for
 * the other. Current sensors as of the other board; no temperature sensors.
 */
#include "../motor_board.h"

#define CURRENT(pin_number, input_channel)                                                                   \
    {.input = {PORT_C, pin_number, 0},                                                                       \
     .channel = input_channel,                                                                               \
     .zero_v = 1.6667f,                                                                                      \
     .per_v = 22.727f,                                                                                       \
     .least_v = 0.2f,                                                                                        \
     .most_v = 3.1f}

/* Greatest values with these bridges, sensors and motors; the range of the table holds where this is no
 * matter of the board. */
#define ANY 1e9f
static const wheel_parameters MAXIMUM = {
    .counts_per_revolution = ANY,
    .wheel_radius_m = ANY,
    .half_length_m = ANY,
    .half_width_m = ANY,
    .tracking_bandwidth_rad_s = ANY,
    .speed_kp_n_m_s_rad = ANY,
    .speed_ki_n_m_rad = ANY,
    .torque_limit_n_m = 12.0f,
    .torque_constant_n_m_a = ANY,
    .motor_resistance_ohm = ANY,
    .motor_inductance_h = ANY,
    .current_limit_a = 18.0f,
    .current_bandwidth_rad_s = 2000.0f, /* the converter's means cost 4 % of overshoot there */
    .temperature_limit_degc = 110.0f,
    .undervoltage_v = ANY,
    .overspeed_rad_s = 60.0f,
    .encoder_fault_s = ANY,
    .watchdog_s = ANY,
    .ramp_s = ANY,
    .feedback_period_s = ANY,
};

const board BOARD = {
    .number = 3,
    .oscillator = {.divider = 4, .multiplier = 168},
    .host_serial = {.usart = 3, .baud = 2000000, .transmit = {PORT_B, 10, 7}, .receive = {PORT_B, 11, 7}},
    .host_can = {.transmit = {PORT_B, 9, 9},
                 .receive = {PORT_B, 8, 9},
                 .prescaler = 3,
                 .bs1 = 10,
                 .bs2 = 3,
                 .sjw = 1},
    .parameters =
        {
            .counts_per_revolution = 8192.0f,
            .wheel_radius_m = 0.1f,
            .half_length_m = 0.25f,
            .half_width_m = 0.28f,
            .tracking_bandwidth_rad_s = 150.0f,
            .speed_kp_n_m_s_rad = 1.5f,
            .speed_ki_n_m_rad = 30.0f,
            .torque_limit_n_m = 8.0f,
            .torque_constant_n_m_a = 1.5f,
            .motor_resistance_ohm = 0.4f,
            .motor_inductance_h = 0.0004f,
            .current_limit_a = 16.0f,
            .current_bandwidth_rad_s = 1000.0f,
            .temperature_limit_degc = 90.0f,
            .undervoltage_v = 20.0f,
            .overspeed_rad_s = 40.0f,
            .encoder_fault_s = 0.1f,
            .watchdog_s = 0.05f,
            .ramp_s = 0.2f,
            .feedback_period_s = 0.005f,
        },
    .maximum = &MAXIMUM,
};

const motor_board MOTORS = {
    .kind = MOTOR_COMPLEMENTARY,
    .pwm_hz = 25000,
    .dead_time = 84,    /* 0.5 us */
    .duty_limit = 0.9f, /* a low side is on for 1.5 us of 40 us or longer */
    .motor =
        {{.timer = 8, .channel = 1, .first = {PORT_C, 6, 3}, .second = {PORT_A, 7, 3}},
         {.timer = 8, .channel = 2, .first = {PORT_C, 7, 3}, .second = {PORT_B, 14, 3}, .reversed = true},
         {.timer = 8, .channel = 3, .first = {PORT_C, 8, 3}, .second = {PORT_B, 15, 3}, .reversed = true},
         {.timer = 1, .channel = 1, .first = {PORT_A, 8, 1}, .second = {PORT_B, 13, 1}}},
    .encoder = {{.timer = 2, .a = {PORT_A, 15, 1}, .b = {PORT_B, 3, 1}},
                {.timer = 3, .a = {PORT_B, 4, 2}, .b = {PORT_B, 5, 2}, .reversed = true},
                {.timer = 4, .a = {PORT_B, 6, 2}, .b = {PORT_B, 7, 2}, .reversed = true},
                {.timer = 5, .a = {PORT_A, 0, 2}, .b = {PORT_A, 1, 2}}},
    .current = {CURRENT(0, 10), CURRENT(1, 11), CURRENT(2, 12), CURRENT(3, 13)},
    .battery = {.input = {PORT_C, 4, 0}, .channel = 14, .per_v = 11.0f, .most_v = 3.2f},
    .enable = {PORT_C, 5, 0},
};
