/* The equations of mecanum.c behind an instance. They keep nothing outside the state. */

#include "physics.h"

bool physics_start(plant_instance *plant) {
    mecanum_start(&plant->now.parameters, plant->now.state.x);
    return true;
}

double physics_internal_steps(const plant_instance *plant, double step_s) {
    const double longest_s = mecanum_longest_step_s(&plant->now.parameters);
    return fmax(1.0, ceil(step_s / longest_s - 1e-9));
}

bool physics_advance(plant_instance *plant, double step_s) {
    mecanum_state state = plant->now.state;
    const double steps = physics_internal_steps(plant, step_s);
    for (long i = 0; i < (long)steps; i++) {
        mecanum_step(&plant->now.parameters, &plant->now.inputs, step_s / steps, state.x);
    }
    if (!mecanum_is_finite(state.x)) {
        return plant_fail(plant, "doStep: the state is no longer finite after %.10g s; look at the torques",
                          plant->now.time_s);
    }
    plant->now.state = state;
    return true;
}

bool physics_output(plant_instance *plant) {
    mecanum_output(&plant->now.parameters, &plant->now.inputs, plant->now.state.x, &plant->now.outputs);
    return true;
}

void physics_release(plant_instance *plant) {
    (void)plant;
}
