/* What ends driving without a command to do so: sensors, speed, current, heat, voltage, encoders, silence. */
#include "node.h"

/* No sensor of a robot measures so much, in any of its units; what is computed from less stays finite. */
#define PLAUSIBLE 1e6f
/* Nor is a winding so cold: its sensor has lost its wire, and would not tell any heat. */
#define COLDEST_DEGC (-45.0f)
/* Below this a wheel counts as standing still; about one encoder count in ten ticks. */
#define STANDSTILL_RAD_S 0.2f
/* For so long, so that the estimate's passing through zero does not count. */
#define STANDSTILL_TICKS 50u

/* A measured current beyond the limit by this factor, for so long, is none that the current loop asked for.
 */
#define OVERCURRENT_FACTOR 1.5f
#define OVERCURRENT_TICKS 5u
#define UNDERVOLTAGE_TICKS 20u
/* All four wheels drive with less and less over so many degrees before the limit. */
#define DERATING_DEGC 15.0f

/* The part of the overspeed limit that a set point may reach. */
#define SPEED_LIMIT_PART 0.8f
#define STEPS_A_RAD_S 64.0f /* of WHEEL_COMMAND */

/* A wheel is expected to turn when its set point, its torque and the three others all say so. */
#define EXPECTED_RAD_S 2.0f
/* A wheel runs away when it gains so much while it is driven the other way. */
#define RUNAWAY_RAD_S 3.0f
/* One that lost so much, and what its estimate moves by itself, brakes. */
#define BRAKED_RAD_S 0.1f
/* An encoder that changes its speed by so much is not stuck, but passes through zero. */
#define PASSING_RAD_S 0.1f
/* An encoder counts backward when its speed and that of the others differ by no more than this but for the
 * sign. */
#define MIRRORED_PART 0.3f
/* The others contradict a wheel when their speed differs from its own by more than this part. */
#define CONTRADICTED_PART 0.3f
/* A torque of more than this part of the limit moves a wheel. */
#define MOVING_TORQUE 0.2f

static bool is_plausible(float x) {
    return x >= -PLAUSIBLE && x <= PLAUSIBLE; /* false for NaN too */
}

bool wheel_sense_is_plausible(const wheel_sense *sense) {
    bool plausible = is_plausible(sense->battery_v) && is_plausible(sense->battery_a);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        plausible = plausible && is_plausible(sense->current_a[i]) &&
                    is_plausible(sense->temperature_degc[i]) && sense->temperature_degc[i] >= COLDEST_DEGC;
    }
    for (size_t i = 0; i < 3u; i++) {
        plausible =
            plausible && is_plausible(sense->gyro_rad_s[i]) && is_plausible(sense->acceleration_m_s2[i]);
    }
    return plausible;
}

static float largest_speed(const wheel_node *node) {
    float largest = 0.0f;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float speed = wheel_magnitude(node->speed_rad_s[i]);
        largest = speed > largest ? speed : largest;
    }
    return largest;
}

bool wheel_node_at_rest(const wheel_node *node) {
    return node->rest_ticks >= STANDSTILL_TICKS;
}

static bool is_driving(const wheel_node *node) {
    return node->state == WP_STATE_ACTIVE || node->state == WP_STATE_STOPPING || node->braking;
}

static uint8_t hottest_wheel(const wheel_node *node) {
    uint8_t hottest = 0;
    for (uint8_t i = 1; i < WHEEL_COUNT; i++) {
        if (node->sense.temperature_degc[i] > node->sense.temperature_degc[hottest]) {
            hottest = i;
        }
    }
    return hottest;
}

/* What the windings' heat leaves of the current limit, 0 to 1. Beyond the temperature limit the drives are
 * off; less than 0 would turn every torque round, so it is not left to that. */
static float derating(const wheel_node *node) {
    const float left =
        node->parameters.temperature_limit_degc - node->sense.temperature_degc[hottest_wheel(node)];
    return left >= DERATING_DEGC ? 1.0f : (left > 0.0f ? left / DERATING_DEGC : 0.0f);
}

float wheel_node_torque_limit(const wheel_node *node) {
    const wheel_parameters *p = &node->parameters;
    const float by_current = p->torque_constant_n_m_a * p->current_limit_a * derating(node);
    return by_current < p->torque_limit_n_m ? by_current : p->torque_limit_n_m;
}

float wheel_node_speed_limit(const wheel_node *node) {
    const uint32_t steps = (uint32_t)(SPEED_LIMIT_PART * node->parameters.overspeed_rad_s * STEPS_A_RAD_S);
    return (float)steps / STEPS_A_RAD_S;
}

static void check_speed(wheel_node *node) {
    for (uint8_t i = 0; i < WHEEL_COUNT; i++) {
        if (wheel_magnitude(node->speed_rad_s[i]) > node->parameters.overspeed_rad_s) {
            wheel_node_fault(node, WP_FAULT_OVERSPEED, (uint8_t)(i + 1u));
        }
    }
}

static void check_power(wheel_node *node) {
    const wheel_parameters *p = &node->parameters;
    uint8_t wheel = WP_FAULT_WHEEL_NONE;
    for (uint8_t i = 0; i < WHEEL_COUNT; i++) {
        if (wheel_magnitude(node->sense.current_a[i]) > OVERCURRENT_FACTOR * p->current_limit_a) {
            wheel = (uint8_t)(i + 1u);
        }
    }
    node->overcurrent_ticks = wheel != WP_FAULT_WHEEL_NONE ? node->overcurrent_ticks + 1u : 0u;
    if (node->overcurrent_ticks >= OVERCURRENT_TICKS) {
        wheel_node_fault(node, WP_FAULT_OVERCURRENT, wheel);
    }
    const uint8_t hottest = hottest_wheel(node);
    if (node->sense.temperature_degc[hottest] >= p->temperature_limit_degc) {
        wheel_node_fault(node, WP_FAULT_OVERTEMPERATURE, (uint8_t)(hottest + 1u));
    }
    node->undervoltage_ticks = node->sense.battery_v < p->undervoltage_v ? node->undervoltage_ticks + 1u : 0u;
    if (node->undervoltage_ticks >= UNDERVOLTAGE_TICKS && is_driving(node)) {
        wheel_node_fault(node, WP_FAULT_UNDERVOLTAGE, WP_FAULT_WHEEL_NONE);
    }
}

/* What the three other wheels say of this one's speed: on rollers that do not slip, FL + FR = RR + RL. */
static float speed_by_others(const wheel_node *node, size_t wheel) {
    const float *speed = node->speed_rad_s;
    switch (wheel) {
    case 0:
        return speed[2] + speed[3] - speed[1];
    case 1:
        return speed[2] + speed[3] - speed[0];
    case 2:
        return speed[0] + speed[1] - speed[3];
    default:
        return speed[0] + speed[1] - speed[2];
    }
}

static bool is_strong(const wheel_node *node, float torque_n_m) {
    return wheel_magnitude(torque_n_m) > MOVING_TORQUE * wheel_node_torque_limit(node);
}

/* An encoder that stands still while its wheel must turn: set point and torque ask for it, and the other
 * wheels say that it does, the way the torque drives it. One whose signal is gone is driven ever harder, so
 * this is a matter of a tenth of a second. */
static void check_still(wheel_node *node, uint8_t wheel, uint32_t limit_ticks) {
    wheel_encoder_watch *watch = &node->encoder[wheel];
    const float torque = node->torque_n_m[wheel];
    const float by_others = speed_by_others(node, wheel);
    const bool asked =
        node->mode == WP_MODE_TORQUE || wheel_magnitude(node->set_point_rad_s[wheel]) > EXPECTED_RAD_S;
    const float speed = node->speed_rad_s[wheel];
    const bool still = wheel_magnitude(speed) < STANDSTILL_RAD_S;
    if (watch->still_ticks == 0u || wheel_magnitude(speed - watch->still_from_rad_s) > PASSING_RAD_S) {
        watch->still_ticks = 0u;
        watch->still_from_rad_s = speed;
    }
    const bool turns = wheel_magnitude(by_others) > EXPECTED_RAD_S && by_others * torque > 0.0f;
    watch->still_ticks = asked && still && turns && is_strong(node, torque) ? watch->still_ticks + 1u : 0u;
    if (watch->still_ticks >= limit_ticks) {
        wheel_node_fault(node, WP_FAULT_ENCODER_STUCK, (uint8_t)(wheel + 1u));
    }
}

/* How far the estimate moves while a wheel turns evenly: the counts come one by one, and the filter follows.
 */
static float estimate_noise_rad_s(const wheel_node *node) {
    const wheel_parameters *p = &node->parameters;
    return 3.14159265f * p->tracking_bandwidth_rad_s / p->counts_per_revolution;
}

/* A wheel that its speed loop drives against the way it says that it turns. Without a speed loop, in torque
 * mode, the others may drag it. */
static bool is_driven_against(const wheel_node *node, uint8_t wheel) {
    const bool by_speed_loop = node->mode == WP_MODE_SPEED || node->state != WP_STATE_ACTIVE;
    const float torque = node->torque_n_m[wheel];
    return by_speed_loop && node->speed_rad_s[wheel] * torque < 0.0f && is_strong(node, torque);
}

/* The other wheels say the same speed with the other sign. */
static bool is_mirrored(const wheel_node *node, uint8_t wheel) {
    const float others = speed_by_others(node, wheel);
    const float size = wheel_magnitude(others);
    return size > EXPECTED_RAD_S && wheel_magnitude(node->speed_rad_s[wheel] + others) < MIRRORED_PART * size;
}

/* A wheel that gains speed against its torque is driven away from its set point, or is one that has to stop
 * and does not, while the others say nothing of it. A robot that a slope drives on gains with all four. */
static bool runs_away(const wheel_node *node, uint8_t wheel) {
    const float speed = node->speed_rad_s[wheel];
    const float target = node->set_point_rad_s[wheel];
    const bool has_target = wheel_magnitude(target) > EXPECTED_RAD_S && speed * target < 0.0f;
    const bool alone =
        wheel_magnitude(speed - speed_by_others(node, wheel)) > CONTRADICTED_PART * wheel_magnitude(speed);
    return wheel_magnitude(speed) > node->encoder[wheel].slowest_rad_s + RUNAWAY_RAD_S &&
           (has_target || alone);
}

/* An encoder that counts backward: the others contradict it, or its wheel runs away, as the loop drives it
 * ever faster. A wheel that brakes or turns round looks alike, but loses speed. */
static void check_direction(wheel_node *node, uint8_t wheel, uint32_t limit_ticks) {
    wheel_encoder_watch *watch = &node->encoder[wheel];
    const float speed = wheel_magnitude(node->speed_rad_s[wheel]);
    const bool against = is_driven_against(node, wheel);
    if (!against || speed < watch->slowest_rad_s) {
        watch->slowest_rad_s = speed;
    }
    const bool away = runs_away(node, wheel);
    if (!away && speed < watch->fastest_rad_s - BRAKED_RAD_S - estimate_noise_rad_s(node)) {
        watch->backward_ticks = 0u;
    }
    if (watch->backward_ticks == 0u || speed > watch->fastest_rad_s) {
        watch->fastest_rad_s = speed;
    }
    watch->backward_ticks = against && (away || is_mirrored(node, wheel)) ? watch->backward_ticks + 1u : 0u;
    if (watch->backward_ticks >= limit_ticks) {
        wheel_node_fault(node, WP_FAULT_WRONG_DIRECTION, (uint8_t)(wheel + 1u));
    }
}

static void check_encoders(wheel_node *node) {
    const uint32_t limit_ticks = wheel_ticks(node->parameters.encoder_fault_s);
    for (uint8_t i = 0; i < WHEEL_COUNT; i++) {
        check_still(node, i, limit_ticks);
        check_direction(node, i, limit_ticks);
    }
}

static void check_silence(wheel_node *node) {
    if (node->state == WP_STATE_ACTIVE &&
        node->setting.age_ticks >= wheel_ticks(node->parameters.watchdog_s)) {
        wheel_node_stop(node, WHEEL_EVENT_TIMEOUT, WP_STOP_REASON_COMMAND_TIMEOUT);
    }
    if (node->state == WP_STATE_ARMED && node->state_ticks >= WHEEL_ARM_TIMEOUT_TICKS) {
        wheel_node_stop(node, WHEEL_EVENT_TIMEOUT, WP_STOP_REASON_ARM_TIMEOUT);
    }
}

void wheel_node_supervise(wheel_node *node) {
    node->rest_ticks = largest_speed(node) < STANDSTILL_RAD_S ? node->rest_ticks + 1u : 0u;
    if (!wheel_sense_is_plausible(&node->sense)) {
        wheel_node_fault(node, WP_FAULT_SENSOR, WP_FAULT_WHEEL_NONE);
    }
    check_speed(node);
    check_power(node);
    if (is_driving(node)) {
        check_encoders(node);
    }
    check_silence(node);
    if (node->state == WP_STATE_STOPPING) {
        const uint32_t ramp = wheel_ticks(node->parameters.ramp_s);
        if (node->state_ticks >= ramp &&
            (wheel_node_at_rest(node) || node->state_ticks >= ramp + WHEEL_STOP_LIMIT_TICKS)) {
            wheel_node_event(node, WHEEL_EVENT_STOPPED);
        }
    }
}
