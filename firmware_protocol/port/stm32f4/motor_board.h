/* What a board for real motors has beyond board.h, as data. Wheels are FL, FR, RR, RL.
 *
 * What the board itself has to see to, as no firmware can:
 *
 * Pull-downs at the enable input and at every gate or PWM input, strong enough for the drivers. These pins
 * float from power-on until the first lines of robot_start, during a reset, and under the firmware of another
 * board.
 *
 * Overcurrent. The firmware looks at the currents once a millisecond, and no pin of the board switches the
 * timers off: a short circuit is for the bridge itself to survive.
 *
 * A break. One of a timer's outputs, as by a pin BKIN of a board that has one, is a fault (SENSOR) with all
 * four motors off until the chip is reset.
 *
 * A supply that sinks. The firmware switches off at 2.8 V; the option byte BOR_LEV at level 3 keeps the chip
 * in reset where it cannot work.
 *
 * A core that hangs holds the last duty until the watchdog resets the chip, 21 to 58 ms (RUN_LIMIT_MS of
 * robot.c, with the tolerance of the watchdog's oscillator). So does one that a debugger halts, and most
 * debuggers stop the watchdog too: take the motors' supply away first. Stopping the timers with the core
 * (DBG_TIM1_STOP) is no help, as RM0090 has it stop their counters and not their outputs.
 */
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

/* A quantity that is (volts at the pin - zero_v) * per_v. Volts outside the range mean a broken sensor. */
typedef struct {
    pin input;
    uint8_t channel; /* of ADC 1, 0 to 15 */
    float zero_v;
    float per_v;
    float least_v;
    float most_v;
} analog_input;

typedef struct {
    motor_drive_kind kind;
    uint32_t pwm_hz;
    uint8_t dead_time; /* BDTR.DTG up to 127: periods of 168 MHz in which neither side is on */
    float duty_limit;  /* up to 1; less where a bootstrap capacitor needs its low side on in each period */
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
