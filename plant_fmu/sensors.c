/* Encoders, gyro and accelerometer. The noise of a sample follows from the seed and the sample's number
 * alone: it needs no state, and a restored plant hears the same noise. */
#include "sensors.h"

#include <math.h>
#include <string.h>

static const double TWO_PI = 6.283185307179586476925286766559;
static const double KNOTS_A_SECOND = 16.0;
enum { WALK = 6, BRIDGE = 9 }; /* channels of noise, after the six of the samples */
static const double LARGEST = 9007199254740992.0;

/* Rounds down into a counter of 32 bits. */
static int32_t counter(double value) {
    const double bounded = fmin(fmax(floor(value), -LARGEST), LARGEST);
    const uint32_t wrapped = (uint32_t)(uint64_t)(int64_t)bounded;
    int32_t result;
    memcpy(&result, &wrapped, sizeof result);
    return result;
}

void plant_encoders(const mecanum_parameters *p, const double angle_rad[MECANUM_WHEELS],
                    mecanum_outputs *out) {
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double turns = angle_rad[i] / TWO_PI;
        const double error_rad = p->wheel_encoder_error_rad[i];
        const double counted = error_rad > 0.0 ? turns + error_rad * sin(angle_rad[i]) / TWO_PI : turns;
        out->wheel_count[i] = counter(counted * (p->counts_per_revolution * p->wheel_counts_factor[i]));
        out->wheel_index[i] = counter(turns);
    }
}

/* The finalizer of SplitMix64 (Steele, Lea and Flood, OOPSLA 2014): neighbouring numbers become unrelated
 * ones. */
static uint64_t mix(uint64_t x) {
    x = (x ^ (x >> 30)) * UINT64_C(0xbf58476d1ce4e5b9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94d049bb133111eb);
    return x ^ (x >> 31);
}

/* A number of (0, 1] from 53 bits. */
static double uniform(uint64_t bits) {
    return ((double)(bits >> 11) + 1.0) / 9007199254740992.0;
}

/* A standard normal number for this seed, sample and channel (Box and Muller 1958). */
static double noise(int32_t seed, uint64_t sample, uint64_t channel) {
    const uint64_t golden = UINT64_C(0x9e3779b97f4a7c15);
    const uint64_t stream = mix(((uint64_t)(uint32_t)seed << 8 | channel) * golden + golden);
    const uint64_t place = mix(stream + sample * golden);
    return sqrt(-2.0 * log(uniform(mix(place + golden)))) * cos(TWO_PI * uniform(mix(place + 2 * golden)));
}

static uint64_t sample_at(const mecanum_parameters *p, double time_s) {
    /* A little more, so that an instant which is a sample's own does not fall to the one before by rounding.
     */
    return (uint64_t)(int64_t)floor(fmin(fmax(time_s, -1e9), 1e9) * p->imu_rate_hz + 1e-6);
}

/* Brownian motion of variance 1 at 1 s, from 0 at time 0, for this seed and axis: a straight line between
 * knots of 1/16 s. It needs no state either: the time is doubled until it has passed, and halved by bridges
 * (Lévy 1948). */
static double wandered(int32_t seed, uint64_t axis, double time_s) {
    const double knots = fmin(fmax(time_s, 0.0), 1e9) * KNOTS_A_SECOND;
    double early = 0.0, late = 1.0, at_early = 0.0, at_late = noise(seed, 0, WALK + axis);
    for (uint64_t doubling = 1; late < knots; doubling++) {
        early = late;
        late *= 2.0;
        at_early = at_late;
        at_late += sqrt(early) * noise(seed, doubling, WALK + axis);
    }
    while (late - early > 1.0) {
        const double middle = 0.5 * (early + late);
        const double bend = 0.5 * sqrt(late - early) * noise(seed, (uint64_t)middle, BRIDGE + axis);
        const double at_middle = 0.5 * (at_early + at_late) + bend;
        *(middle < knots ? &early : &late) = middle;
        *(middle < knots ? &at_early : &at_late) = at_middle;
    }
    return (at_early + (at_late - at_early) * (knots - early) / (late - early)) / sqrt(KNOTS_A_SECOND);
}

/* Writes a vector of the body as sensors see it that were turned by roll, pitch and yaw, in this order. */
static void see(const mecanum_parameters *p, const double of_body[3], double seen[3]) {
    const double angle_rad[3] = {p->imu_roll_rad, p->imu_pitch_rad, p->imu_yaw_rad};
    memcpy(seen, of_body, 3 * sizeof *seen);
    for (int axis = 2; axis >= 0; axis--) {
        if (angle_rad[axis] != 0.0) {
            double *const a = &seen[(axis + 1) % 3], *const b = &seen[(axis + 2) % 3];
            const double c = cos(angle_rad[axis]), s = sin(angle_rad[axis]), before = *a;
            *a = c * before + s * *b;
            *b = c * *b - s * before;
        }
    }
}

void plant_inertial(const mecanum_parameters *p, double time_s, const double rate_rad_s[3],
                    const double acceleration_m_s2[3], mecanum_outputs *out) {
    double *const measured[6] = {&out->gyro_x_rad_s,         &out->gyro_y_rad_s,
                                 &out->gyro_z_rad_s,         &out->accelerometer_x_m_s2,
                                 &out->accelerometer_y_m_s2, &out->accelerometer_z_m_s2};
    const double bias[6] = {p->gyro_bias_x_rad_s,         p->gyro_bias_y_rad_s,
                            p->gyro_bias_z_rad_s,         p->accelerometer_bias_x_m_s2,
                            p->accelerometer_bias_y_m_s2, p->accelerometer_bias_z_m_s2};
    const uint64_t sample = sample_at(p, time_s);
    double seen[6];
    see(p, rate_rad_s, seen);
    see(p, acceleration_m_s2, seen + 3);
    for (int i = 0; i < 6; i++) {
        const bool is_gyro = i < 3;
        double read = (is_gyro ? p->gyro_scale : 1.0) * seen[i] + bias[i];
        if (is_gyro && p->gyro_drift_rad_s2 != 0.0) {
            read += p->gyro_drift_rad_s2 * time_s;
        }
        if (is_gyro && p->gyro_walk_rad_s > 0.0) {
            read += p->gyro_walk_rad_s * wandered(p->seed, (uint64_t)i, time_s);
        }
        const double deviation = is_gyro ? p->gyro_noise_rad_s : p->accelerometer_noise_m_s2;
        const double heard = deviation > 0.0 ? deviation * noise(p->seed, sample, (uint64_t)i) : 0.0;
        *measured[i] = read + heard;
    }
}
