/* Encoders, gyro and accelerometer of any physics: what they read of what is true. */
#ifndef PLANT_SENSORS_H
#define PLANT_SENSORS_H

#include <stdbool.h>

#include "hidden.h"
#include "mecanum_variables.h"

HIDDEN_BEGIN

/* Writes counts and index pulses of the wheels at these angles. A counter wraps with 32 bits. Past 2^53 a
 * double no longer tells one count from the next, and the counter stands still. */
void plant_encoders(const mecanum_parameters *p, const double angle_rad[MECANUM_WHEELS],
                    mecanum_outputs *out);

/* Writes what the inertial sensors read: the true rates of the body and its acceleration without gravity's,
 * each about or along the body's x, y and z. */
void plant_inertial(const mecanum_parameters *p, double time_s, const double rate_rad_s[3],
                    const double acceleration_m_s2[3], mecanum_outputs *out);

HIDDEN_END

#endif
