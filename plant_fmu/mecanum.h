/* Equations of the four-wheel Mecanum robot: a rigid body on wheels whose rollers do not slip.
 *
 * World frame; wheels FL, FR, RR, RL. The state is an array so that the integrator is three loops, and
 * further states (motor currents, battery) are further entries. Nothing here knows of FMI. */
#ifndef MECANUM_H
#define MECANUM_H

#include <stdbool.h>

#include "mecanum_variables.h"

enum {
    MECANUM_X_M,
    MECANUM_Y_M,
    MECANUM_HEADING_RAD,
    MECANUM_VX_M_S,
    MECANUM_VY_M_S,
    MECANUM_YAW_RATE_RAD_S,
    MECANUM_WHEEL_ANGLE_RAD,
    MECANUM_STATES = MECANUM_WHEEL_ANGLE_RAD + MECANUM_WHEELS,
};

typedef struct {
    double x[MECANUM_STATES];
} mecanum_state;

/* Writes the state at the start: the pose and velocity that the parameters give, wheel angles zero. */
void mecanum_start(const mecanum_parameters *p, double state[MECANUM_STATES]);

/* Writes the time derivative of the state. */
void mecanum_derivative(const mecanum_parameters *p, const mecanum_inputs *u,
                        const double state[MECANUM_STATES], double derivative[MECANUM_STATES]);

/* Longest step [s] at which the integrator is exact enough and, whatever the friction, stable: at most 1 ms.
 */
double mecanum_longest_step_s(const mecanum_parameters *p);

/* Advances the state by one classical Runge-Kutta step of fourth order with the inputs held. */
void mecanum_step(const mecanum_parameters *p, const mecanum_inputs *u, double step_s,
                  double state[MECANUM_STATES]);

/* Writes what follows from the state and, for the currents, from the inputs. */
void mecanum_output(const mecanum_parameters *p, const mecanum_inputs *u, const double state[MECANUM_STATES],
                    mecanum_outputs *out);

/* Tells whether every state is a finite number. */
bool mecanum_is_finite(const double state[MECANUM_STATES]);

#endif
