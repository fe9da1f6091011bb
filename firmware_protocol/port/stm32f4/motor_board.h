/* What a board for real motors has beyond board.h, as data. Wheels are FL, FR, RR, RL. */
#ifndef STM32F4_MOTOR_BOARD_H
#define STM32F4_MOTOR_BOARD_H

#include "board.h"

/* cffi: begin */
typedef enum {
    /* `first` carries the PWM of the duty's magnitude, `second` its sign: high for forward. */
    MOTOR_SIGN_MAGNITUDE,
    /* Locked antiphase: `first` and `second` are CHx and CHxN, each turning on one diagonal of the bridge;
     * half of the time each is zero volt. Timers 1 and 8 have CHxN for channels 1 to 3 only. */
    MOTOR_COMPLEMENTARY,
} motor_drive_kind;

typedef struct {
    uint8_t timer;   /* 1 or 8: only these can switch all outputs off at once */
    uint8_t channel; /* 1 to 4 */
    pin first;
    pin second;
    bool reversed; /* forward is the other way; the current's sign goes with it */
} motor_output;

typedef struct {
    uint8_t timer; /* 2 to 5 */
    pin a;         /* channel 1 */
    pin b;         /* channel 2 */
    bool reversed;
} motor_encoder;

/* A quantity that is (volts at the pin - zero_v) * per_v. */
typedef struct {
    pin input;
    uint8_t channel; /* of ADC 1, 0 to 15 */
    float zero_v;
    float per_v;
} analog_input;

typedef struct {
    motor_drive_kind kind;
    uint32_t pwm_hz;
    uint8_t dead_time; /* BDTR.DTG up to 127: periods of 168 MHz in which neither side is on */
    motor_output motor[WHEEL_COUNT];
    motor_encoder encoder[WHEEL_COUNT];
    analog_input current[WHEEL_COUNT]; /* in line with the motor, both directions */
    analog_input battery;
    bool has_temperatures;
    analog_input temperature[WHEEL_COUNT];
    pin enable; /* high switches the bridges on */
} motor_board;

extern const motor_board MOTORS;
/* cffi: end */

#endif
