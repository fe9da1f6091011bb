/* Whether the robot stays on its wheels. The motion in the plane goes on as if it did. */
#include "model.h"

/* The point at which the ground's force acts upright, from the robot's centre and over the half distances of
 * the wheels: beyond 1 no load of the wheels holds the robot. Forward, left. */
static void pressed_point(const mecanum_model *model, const mecanum_inputs *u, const mecanum_motion *before,
                          double step_s, const mecanum_state *state, double part[2]) {
    const mecanum_parameters *const p = model->p;
    const mecanum_motion now = mecanum_motion_of(model, state);
    const double per_s = step_s > 0.0 ? 1.0 / step_s : 0.0;
    const double yaw_rate = now.twist[2];
    const double turning = (yaw_rate - before->twist[2]) * per_s;
    /* Of the centre of mass: what the ground gives is this times the mass, less the push and gravity. */
    const double forward_m_s2 = (now.twist[0] - before->twist[0]) * per_s - yaw_rate * now.twist[1] -
                                turning * p->com_y_m - yaw_rate * yaw_rate * p->com_x_m;
    const double left_m_s2 = (now.twist[1] - before->twist[1]) * per_s + yaw_rate * now.twist[0] +
                             turning * p->com_x_m - yaw_rate * yaw_rate * p->com_y_m;
    double force_x_n = p->mass_kg * forward_m_s2, force_y_n = p->mass_kg * left_m_s2;
    if (model->gravity_in_plane_n > 0.0) {
        const double uphill = p->slope_direction_rad - state->x[MECANUM_HEADING_RAD];
        force_x_n += model->gravity_in_plane_n * cos(uphill);
        force_y_n += model->gravity_in_plane_n * sin(uphill);
    }
    if (u->push_force_x_n != 0.0 || u->push_force_y_n != 0.0) {
        const double c = cos(state->x[MECANUM_HEADING_RAD]), s = sin(state->x[MECANUM_HEADING_RAD]);
        force_x_n -= c * u->push_force_x_n + s * u->push_force_y_n;
        force_y_n -= c * u->push_force_y_n - s * u->push_force_x_n;
    }
    const double pitch = model->gravity_upright_n * p->com_x_m - p->com_height_m * force_x_n -
                         (now.spin_n_m_s - before->spin_n_m_s) * per_s;
    const double roll =
        model->gravity_upright_n * p->com_y_m - p->com_height_m * force_y_n - yaw_rate * now.spin_n_m_s;
    part[0] = pitch / (model->gravity_upright_n * p->half_length_m);
    part[1] = roll / (model->gravity_upright_n * p->half_width_m);
}

mecanum_motion mecanum_motion_of(const mecanum_model *model, const mecanum_state *state) {
    const double *const x = state->x;
    const double *const speed = x + MECANUM_WHEEL_SPEED_RAD_S;
    return (mecanum_motion){
        {x[MECANUM_FORWARD_M_S], x[MECANUM_LEFT_M_S], x[MECANUM_YAW_RATE_RAD_S]},
        model->wheel_inertia_kg_m2 * (speed[0] + speed[1] + speed[2] + speed[3]),
    };
}

void mecanum_tip(const mecanum_model *model, const mecanum_inputs *u, const mecanum_motion *before,
                 double step_s, mecanum_state *state) {
    const mecanum_parameters *const p = model->p;
    double part[2];
    pressed_point(model, u, before, step_s, state, part);
    const bool lengthwise = fabs(part[0]) >= fabs(part[1]);
    state->tip_margin = 1.0 - fmax(fabs(part[0]), fabs(part[1]));
    if (state->tip_margin >= 0.0 && state->tip_rad == 0.0) {
        return;
    }
    /* A pendulum that stands on the wheels of one side: the pressed point beyond them lifts it, and the
     * higher it is the less of its weight brings it back. */
    const double half_m = lengthwise ? p->half_length_m : p->half_width_m;
    const double h = p->com_height_m;
    const double lifting_m2_s2 =
        model->gravity_upright_n / p->mass_kg * (h * state->tip_rad - state->tip_margin * half_m);
    state->tip_rad_s += step_s * lifting_m2_s2 / (half_m * half_m + h * h);
    state->tip_rad += step_s * state->tip_rad_s;
    if (state->tip_rad <= 0.0) {
        state->tip_rad = state->tip_rad_s = 0.0;
    }
}

bool mecanum_has_tipped(const mecanum_parameters *p, const mecanum_state *state) {
    return state->tip_rad * p->com_height_m > fmin(p->half_length_m, p->half_width_m);
}
