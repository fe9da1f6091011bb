/* The plant: a four-wheel Mecanum robot with motors, battery, encoders and inertial sensors.
 *
 * Wheels FL, FR, RR, RL. The state is an array, so that the integrator is three loops. Nothing here knows of
 * FMI, and nothing allocates or keeps statics. The equations stand in README.md; model.h says how the files
 * share them. */
#ifndef MECANUM_H
#define MECANUM_H

#include <stdbool.h>

#include "hidden.h"
#include "mecanum_variables.h"

HIDDEN_BEGIN

enum {
    MECANUM_X_M, /* of the robot's centre, world frame */
    MECANUM_Y_M,
    MECANUM_HEADING_RAD,
    MECANUM_FORWARD_M_S, /* of the robot's centre, body frame */
    MECANUM_LEFT_M_S,
    MECANUM_YAW_RATE_RAD_S,
    MECANUM_WHEEL_ANGLE_RAD,
    MECANUM_WHEEL_SPEED_RAD_S = MECANUM_WHEEL_ANGLE_RAD + MECANUM_WHEELS, /* slip contact alone */
    MECANUM_DEFLECTION_M = MECANUM_WHEEL_SPEED_RAD_S + MECANUM_WHEELS,    /* slip contact alone */
    MECANUM_CURRENT_A = MECANUM_DEFLECTION_M + MECANUM_WHEELS,            /* the drive voltage alone */
    MECANUM_TEMPERATURE_DEGC = MECANUM_CURRENT_A + MECANUM_WHEELS,
    MECANUM_SUPPLIED_J = MECANUM_TEMPERATURE_DEGC + MECANUM_WHEELS,
    MECANUM_LOST_J,
    MECANUM_CHARGE_C, /* taken from the battery */
    MECANUM_STATES,
};

typedef struct {
    double x[MECANUM_STATES];
    double tip_margin; /* of the last step */
    double tip_rad;    /* about the wheels of one side */
    double tip_rad_s;
} mecanum_state;

/* What follows from the parameters, once for all steps: model.h. */
typedef struct mecanum_model mecanum_model;

/* Writes the state at the start: the pose and velocity that the parameters give, wheels rolling, no current.
 */
void mecanum_start(const mecanum_parameters *p, mecanum_state *state);

/* Number of internal steps that a step of `step_s` takes: not longer than `longest_step_s`, and than the
 * fastest of motors and contacts allows. */
double mecanum_internal_steps(const mecanum_model *model, double step_s);

/* Advances the state by `step_s`, in so many equal steps, with the inputs held. */
void mecanum_advance(const mecanum_model *model, const mecanum_inputs *u, double step_s,
                     double internal_steps, mecanum_state *state);

/* Tells whether the centre of mass is beyond the wheels over which the robot has tipped: it does not come
 * back. */
bool mecanum_has_tipped(const mecanum_parameters *p, const mecanum_state *state);

/* Writes what follows from the state, the inputs and the time. */
void mecanum_output(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                    double time_s, mecanum_outputs *out);

HIDDEN_END

#endif
