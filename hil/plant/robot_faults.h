/* Faults of the robot itself and of its plant, between the firmware and the plant: exact to the tick, without
 * Python. The wiring of encoders and IMU is here too; that of the motors is the plant's.
 *
 * A robot_faults is the context of a wheel_plant_exchange in front of another one. Without rows it only
 * passes on.
 */
#ifndef ROBOT_FAULTS_H
#define ROBOT_FAULTS_H

#include <stddef.h>
#include <stdint.h>

#include "plant_port.h"

/* cffi: begin */
typedef enum {
    ROBOT_FAULT_LOST_COUNTS, /* `place` is the channel, `value` the part that is lost */
    ROBOT_FAULT_DEAD_MOTOR,  /* `place` is the channel */
    ROBOT_FAULT_GYRO_BIAS,   /* `value` rad/s */
    ROBOT_FAULT_SLOW_CLOCK,  /* `value` ppm */
    ROBOT_FAULT_RESET,       /* at `first` */
    ROBOT_FAULT_SET,         /* `place` is the variable's among the settable ones */
} robot_fault_kind;

typedef struct {
    int32_t kind;
    uint32_t place;
    double value;
    double base;    /* of the variable, when nothing acts on it */
    uint64_t first; /* robot ticks since the scenario's time began; first <= t < end */
    uint64_t end;
    uint32_t account; /* rows of one fault count together, each tick once */
    /* Where radius_m > 0: it acts only while the point of the body (forward_m, left_m) is in the circle. */
    double radius_m, x_m, y_m, forward_m, left_m;
    int32_t acts;
    int32_t changes; /* acts no longer, or since this tick */
} robot_fault;

typedef struct {
    uint64_t applied;
    uint64_t newest_tick; /* that was counted, plus 1 */
} robot_fault_account;

typedef struct {
    int32_t differs;            /* else nothing of this is looked at */
    int32_t encoder_channel[4]; /* the channel of the plant that each encoder input counts */
    int32_t encoder_sign[4];    /* 1 or -1 */
    int32_t imu_axis[3];        /* the robot's axis along each axis of the IMU */
    int32_t imu_sign[3];        /* 1 or -1 */
} robot_wiring;

typedef struct {
    wheel_plant_exchange exchange; /* the plant */
    void *context;
    int (*set)(void *context, size_t place, double value); /* returns 0, or 1 when the plant failed */
    const double *pose;                                    /* newest: x_m, y_m, heading_rad */
    robot_fault *row;
    size_t rows;
    robot_fault_account *account;
    uint64_t ticks;      /* of the firmware since its first power-on; goes on over a reset */
    uint64_t boot_ticks; /* of the firmware since its newest power-on */
    uint64_t origin;     /* in `ticks` */
    int32_t has_begun;
    int32_t is_off;       /* the firmware waits for `robot_faults_power_on` */
    uint64_t extra_ticks; /* that the plant went on and the firmware did not count */
    double owed_ticks;
    robot_wiring wiring;
    uint16_t lost[4];  /* counts that an encoder missed */
    double owed[4];    /* what it is to miss of the next one */
    uint16_t count[4]; /* the plant's newest */
} robot_faults;

/* A wheel_plant_exchange whose context is a robot_faults. */
int robot_faults_exchange(void *context, const wheel_drive *drive, wheel_sense *sense);

/* The scenario's time begins now, or at a tick of the firmware's that has been. */
void robot_faults_begin(robot_faults *faults, uint32_t tick);

/* The firmware was powered on again, and its ticks begin at 0. */
void robot_faults_power_on(robot_faults *faults);
/* cffi: end */

#endif
