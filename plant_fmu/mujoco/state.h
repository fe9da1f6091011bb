/* The state of the MuJoCo plant, as instance.h wants it: plain data. */
#ifndef MUJOCO_STATE_H
#define MUJOCO_STATE_H

#include <stdbool.h>

#include "mecanum_variables.h"

enum {
    ROLLERS = 12, /* on each wheel; fewer are faster and bump */
    POSITIONS = 7 + MECANUM_WHEELS * (1 + ROLLERS),
    VELOCITIES = 6 + MECANUM_WHEELS * (1 + ROLLERS),
    MUJOCO_STATES = POSITIONS + 2 * VELOCITIES,
};

typedef struct {
    double x[MUJOCO_STATES]; /* positions, velocities, and the accelerations from which the solver starts */
    double heading_rad;      /* not wrapped */
    double accelerometer_m_s2[3];
    double load_n[MECANUM_WHEELS];
} mecanum_state;

#endif
