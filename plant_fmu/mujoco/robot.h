/* The robot as a MuJoCo model: a free body with four driven wheels of twelve passive rollers each.
 *
 * Bodies are numbered chassis, then for each wheel itself and its rollers; joints likewise. The body frame
 * has its origin in the robot's centre at the height of the axles. */
#ifndef MUJOCO_ROBOT_H
#define MUJOCO_ROBOT_H

#include <mujoco/mujoco.h>

#include "hidden.h"
#include "state.h"

HIDDEN_BEGIN

enum { CHASSIS_BODY = 1, WHEEL_BODIES = 1 + ROLLERS };

/* Wheel of a body, from 0; negative for the chassis and the ground. */
static inline int wheel_of_body(int body) {
    return body > CHASSIS_BODY ? (body - CHASSIS_BODY - 1) / WHEEL_BODIES : -1;
}

/* Places in the vectors of positions and velocities. */
static inline int wheel_position(int wheel) {
    return 7 + wheel * WHEEL_BODIES;
}

static inline int wheel_velocity(int wheel) {
    return 6 + wheel * WHEEL_BODIES;
}

/* Whether a wheel is off the ground, a block in its place. */
static inline bool is_lifted(const mecanum_parameters *p, int wheel) {
    return p->wheel_lifted[wheel] >= 0.5;
}

/* Whether all are: the body stands on blocks. */
static inline bool is_held(const mecanum_parameters *p) {
    return is_lifted(p, 0) && is_lifted(p, 1) && is_lifted(p, 2) && is_lifted(p, 3);
}

/* Returns the model's specification, which the caller frees. NULL when the parameters describe no robot: then
 * `problem` says why. */
mjSpec *robot_specification(const mecanum_parameters *p, char *problem, size_t size);

/* Writes the velocities with which the robot rolls at the start's twist, wheels and rollers without slip. */
void robot_rolling(const mecanum_parameters *p, double velocity[VELOCITIES]);

HIDDEN_END

#endif
