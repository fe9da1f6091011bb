/* Constants of the model, and the forces on the body that neither wheels nor ground make. */
#include "model.h"

static const double GRAVITY_M_S2 = 9.81;
static const double ROOT_HALF = 0.70710678118654752440;

static void place_wheels(mecanum_model *model, const mecanum_parameters *p) {
    static const double FRONT[MECANUM_WHEELS] = {1.0, 1.0, -1.0, -1.0};
    static const double LEFT[MECANUM_WHEELS] = {1.0, -1.0, -1.0, 1.0};
    const double mirror = p->rollers == MECANUM_ROLLERS_O ? -1.0 : 1.0;
    const bool at_45 = p->sideways_loss == 0.0; /* nearly always, and faster so */
    const double slant = at_45 ? 1.0 : 1.0 / (1.0 - p->sideways_loss);
    model->roller_cosine = at_45 ? ROOT_HALF : sqrt(1.0 / (1.0 + slant * slant));
    model->is_uneven = slant != 1.0;
    model->any_hangs = false;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double x = FRONT[i] * p->half_length_m;
        const double y = LEFT[i] * p->half_width_m;
        const double s = -mirror * FRONT[i] * LEFT[i] * slant;
        const double r = p->wheel_radius_m * p->wheel_radius_factor[i];
        model->wheel_x_m[i] = x;
        model->wheel_y_m[i] = y;
        model->radius_m[i] = r;
        model->hangs[i] = p->wheel_lifted[i] >= 0.5 && p->blocks < 0.5;
        model->any_hangs = model->any_hangs || model->hangs[i];
        model->roller_slant[i] = s;
        model->is_uneven = model->is_uneven || p->wheel_radius_factor[i] != 1.0;
        /* The contact does not move along the roller's axis (1, s): r omega = u - y W + s (w + x W). */
        model->rolling[i][0] = 1.0 / r;
        model->rolling[i][1] = s / r;
        model->rolling[i][2] = (s * x - y) / r;
    }
}

void mecanum_share_load(const mecanum_model *model, double pitch_n_m, double roll_n_m,
                        double load_n[MECANUM_WHEELS]) {
    const double whole_n = model->gravity_upright_n;
    double sum_n = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        load_n[i] = 0.25 * (whole_n + pitch_n_m / model->wheel_x_m[i] + roll_n_m / model->wheel_y_m[i]);
    }
    /* More load on one diagonal and as much less on the other changes no balance: what a lifted wheel needs.
     */
    const double least = fmax(-load_n[0], -load_n[2]);
    const double most = fmin(load_n[1], load_n[3]);
    double shift_n = fmax(fmin(most, 0.0), least);
    const bool on_one = (model->hangs[0] || model->hangs[2]) != (model->hangs[1] || model->hangs[3]);
    for (int i = 0; on_one && i < MECANUM_WHEELS; i++) {
        if (model->hangs[i]) {
            shift_n = i % 2 == 0 ? -load_n[i] : load_n[i];
        }
    }
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        load_n[i] = fmax(0.0, load_n[i] + (i % 2 == 0 ? shift_n : -shift_n));
        load_n[i] = model->hangs[i] ? 0.0 : load_n[i];
        sum_n += load_n[i];
    }
    const bool falls = least > most || model->any_hangs; /* onto the wheels that are left */
    for (int i = 0; falls && sum_n > 0.0 && i < MECANUM_WHEELS; i++) {
        load_n[i] *= whole_n / sum_n;
    }
}

static void equip_axles(mecanum_model *model, const mecanum_parameters *p) {
    const double whole_n = model->gravity_upright_n;
    mecanum_share_load(model, whole_n * p->com_x_m, whole_n * p->com_y_m, model->load_n);
    model->has_friction = false;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        model->friction_n_m[i] =
            p->friction_coefficient * p->wheel_friction_factor[i] * model->load_n[i] * model->radius_m[i];
        model->viscous_n_m_s_rad[i] = p->viscous_n_m_s_rad * p->wheel_friction_factor[i];
        model->axle_constant[i] = p->gear_ratio * p->motor_constant_n_m_a * p->wheel_torque_factor[i];
        model->has_friction = model->has_friction || model->friction_n_m[i] > 0.0;
    }
}

static void lift_wheels(mecanum_model *model, const mecanum_parameters *p) {
    model->any_lifted = false;
    model->is_held = true;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        model->lifted[i] = p->wheel_lifted[i] >= 0.5;
        model->any_lifted = model->any_lifted || model->lifted[i];
        model->is_held = model->is_held && model->lifted[i];
        for (int j = 0; j < 3 && model->lifted[i]; j++) {
            model->rolling[i][j] = 0.0;
        }
    }
}

/* Mass matrix in the body frame: ((a, 0, -b), (0, a, c), (-b, c, d)), with b and c from the centre of mass.
 */
static void weigh(mecanum_model *model, const mecanum_parameters *p) {
    const double lever_m = model->rolling[1][2] * p->wheel_radius_m;
    const double square_m2 = p->com_x_m * p->com_x_m + p->com_y_m * p->com_y_m;
    const bool rigid = p->contact != MECANUM_CONTACT_SLIP;
    model->wheel_inertia_kg_m2 =
        p->wheel_inertia_kg_m2 + p->gear_ratio * p->gear_ratio * p->rotor_inertia_kg_m2;
    model->carried_kg =
        rigid ? 4.0 * model->wheel_inertia_kg_m2 / (p->wheel_radius_m * p->wheel_radius_m) : 0.0;
    model->turning_kg_m2 = p->inertia_kg_m2 + p->mass_kg * square_m2 + model->carried_kg * lever_m * lever_m;
    model->coriolis_kg = rigid && p->coriolis == MECANUM_CORIOLIS_PAPER ? 0.0 : p->mass_kg;
    const double a = p->mass_kg + model->carried_kg;
    const double b = p->mass_kg * p->com_y_m / a;
    const double c = p->mass_kg * p->com_x_m / a;
    const double yaw = 1.0 / (model->turning_kg_m2 - a * (b * b + c * c));
    model->inverse_mass = (mecanum_matrix){{
        {1.0 / a + b * b * yaw, -b * c * yaw, b * yaw},
        {-b * c * yaw, 1.0 / a + c * c * yaw, -c * yaw},
        {b * yaw, -c * yaw, yaw},
    }};
}

/* The same of any wheels: those on the ground alone turn with the body. On blocks nothing moves it. */
static void weigh_any(mecanum_model *model, const mecanum_parameters *p) {
    const double y_kg_m = p->mass_kg * p->com_y_m;
    const double x_kg_m = p->mass_kg * p->com_x_m;
    const double about_com = p->com_x_m * p->com_x_m + p->com_y_m * p->com_y_m;
    double m[3][3] = {{p->mass_kg, 0.0, -y_kg_m},
                      {0.0, p->mass_kg, x_kg_m},
                      {-y_kg_m, x_kg_m, p->inertia_kg_m2 + p->mass_kg * about_com}};
    for (int i = 0; i < MECANUM_WHEELS && model->carried_kg > 0.0; i++) {
        for (int j = 0; j < 3; j++) {
            for (int k = 0; k < 3; k++) {
                m[j][k] += model->wheel_inertia_kg_m2 * model->rolling[i][j] * model->rolling[i][k];
            }
        }
    }
    /* The adjugate over the determinant. */
    double adjugate[3][3];
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            const int j1 = (j + 1) % 3, j2 = (j + 2) % 3, k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            adjugate[k][j] = m[j1][k1] * m[j2][k2] - m[j1][k2] * m[j2][k1];
        }
    }
    const double determinant = m[0][0] * adjugate[0][0] + m[0][1] * adjugate[1][0] + m[0][2] * adjugate[2][0];
    for (int j = 0; j < 3; j++) {
        for (int k = 0; k < 3; k++) {
            model->inverse_mass.at[j][k] = model->is_held ? 0.0 : adjugate[j][k] / determinant;
        }
    }
}

void mecanum_prepare(mecanum_model *model, const mecanum_parameters *p) {
    const double weight_n = p->mass_kg * GRAVITY_M_S2;
    model->p = p;
    model->gravity_in_plane_n = weight_n * sin(p->slope_rad);
    model->gravity_upright_n = weight_n * cos(p->slope_rad);
    place_wheels(model, p);
    equip_axles(model, p);
    weigh(model, p);
    lift_wheels(model, p);
    if (model->any_lifted || model->is_uneven) {
        weigh_any(model, p);
    }
}

void mecanum_wheel_speeds(const mecanum_model *model, const mecanum_state *state,
                          double speed_rad_s[MECANUM_WHEELS]) {
    const double *const twist = state->x + MECANUM_FORWARD_M_S;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double *const row = model->rolling[i];
        speed_rad_s[i] = model->p->contact == MECANUM_CONTACT_SLIP
                             ? state->x[MECANUM_WHEEL_SPEED_RAD_S + i]
                             : row[0] * twist[0] + row[1] * twist[1] + row[2] * twist[2];
    }
    for (int i = 0; i < MECANUM_WHEELS && model->any_lifted; i++) {
        if (model->lifted[i]) {
            speed_rad_s[i] = state->x[MECANUM_WHEEL_SPEED_RAD_S + i];
        }
    }
}

void mecanum_body_force(const mecanum_model *model, const mecanum_inputs *u, const mecanum_state *state,
                        double force[3]) {
    const mecanum_parameters *const p = model->p;
    const double forward = state->x[MECANUM_FORWARD_M_S];
    const double left = state->x[MECANUM_LEFT_M_S];
    const double yaw_rate = state->x[MECANUM_YAW_RATE_RAD_S];
    const double heading = state->x[MECANUM_HEADING_RAD];
    const double mass = p->mass_kg;
    force[0] = yaw_rate * (model->coriolis_kg * left + mass * yaw_rate * p->com_x_m);
    force[1] = yaw_rate * (-model->coriolis_kg * forward + mass * yaw_rate * p->com_y_m);
    force[2] = -mass * yaw_rate * (p->com_x_m * forward + p->com_y_m * left) + u->push_moment_n_m;
    if (u->push_force_x_n != 0.0 || u->push_force_y_n != 0.0) {
        force[0] += cos(heading) * u->push_force_x_n + sin(heading) * u->push_force_y_n;
        force[1] += -sin(heading) * u->push_force_x_n + cos(heading) * u->push_force_y_n;
    }
    if (model->gravity_in_plane_n > 0.0) {
        const double along = -model->gravity_in_plane_n * cos(p->slope_direction_rad - heading);
        const double aside = -model->gravity_in_plane_n * sin(p->slope_direction_rad - heading);
        force[0] += along;
        force[1] += aside;
        force[2] += p->com_x_m * aside - p->com_y_m * along;
    }
}

void mecanum_apply(const mecanum_matrix *matrix, const double vector[3], double result[3]) {
    for (int i = 0; i < 3; i++) {
        const double *const row = matrix->at[i];
        result[i] = row[0] * vector[0] + row[1] * vector[1] + row[2] * vector[2];
    }
}
