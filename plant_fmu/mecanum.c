#include "mecanum.h"

#include <string.h>

static const double GRAVITY_M_S2 = 9.81;
static const double TWO_PI = 6.283185307179586476925286766559;
static const double LONGEST_STEP_S = 1e-3;

/* Rows of H: wheel speed = (1/r) H (forward, left, yaw rate); the third column is times L = l1 + l2. */
static const double H[MECANUM_WHEELS][3] = {
    {1.0, -1.0, -1.0},
    {1.0, 1.0, 1.0},
    {1.0, -1.0, 1.0},
    {1.0, 1.0, -1.0},
};

/* What the wheels add to the mass when they turn with the robot: k = 4 Ib / r^2. */
static double wheel_mass_kg(const mecanum_parameters *p) {
    return 4.0 * p->wheel_inertia_kg_m2 / (p->wheel_radius_m * p->wheel_radius_m);
}

static double lever_m(const mecanum_parameters *p) {
    return p->half_length_m + p->half_width_m;
}

/* Friction torque at full speed, a wheel: mu m g r / 4. */
static double friction_torque_n_m(const mecanum_parameters *p) {
    return p->friction_coefficient * p->mass_kg * GRAVITY_M_S2 * p->wheel_radius_m / MECANUM_WHEELS;
}

/* omega = (1/r) H R(heading)^T (vx, vy, yaw rate) */
static void wheel_speeds(const mecanum_parameters *p, const double state[MECANUM_STATES], double cos_heading,
                         double sin_heading, double speed_rad_s[MECANUM_WHEELS]) {
    const double vx = state[MECANUM_VX_M_S];
    const double vy = state[MECANUM_VY_M_S];
    const double forward = cos_heading * vx + sin_heading * vy;
    const double left = -sin_heading * vx + cos_heading * vy;
    const double turn = lever_m(p) * state[MECANUM_YAW_RATE_RAD_S];
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        speed_rad_s[i] = (H[i][0] * forward + H[i][1] * left + H[i][2] * turn) / p->wheel_radius_m;
    }
}

void mecanum_start(const mecanum_parameters *p, double state[MECANUM_STATES]) {
    memset(state, 0, MECANUM_STATES * sizeof state[0]);
    state[MECANUM_X_M] = p->start_x_m;
    state[MECANUM_Y_M] = p->start_y_m;
    state[MECANUM_HEADING_RAD] = p->start_heading_rad;
    state[MECANUM_VX_M_S] = p->start_vx_m_s;
    state[MECANUM_VY_M_S] = p->start_vy_m_s;
    state[MECANUM_YAW_RATE_RAD_S] = p->start_yaw_rate_rad_s;
}

void mecanum_derivative(const mecanum_parameters *p, const mecanum_inputs *u,
                        const double state[MECANUM_STATES], double derivative[MECANUM_STATES]) {
    const double cos_heading = cos(state[MECANUM_HEADING_RAD]);
    const double sin_heading = sin(state[MECANUM_HEADING_RAD]);
    double *const speed_rad_s = derivative + MECANUM_WHEEL_ANGLE_RAD;
    wheel_speeds(p, state, cos_heading, sin_heading, speed_rad_s);

    /* (1/r) H^T (tau - xi): force and moment in the body frame */
    const double friction_n_m = friction_torque_n_m(p);
    double forward = 0.0;
    double left = 0.0;
    double turn = 0.0;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        double torque_n_m = u->wheel_torque_n_m[i] - p->viscous_n_m_s_rad * speed_rad_s[i];
        if (friction_n_m > 0.0) {
            torque_n_m -= friction_n_m * tanh(speed_rad_s[i] / 0.1);
        }
        forward += H[i][0] * torque_n_m;
        left += H[i][1] * torque_n_m;
        turn += H[i][2] * torque_n_m;
    }
    const double fx = (cos_heading * forward - sin_heading * left) / p->wheel_radius_m;
    const double fy = (sin_heading * forward + cos_heading * left) / p->wheel_radius_m;
    const double moment = lever_m(p) * turn / p->wheel_radius_m;

    /* M q'' = B (tau - xi) - C with C = c heading' (y', -x', 0) */
    const double k = wheel_mass_kg(p);
    const double c = p->coriolis == MECANUM_CORIOLIS_PAPER ? p->mass_kg + k : k;
    const double yaw_rate = state[MECANUM_YAW_RATE_RAD_S];
    const double inertia = p->inertia_kg_m2 + k * lever_m(p) * lever_m(p);
    derivative[MECANUM_X_M] = state[MECANUM_VX_M_S];
    derivative[MECANUM_Y_M] = state[MECANUM_VY_M_S];
    derivative[MECANUM_HEADING_RAD] = yaw_rate;
    derivative[MECANUM_VX_M_S] = (fx - c * yaw_rate * state[MECANUM_VY_M_S]) / (p->mass_kg + k);
    derivative[MECANUM_VY_M_S] = (fy + c * yaw_rate * state[MECANUM_VX_M_S]) / (p->mass_kg + k);
    derivative[MECANUM_YAW_RATE_RAD_S] = moment / inertia;
}

double mecanum_longest_step_s(const mecanum_parameters *p) {
    /* Friction is steepest at standstill. A slope s [N m s/rad] at each wheel damps translation at
     * 4 s / (r^2 (m + k)) and rotation at 4 s L^2 / (r^2 (I + k L^2)). The method is stable up to 2.78 over
     * the faster of the two; 0.1 keeps its error a step below 1e-7. */
    const double r = p->wheel_radius_m;
    const double k = wheel_mass_kg(p);
    const double slope = p->viscous_n_m_s_rad + friction_torque_n_m(p) / 0.1;
    const double translation = 1.0 / (p->mass_kg + k);
    const double rotation = 1.0 / (p->inertia_kg_m2 / (lever_m(p) * lever_m(p)) + k);
    const double rate_1_s = 4.0 * slope / (r * r) * fmax(translation, rotation);
    return rate_1_s * LONGEST_STEP_S > 0.1 ? 0.1 / rate_1_s : LONGEST_STEP_S;
}

void mecanum_step(const mecanum_parameters *p, const mecanum_inputs *u, double step_s,
                  double state[MECANUM_STATES]) {
    static const double ADVANCE[3] = {0.5, 0.5, 1.0};
    static const double WEIGHT[4] = {1.0, 2.0, 2.0, 1.0};
    double at[MECANUM_STATES];
    double slope[MECANUM_STATES];
    double sum[MECANUM_STATES] = {0.0};
    memcpy(at, state, sizeof at);
    for (int stage = 0; stage < 4; stage++) {
        mecanum_derivative(p, u, at, slope);
        for (int i = 0; i < MECANUM_STATES; i++) {
            sum[i] += WEIGHT[stage] * slope[i];
            if (stage < 3) {
                at[i] = state[i] + ADVANCE[stage] * step_s * slope[i];
            }
        }
    }
    for (int i = 0; i < MECANUM_STATES; i++) {
        state[i] += step_s / 6.0 * sum[i];
    }
}

/* Encoder count: rounded down, in 32 bits. Past 2^53 counts a double no longer tells one from the next, and
 * the counter stands still. */
static int32_t count(const mecanum_parameters *p, double angle_rad) {
    const double counts = floor(angle_rad / TWO_PI * p->counts_per_revolution);
    const double bounded = fmin(fmax(counts, -9007199254740992.0), 9007199254740992.0);
    const uint32_t wrapped = (uint32_t)(uint64_t)(int64_t)bounded;
    int32_t result;
    memcpy(&result, &wrapped, sizeof result);
    return result;
}

void mecanum_output(const mecanum_parameters *p, const mecanum_inputs *u, const double state[MECANUM_STATES],
                    mecanum_outputs *out) {
    out->pose_x_m = state[MECANUM_X_M];
    out->pose_y_m = state[MECANUM_Y_M];
    out->pose_heading_rad = state[MECANUM_HEADING_RAD];
    out->twist_vx_m_s = state[MECANUM_VX_M_S];
    out->twist_vy_m_s = state[MECANUM_VY_M_S];
    out->twist_yaw_rate_rad_s = state[MECANUM_YAW_RATE_RAD_S];
    out->gyro_x_rad_s = 0.0;
    out->gyro_y_rad_s = 0.0;
    out->gyro_z_rad_s = state[MECANUM_YAW_RATE_RAD_S];
    wheel_speeds(p, state, cos(state[MECANUM_HEADING_RAD]), sin(state[MECANUM_HEADING_RAD]),
                 out->wheel_speed_rad_s);
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double angle_rad = state[MECANUM_WHEEL_ANGLE_RAD + i];
        out->wheel_angle_rad[i] = angle_rad;
        out->wheel_count[i] = count(p, angle_rad);
        out->wheel_current_a[i] = u->wheel_torque_n_m[i] / p->motor_constant_n_m_a;
    }
}

bool mecanum_is_finite(const double state[MECANUM_STATES]) {
    for (int i = 0; i < MECANUM_STATES; i++) {
        if (!isfinite(state[i])) {
            return false;
        }
    }
    return true;
}
