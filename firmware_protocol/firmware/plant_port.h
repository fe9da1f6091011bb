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
    uint32_t enabled;    /* 0: the drives are off, and the wheels coast */
    float torque_n_m[4]; /* torque set points at the wheel axles, for drives that control the current
                            themselves */
    float duty[4];       /* part of the battery's voltage on each motor, -1 to 1, for those that do not */
} wheel_drive;

typedef struct {
    uint32_t tick;              /* the tick at whose beginning the values were sampled */
    uint16_t count[4];          /* encoder counts, wrapping */
    float current_a[4];         /* motor currents */
    float gyro_rad_s[3];        /* body frame: x forward, y left, z up */
    float acceleration_m_s2[3]; /* body frame, without gravity's: at rest z is 9.81 */
    float battery_v;
    float battery_a;           /* out of the battery */
    float temperature_degc[4]; /* of the motors' windings */
} wheel_sense;

/* Holds the drive for one tick and samples what follows; a NULL drive samples without letting time pass.
 * Returns 0, or another number when the plant failed. */
typedef int (*wheel_plant_exchange)(void *context, const wheel_drive *drive, wheel_sense *sense);
/* cffi: end */

#endif
