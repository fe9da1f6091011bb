/* What holds the wheels to the ground: rollers that do not slip, or elastic ones with a limit. */
#include <math.h>

#include "model.h"

/* A roller bends elastically up to this part of its limit, and slides altogether at the whole of it. */
static const double ELASTIC_PART = 0.7;
/* A deflection beyond the limit, left from a larger load or grip, goes back within this time. */
static const double RELAXATION_S = 0.005;
static const double PI = 3.14159265358979323846;

void mecanum_rigid_acceleration(const mecanum_model *model, const double body_force[3],
                                const double torque_n_m[MECANUM_WHEELS], double acceleration[3]) {
    double force[3] = {body_force[0], body_force[1], body_force[2]};
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        for (int j = 0; j < 3; j++) {
            force[j] += model->rolling[i][j] * torque_n_m[i];
        }
    }
    mecanum_apply(&model->inverse_mass, force, acceleration);
}

/* Rate of a deflection z whose contact slides at `slip`: elasto-plastic, so that it neither creeps under a
 * steady load nor exceeds its limit (Dupont, Hayward, Armstrong and Altpeter, IEEE Trans. Automatic Control
 * 47(5), 2002). */
static double deflection_rate_m_s(double z, double slip, double limit_m) {
    if (limit_m <= 0.0) {
        return 0.0;
    }
    if (z * slip <= 0.0 || fabs(z) <= ELASTIC_PART * limit_m) {
        return slip;
    }
    if (fabs(z) >= limit_m) {
        return 0.0;
    }
    const double part = fabs(z) / limit_m;
    const double way = (part - ELASTIC_PART) / (1.0 - ELASTIC_PART);
    return slip * (1.0 - 0.5 * (1.0 - cos(PI * way)) * part);
}

/* Loads from the balance of moments about the centre of mass. The forces are those of the elastic
 * deflections, which do not depend on the loads in turn. A push acts at the height of the centre of mass. */
static void balance_load(const mecanum_model *model, const mecanum_modes *modes, const mecanum_state *state,
                         const double torque_n_m[MECANUM_WHEELS], double load_n[MECANUM_WHEELS]) {
    const mecanum_parameters *const p = model->p;
    double force_x = 0.0;
    double force_y = 0.0;
    double spin = 0.0;      /* J sum of omega */
    double spin_rate = 0.0; /* and its rate */
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double x = -model->roller_cosine * p->roller_stiffness_n_m * state->x[MECANUM_DEFLECTION_M + i];
        force_x += x;
        force_y += model->roller_slant[i] * x;
        spin += model->wheel_inertia_kg_m2 * state->x[MECANUM_WHEEL_SPEED_RAD_S + i];
        spin_rate += modes->at_rest[i] ? 0.0 : torque_n_m[i] - model->radius_m[i] * x;
    }
    const double pitch = model->gravity_upright_n * p->com_x_m - p->com_height_m * force_x - spin_rate;
    const double roll = model->gravity_upright_n * p->com_y_m - p->com_height_m * force_y -
                        state->x[MECANUM_YAW_RATE_RAD_S] * spin;
    mecanum_share_load(model, pitch, roll, load_n);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        load_n[i] = model->lifted[i] ? 0.0 : load_n[i]; /* the block in its place carries it */
    }
}

void mecanum_ground(const mecanum_model *model, const mecanum_modes *modes, const mecanum_state *state,
                    const double torque_n_m[MECANUM_WHEELS], mecanum_contact *contact) {
    const mecanum_parameters *const p = model->p;
    const double forward = state->x[MECANUM_FORWARD_M_S];
    const double left = state->x[MECANUM_LEFT_M_S];
    const double yaw_rate = state->x[MECANUM_YAW_RATE_RAD_S];
    const double c = model->roller_cosine;
    balance_load(model, modes, state, torque_n_m, contact->load_n);
    contact->lost_w = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double s = model->roller_slant[i];
        const double z = state->x[MECANUM_DEFLECTION_M + i];
        const double x_m_s = forward - yaw_rate * model->wheel_y_m[i] -
                             model->radius_m[i] * state->x[MECANUM_WHEEL_SPEED_RAD_S + i];
        const double y_m_s = left + yaw_rate * model->wheel_x_m[i];
        const double along_m_s = c * (x_m_s + s * y_m_s);
        const double across_m_s = c * (y_m_s - s * x_m_s);
        const double limit_m =
            p->grip_coefficient * p->wheel_grip_factor[i] * contact->load_n[i] / p->roller_stiffness_n_m;
        const double bent_m = fmin(fmax(z, -limit_m), limit_m);
        const double bending_m_s = deflection_rate_m_s(z, along_m_s, limit_m);
        const double rate_m_s = bending_m_s - (z - bent_m) / RELAXATION_S;
        const double along_n = -p->roller_stiffness_n_m * bent_m - p->roller_damping_n_s_m * bending_m_s;
        const double across_n = -p->roller_friction_coefficient * contact->load_n[i] *
                                tanh(across_m_s / MECANUM_RESISTANCE_SPEED_M_S);
        contact->slip_m_s[i] = model->lifted[i] ? 0.0 : along_m_s;
        contact->deflection_rate_m_s[i] = rate_m_s;
        contact->force_x_n[i] = c * (along_n - s * across_n);
        contact->force_y_n[i] = c * (s * along_n + across_n);
        /* What the contact takes, less what it stores. */
        contact->lost_w -= along_n * along_m_s + across_n * across_m_s;
        contact->lost_w -= p->roller_stiffness_n_m * z * rate_m_s;
    }
}

void mecanum_slip_acceleration(const mecanum_model *model, const double body_force[3],
                               const mecanum_contact *contact, double acceleration[3]) {
    double force[3] = {body_force[0], body_force[1], body_force[2]};
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        force[0] += contact->force_x_n[i];
        force[1] += contact->force_y_n[i];
        force[2] += model->wheel_x_m[i] * contact->force_y_n[i] - model->wheel_y_m[i] * contact->force_x_n[i];
    }
    mecanum_apply(&model->inverse_mass, force, acceleration);
}
