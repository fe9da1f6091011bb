/* Wheel speed estimation and the speed loop: pure functions of their state, called once a 1 kHz tick. */
#ifndef WHEEL_CONTROL_H
#define WHEEL_CONTROL_H

#include <stdbool.h>
#include <stdint.h>

#include "parameters.h"

#define WHEEL_COUNT 4
#define WHEEL_TICK_S 0.001f
#define WHEEL_TICK_MS 1u

/* Tracking filter (phase-locked loop) on wrapping encoder counts. One count a tick is 1.5 rad/s at 4096
 * counts a revolution, too coarse to close a loop on: the filter follows the count and its rate is the speed.
 */
typedef struct {
    uint16_t whole; /* estimated position, whole counts, wrapping as the encoder does */
    float fraction; /* and the rest of a count, in [0, 1) */
    float rate_counts_s;
    bool running;
} wheel_tracker;

/* Takes the count of this tick and returns the wheel speed [rad/s]. */
float wheel_tracker_update(wheel_tracker *tracker, uint16_t count, const wheel_parameters *parameters);

/* Speed loop of the four wheels: proportional, integral, feedforward. */
typedef struct {
    float integral_n_m[WHEEL_COUNT];
} wheel_speed_loop;

/* Writes the torque set points [N m]; returns true when all four were scaled at the torque limit.
 * The integrals stand still while the limit is reached, unless the error brings them back. */
bool wheel_speed_loop_update(wheel_speed_loop *loop, const float target_rad_s[WHEEL_COUNT],
                             const float speed_rad_s[WHEEL_COUNT], const float feedforward_n_m[WHEEL_COUNT],
                             const wheel_parameters *parameters, float limit_n_m,
                             float torque_n_m[WHEEL_COUNT]);

/* Current loop of the four motors, decoupled: the back-EMF is fed forward. Proportional and integral action
 * cancel the pole of the winding, L di/dt = u - R i - k w solved exactly over a tick, so that the current
 * goes to its target as a first-order lag of the wanted bandwidth, where the currents were sampled at the
 * tick; a mean of the last 0.2 ms overshoots by 3 % at 2000 rad/s. */
typedef struct {
    float integral_v[WHEEL_COUNT];
} wheel_current_loop;

/* Writes the duties of this tick, -1 to 1, from currents and speeds at its beginning; zero without a battery.
 */
void wheel_current_loop_update(wheel_current_loop *loop, const float target_a[WHEEL_COUNT],
                               const float current_a[WHEEL_COUNT], const float speed_rad_s[WHEEL_COUNT],
                               float battery_v, const wheel_parameters *parameters, float duty[WHEEL_COUNT]);

/* exp(-x) for x >= 0, to 5e-6. */
float wheel_exp_minus(float x);

/* Scales all four by one factor so that none is beyond the limit: the direction of the force is kept. */
bool wheel_scale_to_limit(float value[WHEEL_COUNT], float limit);

#endif
