/* An STM32F405RG with four bridge modules that take PWM and direction, hall current sensors in line with the
 * motors (2.5 V at 0 A, 66 mV/A, through a divider of 2 to 3), and temperature sensors of 10 mV/degC with
 * 0.5 V at 0 degC.
 */
#include "../motor_board.h"

#define CURRENT(pin_number, input_channel)                                                                   \
    {.input = {PORT_C, pin_number, 0},                                                                       \
     .channel = input_channel,                                                                               \
     .zero_v = 1.6667f,                                                                                      \
     .per_v = 22.727f,                                                                                       \
     .least_v = 0.2f,                                                                                        \
     .most_v = 3.1f}
#define TEMPERATURE(port, pin_number, input_channel)                                                         \
    {.input = {port, pin_number, 0},                                                                         \
     .channel = input_channel,                                                                               \
     .zero_v = 0.5f,                                                                                         \
     .per_v = 100.0f,                                                                                        \
     .least_v = 0.1f,                                                                                        \
     .most_v = 2.5f}

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
    .torque_limit_n_m = 10.0f,
    .torque_constant_n_m_a = ANY,
    .motor_resistance_ohm = ANY,
    .motor_inductance_h = ANY,
    .current_limit_a = 16.0f,
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
    .number = 2,
    .oscillator = {.divider = 4, .multiplier = 168},
    .host_serial = {.usart = 1, .baud = 921600, .transmit = {PORT_A, 9, 7}, .receive = {PORT_A, 10, 7}},
    .host_can = {.transmit = {PORT_B, 9, 9},
                 .receive = {PORT_B, 8, 9},
                 .prescaler = 3,
                 .bs1 = 10,
                 .bs2 = 3,
                 .sjw = 1},
    .parameters =
        {
            .counts_per_revolution = 4096.0f,
            .wheel_radius_m = 0.075f,
            .half_length_m = 0.3f,
            .half_width_m = 0.3f,
            .tracking_bandwidth_rad_s = 150.0f,
            .speed_kp_n_m_s_rad = 1.1f,
            .speed_ki_n_m_rad = 25.0f,
            .torque_limit_n_m = 5.0f,
            .torque_constant_n_m_a = 1.25f,
            .motor_resistance_ohm = 0.6f,
            .motor_inductance_h = 0.0005f,
            .current_limit_a = 12.0f,
            .current_bandwidth_rad_s = 1000.0f,
            .temperature_limit_degc = 90.0f,
            .undervoltage_v = 19.0f,
            .overspeed_rad_s = 40.0f,
            .encoder_fault_s = 0.1f,
            .watchdog_s = 0.05f,
            .ramp_s = 0.2f,
            .feedback_period_s = 0.005f,
        },
    .maximum = &MAXIMUM,
};

const motor_board MOTORS = {
    .kind = MOTOR_SIGN_MAGNITUDE,
    .pwm_hz = 20000,
    .duty_limit = 1.0f,
    .motor =
        {{.timer = 8, .channel = 1, .first = {PORT_C, 6, 3}, .second = {PORT_B, 12, 0}},
         {.timer = 8, .channel = 2, .first = {PORT_C, 7, 3}, .second = {PORT_B, 13, 0}, .reversed = true},
         {.timer = 8, .channel = 3, .first = {PORT_C, 8, 3}, .second = {PORT_B, 14, 0}, .reversed = true},
         {.timer = 8, .channel = 4, .first = {PORT_C, 9, 3}, .second = {PORT_B, 15, 0}}},
    .encoder = {{.timer = 2, .a = {PORT_A, 15, 1}, .b = {PORT_B, 3, 1}},
                {.timer = 3, .a = {PORT_B, 4, 2}, .b = {PORT_B, 5, 2}, .reversed = true},
                {.timer = 4, .a = {PORT_B, 6, 2}, .b = {PORT_B, 7, 2}, .reversed = true},
                {.timer = 5, .a = {PORT_A, 0, 2}, .b = {PORT_A, 1, 2}}},
    .current = {CURRENT(0, 10), CURRENT(1, 11), CURRENT(2, 12), CURRENT(3, 13)},
    .battery = {.input = {PORT_A, 4, 0},
                .channel = 4,
                .per_v = 11.0f,
                .most_v = 3.2f}, /* 100 kohm over 10 kohm */
    .has_temperatures = true,
    .temperature = {TEMPERATURE(PORT_A, 5, 5), TEMPERATURE(PORT_A, 6, 6), TEMPERATURE(PORT_A, 7, 7),
                    TEMPERATURE(PORT_B, 0, 8)},
    .enable = {PORT_A, 8, 0},
};
