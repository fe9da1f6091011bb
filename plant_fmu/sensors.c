/* Encoders, gyro and accelerometer. The noise of a sample follows from the seed and the sample's number
 * alone: it needs no state, and a restored plant hears the same noise. */
#include "counter.h"
#include "model.h"

static const double TWO_PI = 6.283185307179586476925286766559;

enum { GYRO_X, GYRO_Y, GYRO_Z, ACCELEROMETER_X, ACCELEROMETER_Y, ACCELEROMETER_Z };

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

void mecanum_sense(const mecanum_model *model, const mecanum_state *state, const mecanum_state *derivative,
                   double time_s, mecanum_outputs *out) {
    const mecanum_parameters *const p = model->p;
    const double *const x = state->x;
    for (int i = 0; i < MECANUM_WHEELS; i++) {
        const double turns = x[MECANUM_WHEEL_ANGLE_RAD + i] / TWO_PI;
        out->wheel_count[i] = plant_counter(turns * p->counts_per_revolution);
        out->wheel_index[i] = plant_counter(turns);
    }
    double *const measured[6] = {&out->gyro_x_rad_s,         &out->gyro_y_rad_s,
                                 &out->gyro_z_rad_s,         &out->accelerometer_x_m_s2,
                                 &out->accelerometer_y_m_s2, &out->accelerometer_z_m_s2};
    const double bias[6] = {p->gyro_bias_x_rad_s,         p->gyro_bias_y_rad_s,
                            p->gyro_bias_z_rad_s,         p->accelerometer_bias_x_m_s2,
                            p->accelerometer_bias_y_m_s2, p->accelerometer_bias_z_m_s2};
    const double yaw_rate = x[MECANUM_YAW_RATE_RAD_S];
    const double uphill = p->slope_direction_rad - x[MECANUM_HEADING_RAD];
    const double fall_m_s2 = model->gravity_in_plane_n / p->mass_kg;
    const double *const rate = derivative->x;
    const double truth[6] = {
        [GYRO_Z] = yaw_rate,
        /* The acceleration of a point of the turning frame, less that of gravity. */
        [ACCELEROMETER_X] =
            rate[MECANUM_FORWARD_M_S] - yaw_rate * x[MECANUM_LEFT_M_S] + fall_m_s2 * cos(uphill),
        [ACCELEROMETER_Y] =
            rate[MECANUM_LEFT_M_S] + yaw_rate * x[MECANUM_FORWARD_M_S] + fall_m_s2 * sin(uphill),
        [ACCELEROMETER_Z] = model->gravity_upright_n / p->mass_kg,
    };
    const uint64_t sample = sample_at(p, time_s);
    for (int i = 0; i < 6; i++) {
        const double deviation = i < ACCELEROMETER_X ? p->gyro_noise_rad_s : p->accelerometer_noise_m_s2;
        const double heard = deviation > 0.0 ? deviation * noise(p->seed, sample, (uint64_t)i) : 0.0;
        *measured[i] = truth[i] + bias[i] + heard;
    }
}
