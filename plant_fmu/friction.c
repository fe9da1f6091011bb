/* Coulomb friction of the wheels with true sticking: its torque is against the speed of a wheel that turns,
 * and for one that stands still whatever holds it, up to the same size.
 *
 * A step goes on with fixed signs until a wheel's speed passes zero. There it stops, and the balance at that
 * instant decides anew which wheels stick and which go on. */
#include "model.h"

static const double REST_RAD_S = 1e-9;      /* slower wheels may stick */
static const double CROSSING_RAD_S = 1e-10; /* how exactly the instant of rest is found */
static const int MOST_CROSSINGS = 16; /* within one step; what is left then is one step with fixed signs */
static const double MOST_HALVINGS = 256.0;
static const int MOST_SEARCHES = 60;
static const int MOST_SWEEPS = 200;
static const double SWEEP_TOLERANCE = 1e-13;

/* Makes the projector that keeps the wheels at rest so: Gram-Schmidt on their rows, in the metric of the
 * mass. */
static void hold(const mecanum_model *model, mecanum_modes *modes) {
    double row[3][3];  /* orthonormal */
    double push[3][3]; /* inverse mass x row */
    int rank = 0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        if (!modes->at_rest[i] || model->lifted[i] || rank == 3) {
            continue;
        }
        double rest[3] = {model->rolling[i][0], model->rolling[i][1], model->rolling[i][2]};
        for (int k = 0; k < rank; k++) {
            const double part = model->rolling[i][0] * push[k][0] + model->rolling[i][1] * push[k][1] +
                                model->rolling[i][2] * push[k][2];
            for (int j = 0; j < 3; j++) {
                rest[j] -= part * row[k][j];
            }
        }
        double whole[3];
        double step[3];
        mecanum_apply(&model->inverse_mass, model->rolling[i], whole);
        mecanum_apply(&model->inverse_mass, rest, step);
        double square = 0.0;
        double whole_square = 0.0;
        for (int j = 0; j < 3; j++) {
            square += rest[j] * step[j];
            whole_square += model->rolling[i][j] * whole[j];
        }
        if (square < 1e-12 * whole_square) {
            continue; /* held already by the wheels before it */
        }
        const double length = sqrt(square);
        for (int j = 0; j < 3; j++) {
            row[rank][j] = rest[j] / length;
            push[rank][j] = step[j] / length;
        }
        rank++;
    }
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            double entry = i == j && rank < 3 ? 1.0 : 0.0;
            for (int k = 0; k < rank && rank < 3; k++) {
                entry -= push[k][i] * row[k][j];
            }
            modes->projector.at[i][j] = entry;
        }
    }
}

/* Torques at the axles without the friction of wheels at rest. */
static void other_torques(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                          const mecanum_state *state, const double speed_rad_s[MECANUM_WHEELS],
                          double torque_n_m[MECANUM_WHEELS]) {
    mecanum_drive drive;
    mecanum_drives(model, u, state, speed_rad_s, &drive);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        torque_n_m[i] = drive.torque_n_m[i] - model->viscous_n_m_s_rad[i] * speed_rad_s[i] -
                        model->friction_n_m[i] * modes->sign[i];
    }
}

/* Without slip the wheels hold one another through the body. Of all frictions within their limits, those act
 * that leave the least acceleration (Gauss): found by sweeps over the wheels (projected Gauss-Seidel). */
static void release_rigid(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                          const double torque_n_m[MECANUM_WHEELS], mecanum_modes *modes) {
    double friction_n_m[MECANUM_WHEELS] = {0.0};
    double ease[MECANUM_WHEELS][3]; /* body acceleration for one newton metre at the wheel */
    double own[MECANUM_WHEELS];     /* acceleration of the wheel itself for it */
    double held[MECANUM_WHEELS];
    double force[3];
    double acceleration[3];
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double limit = model->friction_n_m[i];
        const double *const row = model->rolling[i];
        /* Each wheel's own torque is the best guess: on level ground it is the answer. */
        friction_n_m[i] = modes->at_rest[i] ? fmin(fmax(torque_n_m[i], -limit), limit) : 0.0;
        held[i] = torque_n_m[i] - friction_n_m[i];
        mecanum_apply(&model->inverse_mass, row, ease[i]);
        own[i] = row[0] * ease[i][0] + row[1] * ease[i][1] + row[2] * ease[i][2];
    }
    mecanum_body_force(model, u, state, force);
    mecanum_rigid_acceleration(model, force, held, acceleration);
    double largest = 0.0;
    for (int sweep = 0; sweep < MOST_SWEEPS; sweep++) {
        largest = 0.0;
        for (int i = 0; i < MECANUM_WHEELS; i++) {
            if (!modes->at_rest[i] || model->lifted[i]) {
                continue;
            }
            const double *const row = model->rolling[i];
            const double wheel =
                row[0] * acceleration[0] + row[1] * acceleration[1] + row[2] * acceleration[2];
            const double limit = model->friction_n_m[i];
            const double next = fmin(fmax(friction_n_m[i] + wheel / own[i], -limit), limit);
            const double change = next - friction_n_m[i];
            friction_n_m[i] = next;
            largest = fmax(largest, fabs(change));
            for (int j = 0; j < 3; j++) {
                acceleration[j] -= change * ease[i][j];
            }
        }
        if (largest <= SWEEP_TOLERANCE) {
            break;
        }
    }
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double limit = model->friction_n_m[i];
        if (modes->at_rest[i] && !model->lifted[i] && fabs(friction_n_m[i]) >= limit) {
            const double *const row = model->rolling[i];
            const double wheel =
                row[0] * acceleration[0] + row[1] * acceleration[1] + row[2] * acceleration[2];
            /* What the sweeps left over is no motion. */
            if (fabs(wheel) > 1e3 * own[i] * (largest + SWEEP_TOLERANCE)) {
                modes->at_rest[i] = false;
                modes->sign[i] = copysign(1.0, wheel);
            }
        }
    }
}

/* A lifted wheel goes when its drive exceeds its friction. */
static void release_lifted(const mecanum_model *model, const double torque_n_m[MECANUM_WHEELS],
                           mecanum_modes *modes) {
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        if (model->lifted[i] && modes->at_rest[i] && fabs(torque_n_m[i]) > model->friction_n_m[i]) {
            modes->at_rest[i] = false;
            modes->sign[i] = copysign(1.0, torque_n_m[i]);
        }
    }
}

/* With slip each wheel turns on its own: it goes when drive and ground together exceed its friction. */
static void release_slip(const mecanum_model *model, const mecanum_state *state,
                         const double torque_n_m[MECANUM_WHEELS], mecanum_modes *modes) {
    mecanum_contact ground;
    mecanum_ground(model, modes, state, torque_n_m, &ground);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double left_n_m = torque_n_m[i] - model->radius_m[i] * ground.force_x_n[i];
        if (modes->at_rest[i] && fabs(left_n_m) > model->friction_n_m[i]) {
            modes->at_rest[i] = false;
            modes->sign[i] = copysign(1.0, left_n_m);
        }
    }
}

void mecanum_settle(const mecanum_model *model, const mecanum_inputs *u, mecanum_state *state,
                    mecanum_modes *modes) {
    double speed_rad_s[MECANUM_WHEELS];
    double torque_n_m[MECANUM_WHEELS];
    modes->any_at_rest = false;
    for (int j = 0; j < 3 && model->is_held; j++) {
        state->x[MECANUM_FORWARD_M_S + j] = 0.0;
    }
    if (!model->has_friction) {
        for (int i = 0; i < MECANUM_WHEELS; i++) {
            modes->sign[i] = 0.0;
            modes->at_rest[i] = false;
        }
        return;
    }
    mecanum_wheel_speeds(model, state, speed_rad_s);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        modes->at_rest[i] = fabs(speed_rad_s[i]) <= REST_RAD_S;
        modes->sign[i] = modes->at_rest[i] ? 0.0 : copysign(1.0, speed_rad_s[i]);
        modes->any_at_rest = modes->any_at_rest || modes->at_rest[i];
    }
    if (!modes->any_at_rest) {
        return;
    }
    other_torques(model, u, modes, state, speed_rad_s, torque_n_m);
    if (model->p->contact == MECANUM_CONTACT_SLIP) {
        release_slip(model, state, torque_n_m, modes);
    } else {
        release_lifted(model, torque_n_m, modes);
        release_rigid(model, u, state, torque_n_m, modes);
    }
    modes->any_at_rest = false;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        modes->any_at_rest = modes->any_at_rest || modes->at_rest[i];
        if (modes->at_rest[i]) {
            state->x[MECANUM_WHEEL_SPEED_RAD_S + i] = 0.0;
        }
    }
    if (modes->any_at_rest && model->p->contact != MECANUM_CONTACT_SLIP) {
        double twist[3];
        hold(model, modes);
        mecanum_apply(&modes->projector, state->x + MECANUM_FORWARD_M_S, twist);
        for (int j = 0; j < 3; j++) {
            state->x[MECANUM_FORWARD_M_S + j] = twist[j];
        }
    }
}

/* The smallest speed of a wheel in its own direction: negative once one has turned back. */
static double margin_rad_s(const mecanum_model *model, const mecanum_modes *modes,
                           const mecanum_state *state) {
    double speed_rad_s[MECANUM_WHEELS];
    double least = INFINITY;
    mecanum_wheel_speeds(model, state, speed_rad_s);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        if (modes->sign[i] != 0.0) {
            least = fmin(least, modes->sign[i] * speed_rad_s[i]);
        }
    }
    return least;
}

/* Integrates from `before` and returns the margin at the end. */
static double try_step(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                       const mecanum_state *before, double step_s, mecanum_state *state) {
    *state = *before;
    mecanum_integrate(model, u, modes, step_s, state);
    return margin_rad_s(model, modes, state);
}

/* Steps by `step_s`, or to the instant at which the first wheel comes to rest; returns the time stepped. */
static double step_to_rest(const mecanum_model *model, const mecanum_inputs *u, const mecanum_modes *modes,
                           double step_s, mecanum_state *state) {
    const mecanum_state before = *state;
    double late_s = step_s;
    double late = try_step(model, u, modes, &before, late_s, state);
    if (late >= -CROSSING_RAD_S) {
        return step_s;
    }
    double early_s = 0.0;
    double early = margin_rad_s(model, modes, &before);
    /* A wheel that only just begins to turn has no speed at the beginning: look for an instant when it has.
     */
    for (double s = 0.5 * step_s; early <= REST_RAD_S && s > step_s / MOST_HALVINGS; s *= 0.5) {
        early_s = s;
        early = try_step(model, u, modes, &before, s, state);
    }
    if (early <= REST_RAD_S) {
        /* One only begins to turn, and it or another turns back before the shortest step. The old signs hold
         * for a little; the next step has the new ones. */
        try_step(model, u, modes, &before, step_s / MOST_HALVINGS, state);
        return step_s / MOST_HALVINGS;
    }
    /* Regula falsi with the Illinois rule. */
    for (int i = 0; i < MOST_SEARCHES; i++) {
        const double middle_s = (early_s * late - late_s * early) / (late - early);
        const double middle = try_step(model, u, modes, &before, middle_s, state);
        if (fabs(middle) <= CROSSING_RAD_S) {
            return middle_s;
        }
        if (middle > 0.0) {
            early_s = middle_s;
            early = middle;
            late *= 0.5;
        } else {
            late_s = middle_s;
            late = middle;
            early *= 0.5;
        }
    }
    try_step(model, u, modes, &before, late_s, state);
    return late_s;
}

void mecanum_step(const mecanum_model *model, const mecanum_inputs *u, double step_s, mecanum_state *state) {
    mecanum_modes modes;
    double left_s = step_s;
    for (int crossings = 0; left_s > 0.0; crossings++) {
        mecanum_settle(model, u, state, &modes);
        if (!model->has_friction || crossings == MOST_CROSSINGS) {
            mecanum_integrate(model, u, &modes, left_s, state);
            return;
        }
        left_s -= step_to_rest(model, u, &modes, left_s, state);
    }
}
