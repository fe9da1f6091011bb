/* What the firmware runs with. Parameters change in IDLE only; the host compares their hash before it arms.
 */
#ifndef WHEEL_PARAMETERS_H
#define WHEEL_PARAMETERS_H

#include <stdbool.h>
#include <stdint.h>

/* cffi: begin */
typedef struct {
    float counts_per_revolution;    /* encoder counts a revolution of the wheel */
    float tracking_bandwidth_rad_s; /* of the filter that estimates the wheel speed */
    float speed_kp_n_m_s_rad;       /* speed loop, proportional */
    float speed_ki_n_m_rad;         /* speed loop, integral */
    float torque_limit_n_m;         /* a wheel; beyond it all four are scaled */
    float overspeed_rad_s;          /* a wheel faster than this is a fault */
    float watchdog_s;               /* without a fresh command for so long the robot stops */
    float ramp_s;                   /* the set point reaches zero in this time */
    float feedback_period_s;        /* between two snapshots */
} wheel_parameters;

typedef struct {
    const char *name;
    float minimum;
    float maximum;
} wheel_parameter_info;

#define WHEEL_PARAMETER_COUNT 9
/* cffi: end */

/* The parameters in the order of wheel_parameters, which is the order of their hash. */
extern const wheel_parameter_info wheel_parameter_table[WHEEL_PARAMETER_COUNT];

/* cffi: begin */
/* Index of the first parameter that is not finite or out of its range, or -1 when all are good. */
int wheel_parameters_invalid(const wheel_parameters *parameters);

/* CRC-32 (IEEE 802.3) over the values as little-endian binary32, in the order of the table. */
uint32_t wheel_parameters_hash(const wheel_parameters *parameters);
/* cffi: end */

#endif
