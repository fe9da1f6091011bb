/* Hardware in the loop: any board with an STM32F405, an 8 MHz crystal and these two serial lines, for example
 * a breakout board with two USB adapters. Behind the second line stands the plant; no other pin is touched,
 * and none of these is a motor's on any board here. The same numbers of USART and CAN are the ones that the
 * emulated targets connect.
 */
#include "../board.h"

const board BOARD = {
    .number = 1,
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
            .current_limit_a = 20.0f,
            .current_bandwidth_rad_s = 1000.0f,
            .temperature_limit_degc = 120.0f,
            .undervoltage_v = 0.0f,
            .overspeed_rad_s = 100.0f,
            .encoder_fault_s = 0.1f,
            .watchdog_s = 0.05f,
            .ramp_s = 0.2f,
            .feedback_period_s = 0.005f,
        },
};

/* The 130 bytes of drive and sense take 0.65 ms of each tick at this rate; at 921,600 they would take 1.41
 * ms.
 */
const board_serial PLANT_LINE = {
    .usart = 2, .baud = 2000000, .transmit = {PORT_A, 2, 7}, .receive = {PORT_A, 3, 7}};
