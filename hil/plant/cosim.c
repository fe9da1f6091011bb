#include "cosim.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define FMI2_WARNING 1 /* the worst fmi2Status after which a simulation goes on */

_Static_assert(sizeof((cosim *)0)->real == COSIM_REALS * sizeof(double), "the sizes in cosim.h are one");

static int fail(cosim *c, const char *what) {
    /* The FMU's own words, when it gave some, are better. */
    if (c->text[0] == '\0') {
        snprintf(c->text, sizeof c->text, "%s", what);
    }
    c->failed = 1;
    return 1;
}

static int drive_tick(cosim *c, const wheel_drive *drive) {
    double torque_n_m[4];
    for (int i = 0; i < 4; i++) {
        torque_n_m[c->wheel_of_channel[i]] = c->sign_of_channel[i] * (double)drive->torque_n_m[i];
    }
    if (c->set_real(c->component, c->torque_reference, 4, torque_n_m) > FMI2_WARNING) {
        return fail(c, "the FMU refused the wheel torques");
    }
    /* start + n step, never accumulated; the division rounds once, the product not at all. */
    const double from_s = (double)(c->steps * c->step_ns) / 1e9;
    if (c->do_step(c->component, from_s, (double)c->step_ns / 1e9, 1) > FMI2_WARNING) {
        return fail(c, "the FMU failed to step");
    }
    c->steps++;
    return 0;
}

static int sample(cosim *c) {
    double real[COSIM_REALS];
    int count[4];
    if (c->get_real(c->component, c->real_reference, COSIM_REALS, real) > FMI2_WARNING ||
        c->get_integer(c->component, c->count_reference, 4, count) > FMI2_WARNING) {
        return fail(c, "the FMU refused to give its outputs");
    }
    for (int i = 0; i < COSIM_REALS; i++) {
        if (!isfinite(real[i])) {
            return fail(c, "an output of the FMU is not finite");
        }
    }
    memcpy(c->real, real, sizeof real);
    memcpy(c->count, count, sizeof count);
    return 0;
}

int cosim_exchange(void *context, const wheel_drive *drive, wheel_sense *sense) {
    cosim *const c = context;
    if (c->failed) {
        return 1;
    }
    c->text[0] = '\0';
    if (c->component == NULL) {
        return fail(c, "the FMU is closed");
    }
    if (drive != NULL && drive_tick(c, drive) != 0) {
        return 1;
    }
    if (sample(c) != 0) {
        return 1;
    }
    /* What holds after tick n is what tick n + 1 samples at its beginning. */
    sense->tick = drive != NULL ? drive->tick + 1 : (uint32_t)c->steps;
    for (int i = 0; i < 4; i++) {
        const int wheel = c->wheel_of_channel[i];
        const int sign = c->sign_of_channel[i];
        sense->count[i] = (uint16_t)((unsigned)sign * (unsigned)c->count[wheel]); /* modulo 2^16 */
        sense->current_a[i] = (float)(sign * c->real[COSIM_CURRENT + wheel]);
    }
    for (int i = 0; i < 3; i++) {
        sense->gyro_rad_s[i] = (float)c->real[COSIM_GYRO + i];
    }
    return 0;
}

int cosim_run(void *context, const float *torque_n_m, uint32_t ticks) {
    cosim *const c = context;
    wheel_sense sense;
    for (uint32_t i = 0; i < ticks; i++) {
        wheel_drive drive = {.tick = (uint32_t)c->steps};
        memcpy(drive.torque_n_m, torque_n_m, sizeof drive.torque_n_m);
        if (cosim_exchange(c, &drive, &sense) != 0) {
            return 1;
        }
    }
    return 0;
}

uint64_t cosim_time_ns(const cosim *c) {
    return c->steps * c->step_ns;
}

void cosim_log(void *environment, const char *instance, int status, const char *category, const char *message,
               ...) {
    (void)instance, (void)status, (void)category;
    cosim *const c = environment;
    va_list arguments;
    va_start(arguments, message);
    vsnprintf(c->text, sizeof c->text, message, arguments);
    va_end(arguments);
}
