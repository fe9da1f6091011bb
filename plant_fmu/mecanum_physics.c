/* The equations of mecanum.c behind an instance. They keep nothing outside the state. */

#include "physics.h"

bool physics_start(plant_instance *plant) {
    const char *const problem = mecanum_problem(&plant->now.parameters);
    if (problem != NULL) {
        return plant_fail(plant, "%s", problem);
    }
    mecanum_start(&plant->now.parameters, &plant->now.state);
    return true;
}

double physics_internal_steps(const plant_instance *plant, double step_s) {
    return mecanum_internal_steps(&plant->now.parameters, step_s);
}

bool physics_advance(plant_instance *plant, double step_s) {
    mecanum_state state = plant->now.state;
    mecanum_advance(&plant->now.parameters, &plant->now.inputs, step_s, &state);
    if (!mecanum_is_finite(&state)) {
        return plant_discard_extreme(
            plant, "doStep: the state is no longer finite after %.10g s; look at the inputs",
            plant->now.time_s);
    }
    const double turn_rad =
        fabs(state.x[MECANUM_YAW_RATE_RAD_S]) * step_s / physics_internal_steps(plant, step_s);
    if (turn_rad > 1.0) {
        return plant_discard_extreme(
            plant,
            "doStep: after %.10g s the robot turns by %g rad in an internal step; expected at most 1, "
            "look at the inputs or take a shorter longest_step_s",
            plant->now.time_s, turn_rad);
    }
    plant->now.state = state;
    return true;
}

bool physics_output(plant_instance *plant) {
    const plant_snapshot *const now = &plant->now;
    mecanum_output(&now->parameters, &now->inputs, &now->state, now->time_s, &plant->now.outputs);
    return true;
}

void physics_release(plant_instance *plant) {
    (void)plant;
}
