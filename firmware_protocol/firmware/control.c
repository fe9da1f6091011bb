#include "control.h"

#include <stddef.h>

#define TWO_PI 6.28318530717958647692f
/* Twice what an overspeed limit may be. Counts that make no sense would drive the filter on without end. */
#define FASTEST_RAD_S 256.0f

static float magnitude(float x) {
    return x < 0.0f ? -x : x;
}

static float clamp(float x, float limit) {
    return x > limit ? limit : (x < -limit ? -limit : x);
}

/* Floor without libm, for the few hundred counts that a wheel turns in a tick. */
static int32_t whole_part(float x) {
    const int32_t n = (int32_t)x;
    return (float)n > x ? n - 1 : n;
}

static void tracker_advance(wheel_tracker *tracker, float counts) {
    const float position = tracker->fraction + counts;
    const int32_t whole = whole_part(position);
    tracker->whole = (uint16_t)(tracker->whole + (uint32_t)whole);
    tracker->fraction = position - (float)whole;
}

float wheel_tracker_update(wheel_tracker *tracker, uint16_t count, const wheel_parameters *parameters) {
    if (!tracker->running) {
        tracker->whole = count;
        tracker->fraction = 0.5f;
        tracker->rate_counts_s = 0.0f;
        tracker->running = true;
    }
    tracker_advance(tracker, tracker->rate_counts_s * WHEEL_TICK_S);
    /* The true position lies within the count, on average half way. */
    const int16_t behind = (int16_t)(uint16_t)(count - tracker->whole);
    const float error = (float)behind + 0.5f - tracker->fraction;
    const float bandwidth = parameters->tracking_bandwidth_rad_s;
    tracker_advance(tracker, 2.0f * bandwidth * WHEEL_TICK_S * error);
    const float rate = tracker->rate_counts_s + bandwidth * bandwidth * WHEEL_TICK_S * error;
    const float rad_a_count = TWO_PI / parameters->counts_per_revolution;
    tracker->rate_counts_s = clamp(rate, FASTEST_RAD_S / rad_a_count);
    return tracker->rate_counts_s * rad_a_count;
}

bool wheel_scale_to_limit(float value[WHEEL_COUNT], float limit) {
    float largest = 0.0f;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        largest = magnitude(value[i]) > largest ? magnitude(value[i]) : largest;
    }
    if (largest <= limit) {
        return false;
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        /* First the ratio, which is at most 1: the product then cannot round beyond the limit. */
        value[i] = limit * (value[i] / largest);
    }
    return true;
}

bool wheel_speed_loop_update(wheel_speed_loop *loop, const float target_rad_s[WHEEL_COUNT],
                             const float speed_rad_s[WHEEL_COUNT], const float feedforward_n_m[WHEEL_COUNT],
                             const wheel_parameters *parameters, float limit_n_m,
                             float torque_n_m[WHEEL_COUNT]) {
    float step_n_m[WHEEL_COUNT];
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float error = target_rad_s[i] - speed_rad_s[i];
        step_n_m[i] = parameters->speed_ki_n_m_rad * error * WHEEL_TICK_S;
        torque_n_m[i] = parameters->speed_kp_n_m_s_rad * error + loop->integral_n_m[i] + feedforward_n_m[i];
    }
    const bool limited = wheel_scale_to_limit(torque_n_m, limit_n_m);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const bool winds_up = limited && step_n_m[i] * loop->integral_n_m[i] > 0.0f;
        if (!winds_up) {
            loop->integral_n_m[i] += step_n_m[i];
        }
    }
    (void)wheel_scale_to_limit(loop->integral_n_m, limit_n_m);
    return limited;
}

float wheel_exp_minus(float x) {
    /* A Pade approximant is good for small x; the rest is squaring. Beyond 20 it is zero for all that
     * matters. */
    if (x >= 20.0f) {
        return 0.0f;
    }
    const float small = x * (1.0f / 32.0f);
    const float square = small * small * (1.0f / 12.0f);
    float result = (1.0f - 0.5f * small + square) / (1.0f + 0.5f * small + square);
    for (unsigned i = 0; i < 5u; i++) {
        result *= result;
    }
    return result;
}

/* 1 - exp(-x), also for an x so small that the difference would be nothing but rounding. */
static float rise(float x) {
    return x < 0.01f ? x * (1.0f - 0.5f * x) : 1.0f - wheel_exp_minus(x);
}

void wheel_current_loop_update(wheel_current_loop *loop, const float target_a[WHEEL_COUNT],
                               const float current_a[WHEEL_COUNT], const float speed_rad_s[WHEEL_COUNT],
                               float battery_v, const wheel_parameters *parameters, float duty[WHEEL_COUNT]) {
    /* Within a tick the current goes a part of the way to where the voltage pulls it, and the loop wants it
     * to go another part of the way to the target. */
    const float part = rise(parameters->motor_resistance_ohm * WHEEL_TICK_S / parameters->motor_inductance_h);
    const float wanted = rise(parameters->current_bandwidth_rad_s * WHEEL_TICK_S);
    const float gain = parameters->motor_resistance_ohm * wanted / part;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float back_emf_v = parameters->torque_constant_n_m_a * speed_rad_s[i];
        if (!(battery_v > 0.0f)) {
            loop->integral_v[i] = 0.0f;
            duty[i] = 0.0f;
            continue;
        }
        const float voltage = gain * (target_a[i] - current_a[i]) + loop->integral_v[i] + back_emf_v;
        const float wish = voltage / battery_v;
        duty[i] = clamp(wish, 1.0f);
        /* This is `resistance * wanted * error`, with the error that the applied voltage answers: at full
         * duty that is less than the real one, and nothing winds up. */
        loop->integral_v[i] += part * (duty[i] * battery_v - back_emf_v - loop->integral_v[i]);
    }
}
