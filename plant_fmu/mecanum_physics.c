/* The equations of mecanum.c behind an instance. Beside the state they keep the model of the parameters,
 * which is made anew whenever these differ from those it was made for. */

#include "physics.h"

#include <stdlib.h>
#include <string.h>

#include "model.h"

typedef struct {
    mecanum_parameters parameters;
    mecanum_model model;
} workshop;

void physics_release(plant_instance *plant) {
    free(plant->physics);
    plant->physics = NULL;
}

/* Returns the model of the parameters as they are now, or NULL after a failure. */
static const mecanum_model *prepared(plant_instance *plant) {
    workshop *w = plant->physics;
    if (w == NULL) {
        w = plant->physics = calloc(1, sizeof *w);
        if (w == NULL) {
            plant_fail(plant, "out of memory");
            return NULL;
        }
    }
    if (w->model.p == NULL || memcmp(&w->parameters, &plant->now.parameters, sizeof w->parameters) != 0) {
        /* All of the struct, also its padding: it is compared as bytes. */
        memcpy(&w->parameters, &plant->now.parameters, sizeof w->parameters);
        mecanum_prepare(&w->model, &w->parameters);
    }
    return &w->model;
}

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

double physics_internal_steps(plant_instance *plant, double step_s) {
    const mecanum_model *const model = prepared(plant);
    return model == NULL ? 1.0 : mecanum_internal_steps(model, step_s);
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
    const mecanum_model *const model = prepared(plant);
    if (model == NULL) {
        return false;
    }
    mecanum_state state = plant->now.state;
    mecanum_advance(model, &plant->now.inputs, step_s, internal_steps, &state);
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
    if (mecanum_has_tipped(&plant->now.parameters, &state)) {
        return plant_discard(
            plant,
            "doStep: after %.10g s the robot tips over: its centre of mass is beyond its wheels; look "
            "at com_height_m, com_x_m and com_y_m, the torques and pushes",
            plant->now.time_s);
    }
    plant->now.state = state;
    return true;
}

bool physics_output(plant_instance *plant) {
    const mecanum_model *const model = prepared(plant);
    if (model == NULL) {
        return false;
    }
    const plant_snapshot *const now = &plant->now;
    mecanum_output(model, &now->inputs, &now->state, now->time_s, &plant->now.outputs);
    return true;
}
