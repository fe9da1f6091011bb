/* The physics of an instance by MuJoCo. The state is plain data in the instance; MuJoCo's own model and data
 * are a workshop that is set up anew whenever the parameters differ from those it was built for, so that
 * saved states, tunable parameters and resets need nothing of their own. */

#include "physics.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "robot.h"
#include "sensors.h"

enum { STATE = mjSTATE_QPOS | mjSTATE_QVEL | mjSTATE_WARMSTART };

static const double TWO_PI = 6.283185307179586476925286766559;
static const int SETTLING_STEPS = 100;

typedef struct {
    mecanum_parameters parameters;
    mjModel *model;
    mjData *data;
} workshop;

void physics_release(plant_instance *plant) {
    workshop *const w = plant->physics;
    if (w != NULL) {
        mj_deleteData(w->data);
        mj_deleteModel(w->model);
        free(w);
        plant->physics = NULL;
    }
}

/* Returns what the parameters describe, compiled; NULL after a failure. */
static mjModel *compiled(plant_instance *plant, mjSpec *spec) {
    mjModel *const model = mj_compile(spec, NULL);
    if (model == NULL) {
        plant_fail(plant, "MuJoCo: %s", mjs_getError(spec));
    }
    return model;
}

static mjSpec *specification(plant_instance *plant) {
    char problem[200];
    mjSpec *const spec = robot_specification(&plant->now.parameters, problem, sizeof problem);
    if (spec == NULL) {
        plant_fail(plant, "%s", problem);
    }
    return spec;
}

/* Returns the workshop for the parameters as they are now, or NULL after a failure. */
static workshop *prepared(plant_instance *plant) {
    workshop *w = plant->physics;
    if (w != NULL && memcmp(&w->parameters, &plant->now.parameters, sizeof w->parameters) == 0) {
        return w;
    }
    physics_release(plant);
    mjSpec *const spec = specification(plant);
    mjModel *const model = spec == NULL ? NULL : compiled(plant, spec);
    mj_deleteSpec(spec);
    if (model == NULL) {
        return NULL;
    }
    w = calloc(1, sizeof *w);
    mjData *const data = w == NULL ? NULL : mj_makeData(model);
    if (data == NULL) {
        mj_deleteModel(model);
        free(w);
        plant_fail(plant, "out of memory");
        return NULL;
    }
    /* All of the struct, also its padding: it is compared as bytes. */
    memcpy(&w->parameters, &plant->now.parameters, sizeof w->parameters);
    w->model = model;
    w->data = data;
    plant->physics = w;
    return w;
}

/* One internal step: mj_step without its checks, which would write a file in the working directory. A robot
 * that was thrown out of its range must not go on: MuJoCo does not come back from a number that is not
 * finite. */
static bool stepped(plant_instance *plant, const workshop *w) {
    mj_forward(w->model, w->data);
    for (int v = 0; v < VELOCITIES; v++) {
        if (mju_isBad(w->data->qacc[v])) {
            return plant_discard_extreme(
                plant, "doStep: an acceleration is no longer finite after %.10g s; look at the torques",
                plant->now.time_s);
        }
    }
    mjtNum place[7];
    mju_copy(place, w->data->qpos, 7);
    mj_implicit(w->model, w->data);
    if (is_held(&w->parameters)) {
        mju_copy(w->data->qpos, place, 7);
        mju_zero(w->data->qvel, wheel_velocity(0));
    }
    return true;
}

static void apply(const mecanum_parameters *p, const mecanum_inputs *inputs, mjData *data) {
    for (int wheel = 0; wheel < MECANUM_WHEELS; wheel++) {
        data->ctrl[wheel] = p->wheel_torque_factor[wheel] * inputs->wheel_torque_n_m[wheel];
    }
    /* At the origin of the body frame: a free joint's forces are. */
    data->qfrc_applied[0] = inputs->push_force_x_n;
    data->qfrc_applied[1] = inputs->push_force_y_n;
    data->qfrc_applied[5] = inputs->push_moment_n_m;
}

/* Keeps what MuJoCo found while it computed the accelerations. */
static void sense(const mjModel *model, const mjData *data, mecanum_state *state) {
    memcpy(state->accelerometer_m_s2, data->sensordata, sizeof state->accelerometer_m_s2);
    memset(state->load_n, 0, sizeof state->load_n);
    for (int i = 0; i < data->ncon; i++) {
        mjtNum force[6];
        const int body = model->geom_bodyid[data->contact[i].geom[1]];
        mj_contactForce(model, data, i, force);
        if (body != CHASSIS_BODY) { /* the block of a lifted wheel is the chassis's */
            state->load_n[wheel_of_body(body)] += force[0];
        }
    }
}

/* Follows the heading from where it was last. */
static void turn(const mjData *data, mecanum_state *state) {
    const mjtNum *const q = data->qpos + 3;
    const double wrapped = atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]));
    state->heading_rad += remainder(wrapped - state->heading_rad, TWO_PI);
}

/* Lets the robot sink into its contacts where it stands, free upright and in pitch and roll. */
static bool settled(plant_instance *plant, const workshop *w) {
    const mecanum_parameters *const p = &plant->now.parameters;
    mjData *const data = w->data;
    data->qpos[0] = p->start_x_m;
    data->qpos[1] = p->start_y_m;
    data->qpos[3] = cos(0.5 * p->start_heading_rad);
    data->qpos[6] = sin(0.5 * p->start_heading_rad);
    for (int step = 0; step < SETTLING_STEPS; step++) {
        if (!stepped(plant, w)) {
            return false;
        }
        mju_zero(data->qvel, 2);
        mju_zero(data->qvel + 5, VELOCITIES - 5);
        data->qpos[0] = p->start_x_m;
        data->qpos[1] = p->start_y_m;
        mju_zero(data->qpos + 7, POSITIONS - 7);
    }
    return true;
}

bool physics_start(plant_instance *plant) {
    const mecanum_parameters *const p = &plant->now.parameters;
    mecanum_state *const state = &plant->now.state;
    const workshop *const w = prepared(plant);
    if (w == NULL) {
        return false;
    }
    w->model->opt.timestep = p->longest_step_s;
    mj_resetData(w->model, w->data);
    if (!settled(plant, w)) {
        return false;
    }
    robot_rolling(p, w->data->qvel);
    if (is_held(p)) {
        mju_zero(w->data->qvel, wheel_velocity(0));
    }
    mju_zero(w->data->qacc_warmstart, VELOCITIES);
    memset(state, 0, sizeof *state);
    mj_getState(w->model, w->data, state->x, STATE);
    apply(p, &plant->now.inputs, w->data);
    mj_forward(w->model, w->data);
    state->heading_rad = p->start_heading_rad;
    turn(w->data, state);
    sense(w->model, w->data, state);
    return true;
}

double physics_internal_steps(plant_instance *plant, double step_s) {
    return fmax(1.0, ceil(step_s / plant->now.parameters.longest_step_s - 1e-9));
}

bool physics_advance(plant_instance *plant, double step_s, double internal_steps) {
    const workshop *const w = prepared(plant);
    if (w == NULL) {
        return false;
    }
    mecanum_state state = plant->now.state;
    w->model->opt.timestep = step_s / internal_steps;
    mj_setState(w->model, w->data, state.x, STATE);
    if (is_held(&plant->now.parameters)) {
        mju_zero(w->data->qvel, wheel_velocity(0));
    }
    apply(&plant->now.parameters, &plant->now.inputs, w->data);
    for (long i = 0; i < (long)internal_steps; i++) {
        if (!stepped(plant, w)) {
            mj_resetData(w->model, w->data);
            return false;
        }
        turn(w->data, &state);
    }
    sense(w->model, w->data, &state);
    mj_getState(w->model, w->data, state.x, STATE);
    plant->now.state = state;
    return true;
}

bool physics_output(plant_instance *plant) {
    const mecanum_parameters *const p = &plant->now.parameters;
    const mecanum_inputs *const in = &plant->now.inputs;
    const mecanum_state *const state = &plant->now.state;
    mecanum_outputs *const out = &plant->now.outputs;
    const double *const position = state->x;
    const double *const velocity = state->x + POSITIONS;
    /* A free joint turns in the body frame and moves in the world's. */
    double rate[3];
    mju_rotVecQuat(rate, velocity + 3, position + 3);
    out->pose_x_m = position[0];
    out->pose_y_m = position[1];
    out->pose_heading_rad = state->heading_rad;
    out->twist_vx_m_s = velocity[0];
    out->twist_vy_m_s = velocity[1];
    out->twist_yaw_rate_rad_s = rate[2];
    for (int wheel = 0; wheel < MECANUM_WHEELS; wheel++) {
        out->wheel_angle_rad[wheel] = position[wheel_position(wheel)];
        out->wheel_speed_rad_s[wheel] = velocity[wheel_velocity(wheel)];
        out->wheel_current_a[wheel] = in->wheel_torque_n_m[wheel] / p->motor_constant_n_m_a;
        out->wheel_load_n[wheel] = state->load_n[wheel];
    }
    plant_encoders(p, out->wheel_angle_rad, out);
    plant_inertial(p, plant->now.time_s, velocity + 3, state->accelerometer_m_s2, out);
    return true;
}

/* Writes the instance's robot to a file of MuJoCo's, with its state as the key frame "start": MJCF when the
 * name ends in .xml, else a binary model, which keeps every bit. Not of FMI: for eyes, and for tests that run
 * the robot without the FMU. Returns 0, or 1 after a failure. */
__attribute__((visibility("default"))) int mecanum_mujoco_save(void *component, const char *filename);

int mecanum_mujoco_save(void *component, const char *filename) {
    plant_instance *const plant = component;
    char error[200] = "";
    mjSpec *const spec = specification(plant);
    if (spec == NULL) {
        return 1;
    }
    mjsKey *const key = mjs_addKey(spec);
    mjs_setName(key->element, "start");
    mjs_setDouble(key->qpos, plant->now.state.x, POSITIONS);
    mjs_setDouble(key->qvel, plant->now.state.x + POSITIONS, VELOCITIES);
    mjModel *const model = compiled(plant, spec);
    const char *const suffix = strrchr(filename, '.');
    const bool text = suffix != NULL && strcmp(suffix, ".xml") == 0;
    bool done = model != NULL;
    if (done && text && mj_saveXML(spec, filename, error, sizeof error) != 0) {
        done = plant_fail(plant, "%s: %s", filename, error);
    } else if (done && !text) {
        mj_saveModel(model, filename, NULL, 0); /* it does not return whether it could */
        FILE *const file = fopen(filename, "rb");
        done = file != NULL && fseek(file, 0, SEEK_END) == 0 && ftell(file) == mj_sizeModel(model);
        if (file != NULL) {
            fclose(file);
        }
    }
    mj_deleteModel(model);
    mj_deleteSpec(spec);
    return done ? 0 : 1;
}
