/* Steps an FMU as the firmware's plant port: one C call a tick, no allocation, no Python.
 *
 * The FMU (2.0 or 3.0) is loaded and initialised elsewhere. This holds its addresses, and for every signal of
 * the bridge the variable that carries it: bridge value = factor * FMU value + offset.
 */
#ifndef COSIM_H
#define COSIM_H

#include <stddef.h>
#include <stdint.h>

#include "plant_port.h"

/* cffi: begin */
enum {                   /* the inputs */
       COSIM_TORQUE = 0, /* N m, FL, FR, RR, RL */
       COSIM_DUTY = 4,   /* -1 to 1 */
       COSIM_ENABLED = 8,
       COSIM_INPUTS = 9,
};

enum {                          /* the outputs */
       COSIM_POSE = 0,          /* x_m, y_m, heading_rad, world frame */
       COSIM_TWIST = 3,         /* vx_m_s, vy_m_s, yaw_rate_rad_s, world frame */
       COSIM_WHEEL_SPEED = 6,   /* rad/s, FL, FR, RR, RL */
       COSIM_CURRENT = 10,      /* A */
       COSIM_GYRO = 14,         /* x, y, z, rad/s, body frame */
       COSIM_ACCELERATION = 17, /* x, y, z, m/s2, body frame, less gravity's */
       COSIM_BATTERY = 20,      /* V, A */
       COSIM_TEMPERATURE = 22,  /* degrees Celsius */
       COSIM_COUNT = 26,        /* encoder counts */
       COSIM_WHEEL_ANGLE = 30,  /* rad; read only where something follows from it */
       COSIM_SIGNALS = 34,
};

enum { /* the C types of an FMU's numbers; FMI 2.0 calls the first Real and COSIM_INT32 Integer */
       COSIM_FLOAT64,
       COSIM_FLOAT32,
       COSIM_INT8,
       COSIM_UINT8,
       COSIM_INT16,
       COSIM_UINT16,
       COSIM_INT32,
       COSIM_UINT32,
       COSIM_INT64,
       COSIM_UINT64,
       COSIM_TYPES,
};

typedef void (*cosim_function)(void); /* any function of an FMU; called as what the standard says it is */

typedef struct {
    size_t signal; /* of the enumerations above */
    size_t place;  /* where the FMU's value is among those of its group */
    double factor;
    double offset;
} cosim_row;

typedef struct { /* the variables of one type: one call into the FMU */
    int type;
    cosim_function call; /* fmi2GetReal, fmi3SetFloat32, ... */
    const unsigned *reference;
    size_t references;
    void *value; /* of that type; more of them than references where an FMI 3.0 variable is an array */
    size_t values;
    const cosim_row *row;
    size_t rows;
    int is_identity; /* every factor is 1, every offset 0 */
    int is_in_place; /* `value` is that part of `fresh` or of `input_value` which the rows name */
} cosim_group;

typedef struct { /* a variable that may be set between two ticks */
    unsigned reference;
    int type;            /* COSIM_FLOAT64 or COSIM_FLOAT32 */
    cosim_function call; /* fmi2SetReal, ... */
} cosim_variable;

typedef struct { /* an angle that the FMU may wrap */
    double newest_rad;
    double turns;
} cosim_winding;

typedef struct {
    void *component; /* NULL once the FMU is gone */
    int fmi_version; /* 2 or 3 */
    cosim_function do_step;
    cosim_function get_boolean_status; /* fmi2GetBooleanStatus, NULL with FMI 3.0 */

    cosim_group input[COSIM_TYPES];
    cosim_group output[COSIM_TYPES];
    size_t inputs;
    size_t outputs;
    const char *name[COSIM_SIGNALS];      /* for messages */
    const char *input_name[COSIM_INPUTS]; /* likewise */
    int is_bounded;                       /* whether any input has a range */
    double low[COSIM_INPUTS];             /* of an input, in the bridge's unit */
    double high[COSIM_INPUTS];

    const cosim_variable *settable;
    size_t settables;

    int derives; /* whether any of the following is set */
    int derived[COSIM_SIGNALS];
    double counts_per_revolution;
    double torque_constant_n_m_a;

    /* How the robot is wired: the wheel that each channel of the plant port drives, and in which sense. */
    int wheel_of_channel[4];
    int sign_of_channel[4]; /* 1 or -1 */

    /* One of both is a whole multiple of the other. Where a step is longer than a tick, the drive that begins
     * it is held until its end, and its outputs show then. */
    uint64_t tick_ns;
    uint64_t step_ns;                 /* a communication step of the FMU */
    uint64_t ticks;                   /* since the start */
    int failed;                       /* once set, every exchange fails and `text` keeps the first reason */
    int fatal;                        /* the FMU said that nothing of it may be called any more */
    double input_value[COSIM_INPUTS]; /* the newest inputs, by wheel */
    double fresh[COSIM_SIGNALS];      /* the outputs at the end of the newest step */
    uint64_t time_ns;                 /* since the start; pose and twist follow it in memory */
    double signal[COSIM_SIGNALS];     /* the outputs that show */
    cosim_winding winding[5];         /* heading, wheel angles */
    char text[512];                   /* the FMU's words since the last good exchange, or why that failed */
    int text_status;                  /* the worst fmi2Status or fmi3Status that those words came with */
    int prints_log;                   /* every message for the logger is a line on stderr, too */
} cosim;

/* Samples the outputs of an FMU that has just been initialised, and starts the time. Returns like
 * cosim_exchange. */
int cosim_start(cosim *c);

/* A wheel_plant_exchange whose context is a cosim. Returns 0, or 1 when the FMU failed, wished to end or gave
 * a number that is not finite; then `text` says why and the outputs are those of the last good tick. */
int cosim_exchange(void *context, const wheel_drive *drive, wheel_sense *sense);

/* Sets one of the settable variables of the context, which is a cosim, from the next tick on. Returns like
 * cosim_exchange. */
int cosim_set(void *context, size_t place, double value);

/* Holds the torques of the four channels for so many ticks. Stops at the first failure and returns like
 * cosim_exchange. */
int cosim_run(void *context, const float *torque_n_m, uint32_t ticks);

/* fmi2CallbackLogger and fmi3LogMessageCallback; the environment is a cosim. Of the warnings and worse
 * since the last good exchange they keep the newest of the worst status, and print all where that is wanted.
 */
void cosim_log2(void *environment, const char *instance, int status, const char *category,
                const char *message, ...);
void cosim_log3(void *environment, int status, const char *category, const char *message);

/* fmi2CallbackAllocateMemory and fmi2CallbackFreeMemory. */
void *cosim_allocate(size_t count, size_t size);
void cosim_free(void *memory);
/* cffi: end */

/* fmi2Status and fmi3Status agree on these. A run ends with a status that is worse than a warning. */
enum { COSIM_WARNING = 1, COSIM_DISCARD = 2, COSIM_FATAL = 4 };

/* Sets a variable of the FMU at once; returns its status. */
int cosim_put(cosim *c, const cosim_variable *v, double value);

/* The name of an fmi2Status or fmi3Status. */
const char *cosim_status_name(int status);

#endif
