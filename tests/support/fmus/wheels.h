/* A foreign robot for the tests: four wheels, each a double integrator, with a tool's own names, units and
 * types.
 *
 * Torques are in N cm, wheel angles in degrees, the heading in degrees and wrapped to (-180, 180]. A
 * parameter chooses how it misbehaves from a time on. */
#ifndef WHEELS_H
#define WHEELS_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* The importer takes its functions by name and calls only what the FMU claims to have. */
#define STUB(name)                                                                                           \
    EXPORT int name(void);                                                                                   \
    EXPORT int name(void) {                                                                                  \
        return 3;                                                                                            \
    }

#define GUID "{wheels}"
#define RADIUS_M 0.1
#define LEVER_M 0.5
#define PI 3.14159265358979323846

enum { OK, WARNING, DISCARD, ERROR, FATAL, PENDING };

enum { /* fault */
       NO_FAULT,
       SAY_ERROR,
       SILENT_ERROR,
       SAY_DISCARD,
       SAY_FATAL,
       GIVE_NAN,
       END,
       RETURN_EARLY,
       REACH_ELSEWHERE,
       SAY_WARNING,
       RETURN_PENDING,
       FAIL_AT_INITIALIZATION,
       FAIL_TO_RESET,
       FAIL_TO_READ,
       ASK_FOR_EVENT_MODE,
       REFUSE_TO_BEGIN, /* this one and the next show after a reset, which leaves them */
       STAY_IN_CONFIGURATION,
};

typedef struct {
    double torque_n_cm[4];
    double inertia_kg_m2;
    double fault_time_s;
    double grain_s; /* the one communication step that it takes; 0 for any */
    int fault;
    int gear; /* an enumeration: 1 direct, 3 geared */
    bool reversed;
    char label[32];
    double speed_rad_s[4];
    double angle_rad[4];
    double time_s;
    bool initialised;
} wheels;

static inline void wheels_init(wheels *w) {
    memset(w, 0, sizeof *w);
    w->inertia_kg_m2 = 0.02;
    w->fault_time_s = 1e9;
    w->gear = 1;
}

static inline void wheels_reset(wheels *w) {
    const int fault = w->fault;
    wheels_init(w);
    w->fault = fault < REFUSE_TO_BEGIN ? NO_FAULT : fault;
}

static inline bool is_faulty(const wheels *w, int fault) {
    return w->fault == fault && w->time_s >= w->fault_time_s - 1e-9;
}

static inline double acceleration_rad_s2(const wheels *w, int i) {
    return (w->reversed ? -1.0 : 1.0) * w->gear * w->torque_n_cm[i] / 100.0 / w->inertia_kg_m2;
}

/* Exact while the torques are held. */
static inline void wheels_step(wheels *w, double step_s) {
    for (int i = 0; i < 4; i++) {
        const double a = acceleration_rad_s2(w, i);
        w->angle_rad[i] += w->speed_rad_s[i] * step_s + a * step_s * step_s / 2.0;
        w->speed_rad_s[i] += a * step_s;
    }
    w->time_s += step_s;
}

static inline bool takes(const wheels *w, double step_s) {
    return w->grain_s == 0.0 || fabs(step_s - w->grain_s) < 1e-12;
}

static inline double x_m(const wheels *w) {
    const double *const a = w->angle_rad;
    return is_faulty(w, GIVE_NAN) ? NAN : RADIUS_M / 4.0 * (a[0] + a[1] + a[2] + a[3]);
}

static inline double y_m(const wheels *w) {
    const double *const a = w->angle_rad;
    return RADIUS_M / 4.0 * (-a[0] + a[1] - a[2] + a[3]);
}

static inline double heading_deg(const wheels *w) {
    const double *const a = w->angle_rad;
    const double heading_rad = RADIUS_M / (4.0 * LEVER_M) * (-a[0] + a[1] + a[2] - a[3]);
    return remainder(heading_rad, 2.0 * PI) * 180.0 / PI;
}

static inline int64_t count(const wheels *w, int i) {
    return (int64_t)floor(w->angle_rad[i] / (2.0 * PI) * 1000.0);
}

#endif
