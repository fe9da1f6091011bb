/* The plant port: what the firmware gives to the wheel drives and senses of the robot, once a 1 kHz tick.
 *
 * Wheels are FL, FR, RR, RL. In a hardware-in-the-loop build these structures cross a serial line; in the
 * host build a function call. In a build for real motors the drivers fill and consume them.
 */
#ifndef WHEEL_PLANT_PORT_H
#define WHEEL_PLANT_PORT_H

#include <stdint.h>

/* cffi: begin */
typedef struct {
    uint32_t tick;       /* the 1 kHz tick during which the drives hold these set points */
    float torque_n_m[4]; /* torque set points at the wheel axles */
} wheel_drive;

typedef struct {
    uint32_t tick;       /* the tick at whose beginning the values were sampled */
    uint16_t count[4];   /* encoder counts, wrapping */
    float current_a[4];  /* motor currents */
    float gyro_rad_s[3]; /* body frame: x forward, y left, z up */
} wheel_sense;

/* Holds the drive for one tick and samples what follows; a NULL drive samples without letting time pass.
 * Returns 0, or another number when the plant failed. */
typedef int (*wheel_plant_exchange)(void *context, const wheel_drive *drive, wheel_sense *sense);
/* cffi: end */

#endif
