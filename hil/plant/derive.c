#include "derive.h"

#include <math.h>

static const double PI = 3.14159265358979323846;
static const double TWO_PI = 6.28318530717958647692;

/* An angle that jumps by about a whole turn in one tick was wrapped by the FMU; no robot turns so fast. */
static double unwound(cosim_winding *w, double angle_rad) {
    const double jump_rad = angle_rad - w->newest_rad;
    if (fabs(fabs(jump_rad) - TWO_PI) < PI) {
        w->turns -= jump_rad > 0.0 ? 1.0 : -1.0;
    }
    w->newest_rad = angle_rad;
    return w->turns == 0.0 ? angle_rad : angle_rad + w->turns * TWO_PI;
}

void cosim_start_winding(cosim *c) {
    c->winding[0] = (cosim_winding){.newest_rad = c->fresh[COSIM_POSE + 2]};
    for (size_t i = 0; i < 4; i++) {
        c->winding[1 + i] = (cosim_winding){.newest_rad = c->fresh[COSIM_WHEEL_ANGLE + i]};
    }
}

void cosim_unwind(cosim *c) {
    double *const heading_rad = &c->fresh[COSIM_POSE + 2];
    *heading_rad = unwound(&c->winding[0], *heading_rad);
    for (size_t i = 0; c->derives && i < 4; i++) {
        double *const angle_rad = &c->fresh[COSIM_WHEEL_ANGLE + i];
        *angle_rad = unwound(&c->winding[1 + i], *angle_rad);
    }
}

/* The speed of what is at `from`, since the outputs that show. Where no time has passed, 0: that is the
 * start. */
static double rate(const cosim *c, size_t from, bool passed) {
    const double since_s = (double)(c->step_ns > c->tick_ns ? c->step_ns : c->tick_ns) / 1e9;
    return passed ? (c->fresh[from] - c->signal[from]) / since_s : 0.0;
}

void cosim_derive(cosim *c, bool passed) {
    double *const fresh = c->fresh;
    for (size_t i = 0; i < COSIM_SIGNALS; i++) {
        if (!c->derived[i]) {
            continue;
        }
        if (i < COSIM_WHEEL_SPEED) { /* a component of the twist */
            fresh[i] = rate(c, i - COSIM_TWIST + COSIM_POSE, passed);
        } else if (i < COSIM_CURRENT) {
            fresh[i] = rate(c, i - COSIM_WHEEL_SPEED + COSIM_WHEEL_ANGLE, passed);
        } else if (i < COSIM_GYRO) {
            fresh[i] = c->input_value[COSIM_TORQUE + i - COSIM_CURRENT] / c->torque_constant_n_m_a;
        } else if (i < COSIM_ACCELERATION) {
            fresh[i] = i == COSIM_GYRO + 2 ? fresh[COSIM_TWIST + 2] : 0.0; /* the robot stays level */
        } else if (i < COSIM_COUNT) {
            fresh[i] = 0.0; /* not there: the firmware does not say that it has it */
        } else {            /* a count, which is rounded down when it is sensed */
            const double angle_rad = fresh[i - COSIM_COUNT + COSIM_WHEEL_ANGLE];
            fresh[i] = angle_rad / TWO_PI * c->counts_per_revolution;
        }
    }
}
