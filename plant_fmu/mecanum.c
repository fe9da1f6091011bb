/* Start, derivative, integrator and outputs of the plant. */
#include "mecanum.h"

#include <math.h>
#include <string.h>

#include "model.h"
#include "sensors.h"

/* Longest internal steps, over the time in which the fastest part changes: they keep the method's error of a
 * step below 1e-4 of a change in a motor's current (1e-2 while its limiter regulates), and below 1e-5 of one
 * in a contact's deflection. */
static const double MOTOR_STEP = 0.4;
static const double LIMITER_STEP = 1.0;
static const double CONTACT_STEP = 0.25;
static const double DAMPING_STEP = 0.1;
/* A roller about to slide bends by no more than this part of its limit in a step; where it does, the step is
 * halved. */
static const double LEAP = 0.1;
static const int MOST_HALVINGS = 6;

/* Gives the wheels on the ground, in the state, the speeds with which they roll: what a wheel has when it is
 * lifted. */
static void roll_on(const mecanum_model *model, mecanum_state *state) {
    double *const x = state->x;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double *const row = model->rolling[i];
        if (!model->lifted[i]) {
            x[MECANUM_WHEEL_SPEED_RAD_S + i] = row[0] * x[MECANUM_FORWARD_M_S] +
                                               row[1] * x[MECANUM_LEFT_M_S] +
                                               row[2] * x[MECANUM_YAW_RATE_RAD_S];
        }
    }
}

void mecanum_start(const mecanum_parameters *p, mecanum_state *state) {
    /* A wheel that is lifted from the start rolled until then, as one that is lifted a moment later. */
    mecanum_parameters on_ground = *p;
    mecanum_model model;
    memset(on_ground.wheel_lifted, 0, sizeof on_ground.wheel_lifted);
    mecanum_prepare(&model, &on_ground);
    const double cos_heading = cos(p->start_heading_rad);
    const double sin_heading = sin(p->start_heading_rad);
    double *const x = state->x;
    memset(state, 0, sizeof *state);
    x[MECANUM_X_M] = p->start_x_m;
    x[MECANUM_Y_M] = p->start_y_m;
    x[MECANUM_HEADING_RAD] = p->start_heading_rad;
    x[MECANUM_FORWARD_M_S] = cos_heading * p->start_vx_m_s + sin_heading * p->start_vy_m_s;
    x[MECANUM_LEFT_M_S] = -sin_heading * p->start_vx_m_s + cos_heading * p->start_vy_m_s;
    x[MECANUM_YAW_RATE_RAD_S] = p->start_yaw_rate_rad_s;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        x[MECANUM_TEMPERATURE_DEGC + i] = p->air_degc;
    }
    roll_on(&model, state);
    const mecanum_inputs no_push = {.drive_enabled = 1.0};
    const mecanum_motion motion = mecanum_motion_of(&model, state);
    mecanum_tip(&model, &no_push, &motion, 0.0, state);
}

/* The largest acceleration of wheels for one newton metre each. Rigid: the largest eigenvalue of J M^-1 J^T,
 * where J^T J is diagonal, bounded by the largest sum of a row. */
static double wheel_ease(const mecanum_model *model) {
    if (model->p->contact == MECANUM_CONTACT_SLIP) {
        return 1.0 / model->wheel_inertia_kg_m2;
    }
    const bool differ = model->any_lifted || model->is_uneven;
    double most[3]; /* of the wheels */
    double largest =
        model->any_lifted && model->wheel_inertia_kg_m2 > 0.0 ? 1.0 / model->wheel_inertia_kg_m2 : 0.0;
    memcpy(most, model->rolling[0], sizeof most);
    for (int i = 0; i < MECANUM_WHEELS && differ; i++) {
        for (int j = 0; j < 3; j++) {
            most[j] = fmax(fabs(most[j]), fabs(model->rolling[i][j]));
        }
    }
    for (int i = 0; i < 3; i++) {
        double sum = 0.0;
        for (int j = 0; j < 3; j++) {
            sum += 4.0 * fabs(most[i] * model->inverse_mass.at[i][j] * most[j]);
        }
        largest = fmax(largest, sum);
    }
    return largest;
}

static double largest(const double of[MECANUM_WHEELS]) {
    return fmax(fmax(of[0], of[1]), fmax(of[2], of[3]));
}

/* The longest step for motors and viscous friction, on wheels of this ease. */
static double longest_axle_step_s(const mecanum_model *model, double ease) {
    const mecanum_parameters *const p = model->p;
    const double axle_constant = largest(model->axle_constant);
    double longest_s = DAMPING_STEP / (largest(model->viscous_n_m_s_rad) * ease);
    if (p->drive == MECANUM_DRIVE_CURRENT) {
        /* At the limit of the voltage the winding's resistance damps the wheels. */
        longest_s =
            fmin(longest_s, MOTOR_STEP * p->motor_resistance_ohm / (axle_constant * axle_constant * ease));
    }
    if (p->drive == MECANUM_DRIVE_VOLTAGE) {
        const double resistance_ohm = p->motor_resistance_ohm + MECANUM_WHEELS * p->battery_resistance_ohm;
        longest_s = fmin(longest_s, LIMITER_STEP / MECANUM_LIMITER_RATE_1_S);
        longest_s = fmin(longest_s, MOTOR_STEP * p->motor_inductance_h / resistance_ohm);
        longest_s = fmin(longest_s, MOTOR_STEP * sqrt(p->motor_inductance_h / ease) / axle_constant);
    }
    return longest_s;
}

double mecanum_internal_steps(const mecanum_model *model, double step_s) {
    const mecanum_parameters *const p = model->p;
    double longest_s = fmin(p->longest_step_s, longest_axle_step_s(model, wheel_ease(model)));
    if (p->contact == MECANUM_CONTACT_SLIP) {
        /* Motion of a contact along its roller for one newton there: of the wheel, and of the whole robot. */
        const double r = largest(model->radius_m);
        const double lever_m = p->half_length_m + p->half_width_m;
        const double driven =
            1.0 / (1.0 + model->roller_slant[0] * model->roller_slant[0]); /* cosine squared */
        const double ease = driven * r * r / model->wheel_inertia_kg_m2 +
                            2.0 * (model->inverse_mass.at[0][0] + model->inverse_mass.at[1][1] +
                                   lever_m * lever_m * model->inverse_mass.at[2][2]);
        const double resistance_n_s_m =
            p->roller_friction_coefficient * model->gravity_upright_n / MECANUM_RESISTANCE_SPEED_M_S;
        const double damping_n_s_m = fmax(p->roller_damping_n_s_m, resistance_n_s_m);
        longest_s = fmin(longest_s, CONTACT_STEP / sqrt(p->roller_stiffness_n_m * ease));
        longest_s = fmin(longest_s, CONTACT_STEP / fmax(damping_n_s_m * ease, 1.0));
    }
    return fmax(1.0, ceil(step_s / longest_s - 1e-9));
}

void mecanum_derivative(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                        const mecanum_state *state, mecanum_state *derivative) {
    const mecanum_parameters *const p = model->p;
    const double *const x = state->x;
    double *const rate = derivative->x;
    double speed_rad_s[MECANUM_WHEELS];
    double torque_n_m[MECANUM_WHEELS];
    double body_force[3];
    double acceleration[3];
    mecanum_drive drive;
    mecanum_wheel_speeds(model, state, speed_rad_s);
    mecanum_drives(model, u, state, speed_rad_s, &drive);
    mecanum_body_force(model, u, state, body_force);
    double lost_w = drive.lost_w;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double friction_n_m =
            model->viscous_n_m_s_rad[i] * speed_rad_s[i] + model->friction_n_m[i] * modes->sign[i];
        torque_n_m[i] = drive.torque_n_m[i] - friction_n_m;
        lost_w += friction_n_m * speed_rad_s[i];
        rate[MECANUM_WHEEL_ANGLE_RAD + i] = modes->at_rest[i] ? 0.0 : speed_rad_s[i];
        rate[MECANUM_CURRENT_A + i] = drive.current_rate_a_s[i];
        const double heat_w = p->motor_resistance_ohm * drive.current_a[i] * drive.current_a[i];
        const double cooling_w = (x[MECANUM_TEMPERATURE_DEGC + i] - p->air_degc) / p->winding_to_air_k_w;
        rate[MECANUM_TEMPERATURE_DEGC + i] = (heat_w - cooling_w) / p->winding_heat_capacity_j_k;
        rate[MECANUM_WHEEL_SPEED_RAD_S + i] =
            model->lifted[i] && !modes->at_rest[i] ? torque_n_m[i] / model->wheel_inertia_kg_m2 : 0.0;
        rate[MECANUM_DEFLECTION_M + i] = 0.0;
    }
    if (p->contact == MECANUM_CONTACT_SLIP) {
        mecanum_contact ground;
        mecanum_ground(model, modes, state, torque_n_m, &ground);
        mecanum_slip_acceleration(model, body_force, &ground, acceleration);
        lost_w += ground.lost_w;
        for (int i = 0; i < MECANUM_WHEELS; i++) {
            rate[MECANUM_DEFLECTION_M + i] = ground.deflection_rate_m_s[i];
            if (!modes->at_rest[i]) {
                rate[MECANUM_WHEEL_SPEED_RAD_S + i] =
                    (torque_n_m[i] - model->radius_m[i] * ground.force_x_n[i]) / model->wheel_inertia_kg_m2;
            }
        }
    } else {
        mecanum_rigid_acceleration(model, body_force, torque_n_m, acceleration);
        if (modes->any_at_rest) {
            const double free[3] = {acceleration[0], acceleration[1], acceleration[2]};
            mecanum_apply(&modes->projector, free, acceleration);
        }
    }
    const double cos_heading = cos(x[MECANUM_HEADING_RAD]);
    const double sin_heading = sin(x[MECANUM_HEADING_RAD]);
    rate[MECANUM_X_M] = cos_heading * x[MECANUM_FORWARD_M_S] - sin_heading * x[MECANUM_LEFT_M_S];
    rate[MECANUM_Y_M] = sin_heading * x[MECANUM_FORWARD_M_S] + cos_heading * x[MECANUM_LEFT_M_S];
    rate[MECANUM_HEADING_RAD] = x[MECANUM_YAW_RATE_RAD_S];
    for (int j = 0; j < 3; j++) {
        rate[MECANUM_FORWARD_M_S + j] = acceleration[j];
    }
    rate[MECANUM_SUPPLIED_J] = drive.supplied_w + u->push_force_x_n * rate[MECANUM_X_M] +
                               u->push_force_y_n * rate[MECANUM_Y_M] +
                               u->push_moment_n_m * x[MECANUM_YAW_RATE_RAD_S];
    rate[MECANUM_LOST_J] = lost_w;
    rate[MECANUM_CHARGE_C] = drive.battery_a;
}

/* One step of the classical Runge-Kutta method of fourth order. */
static void runge_kutta(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                        double step_s, mecanum_state *state) {
    static const double ADVANCE[3] = {0.5, 0.5, 1.0};
    static const double WEIGHT[4] = {1.0, 2.0, 2.0, 1.0};
    mecanum_state at = *state;
    mecanum_state slope;
    double sum[MECANUM_STATES] = {0.0};
    for (int stage = 0; stage < 4; stage++) {
        mecanum_derivative(model, u, modes, &at, &slope);
        for (int i = 0; i < MECANUM_STATES; i++) {
            sum[i] += WEIGHT[stage] * slope.x[i];
            if (stage < 3) {
                at.x[i] = state->x[i] + ADVANCE[stage] * step_s * slope.x[i];
            }
        }
    }
    for (int i = 0; i < MECANUM_STATES; i++) {
        state->x[i] += step_s / 6.0 * sum[i];
    }
}

/* Tells whether a roller went too far for one step where it begins to slide, which it does within a tenth of
 * a millimetre. */
static bool leaps(const mecanum_model *model, const mecanum_state *before, const mecanum_state *after) {
    const mecanum_parameters *const p = model->p;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double z = after->x[MECANUM_DEFLECTION_M + i];
        const double limit_m =
            p->grip_coefficient * p->wheel_grip_factor[i] * model->load_n[i] / p->roller_stiffness_n_m;
        if (fabs(z) > 0.5 * limit_m && fabs(z - before->x[MECANUM_DEFLECTION_M + i]) > LEAP * limit_m) {
            return true;
        }
    }
    return false;
}

static void divide(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                   double step_s, int halvings, mecanum_state *state) {
    const mecanum_state before = *state;
    runge_kutta(model, u, modes, step_s, state);
    if (halvings > 0 && model->p->contact == MECANUM_CONTACT_SLIP && leaps(model, &before, state)) {
        *state = before;
        divide(model, u, modes, 0.5 * step_s, halvings - 1, state);
        divide(model, u, modes, 0.5 * step_s, halvings - 1, state);
    }
}

void mecanum_integrate(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                       double step_s, mecanum_state *state) {
    divide(model, u, modes, step_s, MOST_HALVINGS, state);
}

void mecanum_advance(const mecanum_model *model, const mecanum_inputs *u, double step_s,
                     double internal_steps, mecanum_state *state) {
    const mecanum_motion before = mecanum_motion_of(model, state);
    for (long i = 0; i < (long)internal_steps; i++) {
        mecanum_step(model, u, step_s / internal_steps, state);
    }
    if (model->p->contact != MECANUM_CONTACT_SLIP) {
        roll_on(model, state);
    }
    mecanum_tip(model, u, &before, step_s, state);
}

/* Energy of motion, height, bent rollers and windings. */
static double stored_j(const mecanum_model *model, const mecanum_state *state) {
    const mecanum_parameters *const p = model->p;
    const double *const x = state->x;
    double speed_rad_s[MECANUM_WHEELS];
    mecanum_wheel_speeds(model, state, speed_rad_s);
    const double yaw_rate = x[MECANUM_YAW_RATE_RAD_S];
    const double mass_x_m_s = x[MECANUM_FORWARD_M_S] - yaw_rate * p->com_y_m;
    const double mass_y_m_s = x[MECANUM_LEFT_M_S] + yaw_rate * p->com_x_m;
    double twice_j = p->mass_kg * (mass_x_m_s * mass_x_m_s + mass_y_m_s * mass_y_m_s) +
                     p->inertia_kg_m2 * yaw_rate * yaw_rate;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double deflection_m = x[MECANUM_DEFLECTION_M + i];
        const double current_a = x[MECANUM_CURRENT_A + i];
        twice_j += model->wheel_inertia_kg_m2 * speed_rad_s[i] * speed_rad_s[i];
        twice_j += p->roller_stiffness_n_m * deflection_m * deflection_m;
        twice_j += p->motor_inductance_h * current_a * current_a;
    }
    const double up_x = cos(p->slope_direction_rad);
    const double up_y = sin(p->slope_direction_rad);
    const double now = up_x * x[MECANUM_X_M] + up_y * x[MECANUM_Y_M] +
                       p->com_x_m * cos(p->slope_direction_rad - x[MECANUM_HEADING_RAD]) +
                       p->com_y_m * sin(p->slope_direction_rad - x[MECANUM_HEADING_RAD]);
    const double start = up_x * p->start_x_m + up_y * p->start_y_m +
                         p->com_x_m * cos(p->slope_direction_rad - p->start_heading_rad) +
                         p->com_y_m * sin(p->slope_direction_rad - p->start_heading_rad);
    return 0.5 * twice_j + model->gravity_in_plane_n * (now - start);
}

/* What the sensors read of a state and its rate. */
static void sense(const mecanum_model *model, const mecanum_state *state, const mecanum_state *derivative,
                  double time_s, mecanum_outputs *out) {
    const double *const x = state->x;
    const double *const rate = derivative->x;
    const double yaw_rate = x[MECANUM_YAW_RATE_RAD_S];
    const double uphill = model->p->slope_direction_rad - x[MECANUM_HEADING_RAD];
    const double fall_m_s2 = model->gravity_in_plane_n / model->p->mass_kg;
    const double turning[3] = {0.0, 0.0, yaw_rate};
    /* The acceleration of a point of the turning frame, less that of gravity. */
    const double acceleration[3] = {
        rate[MECANUM_FORWARD_M_S] - yaw_rate * x[MECANUM_LEFT_M_S] + fall_m_s2 * cos(uphill),
        rate[MECANUM_LEFT_M_S] + yaw_rate * x[MECANUM_FORWARD_M_S] + fall_m_s2 * sin(uphill),
        model->gravity_upright_n / model->p->mass_kg,
    };
    plant_encoders(model->p, x + MECANUM_WHEEL_ANGLE_RAD, out);
    plant_inertial(model->p, time_s, turning, acceleration, out);
}

void mecanum_output(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                    double time_s, mecanum_outputs *out) {
    const mecanum_parameters *const p = model->p;
    mecanum_modes modes;
    mecanum_drive drive;
    mecanum_contact ground;
    mecanum_state settled = *state;
    mecanum_state derivative;
    double torque_n_m[MECANUM_WHEELS];
    mecanum_settle(model, u, &settled, &modes);
    mecanum_derivative(model, u, &modes, &settled, &derivative);

    const double *const x = state->x;
    out->pose_x_m = x[MECANUM_X_M];
    out->pose_y_m = x[MECANUM_Y_M];
    out->pose_heading_rad = x[MECANUM_HEADING_RAD];
    out->twist_vx_m_s = derivative.x[MECANUM_X_M];
    out->twist_vy_m_s = derivative.x[MECANUM_Y_M];
    out->twist_yaw_rate_rad_s = x[MECANUM_YAW_RATE_RAD_S] * (model->is_held ? 0.0 : 1.0);
    mecanum_wheel_speeds(model, &settled, out->wheel_speed_rad_s);
    mecanum_drives(model, u, &settled, out->wheel_speed_rad_s, &drive);
    out->battery_voltage_v = drive.battery_v;
    out->battery_current_a = drive.battery_a;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        out->wheel_angle_rad[i] = x[MECANUM_WHEEL_ANGLE_RAD + i];
        out->wheel_current_a[i] = drive.current_a[i];
        out->wheel_temperature_degc[i] = x[MECANUM_TEMPERATURE_DEGC + i];
        out->wheel_axle_torque_n_m[i] = drive.torque_n_m[i];
        out->wheel_load_n[i] = model->lifted[i] ? 0.0 : model->load_n[i];
        out->wheel_slip_m_s[i] = 0.0;
        torque_n_m[i] = drive.torque_n_m[i] - model->viscous_n_m_s_rad[i] * out->wheel_speed_rad_s[i] -
                        model->friction_n_m[i] * modes.sign[i];
    }
    if (p->contact == MECANUM_CONTACT_SLIP) {
        mecanum_ground(model, &modes, &settled, torque_n_m, &ground);
        memcpy(out->wheel_load_n, ground.load_n, sizeof out->wheel_load_n);
        memcpy(out->wheel_slip_m_s, ground.slip_m_s, sizeof out->wheel_slip_m_s);
    }
    out->tip_margin = state->tip_margin;
    out->tip_rad = state->tip_rad;
    out->energy_supplied_j = x[MECANUM_SUPPLIED_J];
    out->energy_stored_j = stored_j(model, state);
    out->energy_lost_j = x[MECANUM_LOST_J];
    sense(model, &settled, &derivative, time_s, out);
}
