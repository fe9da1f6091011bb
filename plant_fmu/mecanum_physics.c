/* The equations of mecanum.c behind an instance. They keep nothing outside the state. */

#include "physics.h"

/* Says what is wrong with parameters that are each within their range, or NULL. */
static const char *problem_of(const mecanum_parameters *p) {
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        if (p->wheel_lifted[i] >= 0.5 && p->wheel_inertia_kg_m2 + p->rotor_inertia_kg_m2 <= 0.0) {
            return "wheel_inertia_kg_m2 = 0 with a lifted wheel; expected a positive number, a wheel without "
                   "inertia would turn at once";
        }
    }
    if (p->contact == MECANUM_CONTACT_SLIP && p->wheel_inertia_kg_m2 + p->rotor_inertia_kg_m2 <= 0.0) {
        return "wheel_inertia_kg_m2 = 0 with slip contact; expected a positive number, wheels without "
               "inertia would turn at once";
    }
    if (p->contact == MECANUM_CONTACT_SLIP && p->coriolis == MECANUM_CORIOLIS_PAPER) {
        return "coriolis = 2 (paper) with slip contact; expected rigid contact, where alone the term C is a "
               "choice";
    }
    return NULL;
}

bool physics_start(plant_instance *plant) {
    const char *const problem = problem_of(&plant->now.parameters);
    if (problem != NULL) {
        return plant_fail(plant, "%s", problem);
    }
    mecanum_start(&plant->now.parameters, &plant->now.state);
    return true;
}

double physics_internal_steps(const plant_instance *plant, double step_s) {
    return mecanum_internal_steps(&plant->now.parameters, step_s);
}

static bool is_finite(const mecanum_state *state) {
    for (int i = 0; i < MECANUM_STATES; i++) {
        if (!isfinite(state->x[i])) {
            return false;
        }
    }
    return true;
}

bool physics_advance(plant_instance *plant, double step_s, double internal_steps) {
    const char *const problem = problem_of(&plant->now.parameters); /* tunable ones may have changed */
    if (problem != NULL) {
        return plant_discard(plant, "doStep: %s", problem);
    }
    mecanum_state state = plant->now.state;
    mecanum_advance(&plant->now.parameters, &plant->now.inputs, step_s, internal_steps, &state);
    if (!is_finite(&state)) {
        return plant_discard_extreme(
            plant, "doStep: the state is no longer finite after %.10g s; look at the inputs",
            plant->now.time_s);
    }
    const double turn_rad = fabs(state.x[MECANUM_YAW_RATE_RAD_S]) * step_s / internal_steps;
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
