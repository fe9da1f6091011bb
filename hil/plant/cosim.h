/* Steps a co-simulation FMU as the firmware's plant port: one C call a tick, no allocation, no Python.
 *
 * The FMU is loaded and initialised elsewhere; this holds its addresses (FMI 2.0) and its value references.
 */
#ifndef COSIM_H
#define COSIM_H

#include <stddef.h>
#include <stdint.h>

#include "plant_port.h"

/* cffi: begin */
enum {
    COSIM_POSE = 0,        /* x_m, y_m, heading_rad, world frame */
    COSIM_TWIST = 3,       /* vx_m_s, vy_m_s, yaw_rate_rad_s, world frame */
    COSIM_WHEEL_SPEED = 6, /* rad/s, FL, FR, RR, RL */
    COSIM_CURRENT = 10,    /* A */
    COSIM_GYRO = 14,       /* x, y, z, rad/s, body frame */
    COSIM_REALS = 17,
};

typedef struct {
    void *component; /* NULL once the FMU is gone */
    int (*set_real)(void *component, const unsigned *reference, size_t count, const double *value);
    int (*get_real)(void *component, const unsigned *reference, size_t count, double *value);
    int (*get_integer)(void *component, const unsigned *reference, size_t count, int *value);
    int (*do_step)(void *component, double from_s, double step_s, int no_return_before);

    unsigned torque_reference[4];
    unsigned real_reference[17]; /* COSIM_REALS, in the order above */
    unsigned count_reference[4];

    /* How the robot is wired: the wheel that each channel of the plant port drives, and in which sense. */
    int wheel_of_channel[4];
    int sign_of_channel[4]; /* 1 or -1 */

    uint64_t step_ns;
    uint64_t steps;  /* taken since the start */
    int failed;      /* once set, every exchange fails and `text` keeps the first reason */
    double real[17]; /* the newest outputs */
    int count[4];
    char text[256]; /* the FMU's words since the last good exchange, or why the exchange failed */
} cosim;

/* A wheel_plant_exchange whose context is a cosim. Returns 0, or 1 when the FMU failed or gave a number that
 * is not finite; then `text` says why and the outputs are those of the last good tick. */
int cosim_exchange(void *context, const wheel_drive *drive, wheel_sense *sense);

/* Holds the torques of the four channels for so many ticks. Stops at the first failure and returns like
 * cosim_exchange. */
int cosim_run(void *context, const float *torque_n_m, uint32_t ticks);

/* Time of the newest outputs since the start [ns]. */
uint64_t cosim_time_ns(const cosim *c);

/* fmi2CallbackLogger; the environment is a cosim. Keeps the newest message. */
void cosim_log(void *environment, const char *instance, int status, const char *category, const char *message,
               ...);
/* cffi: end */

#endif
