#include "node.h"

#include <string.h>

/* Below this a wheel counts as standing still; about one encoder count in ten ticks. */
#define STANDSTILL_RAD_S 0.2f
/* For so long, so that the estimate's passing through zero does not count. */
#define STANDSTILL_TICKS 50u

uint32_t wheel_ticks(float seconds) {
    return (uint32_t)(seconds * 1000.0f + 0.5f);
}

void wheel_node_init(wheel_node *node, const wheel_parameters *parameters, const wheel_identity *identity) {
    memset(node, 0, sizeof *node);
    node->parameters = *parameters;
    node->identity = *identity;
    node->state = WP_STATE_BOOT;
    node->setting.age_ticks = UINT32_MAX;
    if (wheel_parameters_invalid(parameters) >= 0) {
        node->fault = WP_FAULT_PARAMETERS;
        wheel_node_event(node, WHEEL_EVENT_FAULT);
    } else {
        wheel_node_event(node, WHEEL_EVENT_READY);
    }
}

static void begin_session(wheel_node *node) {
    memset(&node->setting, 0, sizeof node->setting);
    node->setting.age_ticks = UINT32_MAX; /* no command yet */
    memset(&node->speed_loop, 0, sizeof node->speed_loop);
    node->staged.present = false;
    node->stop_reason = WP_STOP_REASON_NONE;
}

static float magnitude(float x) {
    return x < 0.0f ? -x : x;
}

/* A stop begins at the set point or at the speed that the wheel really has, whichever is nearer to zero, and
 * with an empty integral: what was wound up against an obstacle must not drive the robot once that gives way.
 */
static void begin_stop(wheel_node *node) {
    node->staged.present = false;
    memset(&node->speed_loop, 0, sizeof node->speed_loop);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float target = node->set_point_rad_s[i];
        const float speed = node->speed_rad_s[i];
        const bool nearer = magnitude(speed) < magnitude(target);
        node->ramp_from_rad_s[i] = target * speed <= 0.0f ? 0.0f : (nearer ? speed : target);
    }
}

void wheel_node_event(wheel_node *node, wheel_event event) {
    const uint8_t next = wheel_next_state(node->state, event);
    if (next == node->state) {
        return;
    }
    /* Drives that were off stay off. */
    node->braking =
        next == WP_STATE_ESTOP && (node->state == WP_STATE_ACTIVE || node->state == WP_STATE_STOPPING);
    node->state = next;
    node->state_ticks = 0;
    node->announced_nonce = 0u;
    switch (next) {
    case WP_STATE_ARMED:
        begin_session(node);
        break;
    case WP_STATE_STOPPING:
    case WP_STATE_ESTOP:
        begin_stop(node);
        break;
    case WP_STATE_IDLE:
        node->fault = WP_FAULT_NONE;
        break;
    default:
        break;
    }
    wheel_node_send_status(node);
}

/* An event that ends driving; the reason is kept only where the event does something. */
void wheel_node_stop(wheel_node *node, wheel_event event, uint8_t reason) {
    if (wheel_next_state(node->state, event) != node->state) {
        node->stop_reason = reason;
    }
    wheel_node_event(node, event);
}

static void fault(wheel_node *node, uint8_t cause) {
    if (node->fault == WP_FAULT_NONE) {
        node->fault = cause;
    }
    node->braking = false;
    wheel_node_stop(node, WHEEL_EVENT_FAULT, WP_STOP_REASON_FAULT);
}

void wheel_node_fail(wheel_node *node) {
    fault(node, WP_FAULT_SENSOR);
}

static bool is_finite(float x) {
    return x - x == 0.0f;
}

bool wheel_sense_is_finite(const wheel_sense *sense) {
    bool finite = true;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        finite = finite && is_finite(sense->current_a[i]);
    }
    for (size_t i = 0; i < 3u; i++) {
        finite = finite && is_finite(sense->gyro_rad_s[i]);
    }
    return finite;
}

static float largest_speed(const wheel_node *node) {
    float largest = 0.0f;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float speed = magnitude(node->speed_rad_s[i]);
        largest = speed > largest ? speed : largest;
    }
    return largest;
}

static bool at_rest(const wheel_node *node) {
    return node->rest_ticks >= STANDSTILL_TICKS;
}

static void supervise(wheel_node *node) {
    if (largest_speed(node) > node->parameters.overspeed_rad_s) {
        fault(node, WP_FAULT_OVERSPEED);
    }
    if (node->state == WP_STATE_ACTIVE &&
        node->setting.age_ticks >= wheel_ticks(node->parameters.watchdog_s)) {
        wheel_node_stop(node, WHEEL_EVENT_TIMEOUT, WP_STOP_REASON_COMMAND_TIMEOUT);
    }
    if (node->state == WP_STATE_ARMED && node->state_ticks >= WHEEL_ARM_TIMEOUT_TICKS) {
        wheel_node_stop(node, WHEEL_EVENT_TIMEOUT, WP_STOP_REASON_ARM_TIMEOUT);
    }
    if (node->state == WP_STATE_STOPPING) {
        const uint32_t ramp = wheel_ticks(node->parameters.ramp_s);
        if (node->state_ticks >= ramp &&
            (at_rest(node) || node->state_ticks >= ramp + WHEEL_STOP_LIMIT_TICKS)) {
            wheel_node_event(node, WHEEL_EVENT_STOPPED);
        }
    }
}

void wheel_node_sense(wheel_node *node, const wheel_sense *sense) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        node->speed_rad_s[i] = wheel_tracker_update(&node->tracker[i], sense->count[i], &node->parameters);
    }
    node->rest_ticks = largest_speed(node) < STANDSTILL_RAD_S ? node->rest_ticks + 1u : 0u;
    if (!wheel_sense_is_finite(sense)) {
        fault(node, WP_FAULT_SENSOR);
    }
    supervise(node);
    wheel_node_send_feedback(node, sense);
}

/* The set point ramps to zero from where it was, whatever the wheels do. */
static void ramp_set_point(wheel_node *node) {
    const uint32_t ramp = wheel_ticks(node->parameters.ramp_s);
    float left = 0.0f;
    if (node->state_ticks + 1u < ramp) {
        left = (float)(ramp - node->state_ticks - 1u) / (float)ramp;
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        node->set_point_rad_s[i] = node->ramp_from_rad_s[i] * left;
    }
}

static bool drive_by_speed(wheel_node *node, const float feedforward_n_m[WHEEL_COUNT], wheel_drive *drive) {
    return wheel_speed_loop_update(&node->speed_loop, node->set_point_rad_s, node->speed_rad_s,
                                   feedforward_n_m, &node->parameters, drive->torque_n_m);
}

static bool drive_active(wheel_node *node, wheel_drive *drive) {
    if (node->mode == WP_MODE_SPEED) {
        memcpy(node->set_point_rad_s, node->setting.target, sizeof node->set_point_rad_s);
        return drive_by_speed(node, node->setting.feedforward_n_m, drive);
    }
    /* A stop that follows begins at the speed that the wheels have. */
    memcpy(node->set_point_rad_s, node->speed_rad_s, sizeof node->set_point_rad_s);
    memcpy(drive->torque_n_m, node->setting.target, sizeof drive->torque_n_m);
    return wheel_scale_to_limit(drive->torque_n_m, node->parameters.torque_limit_n_m);
}

void wheel_node_drive(wheel_node *node, wheel_drive *drive) {
    static const float none[WHEEL_COUNT] = {0.0f, 0.0f, 0.0f, 0.0f};
    bool limited = false;
    drive->tick = node->tick;
    memset(drive->torque_n_m, 0, sizeof drive->torque_n_m);
    switch (node->state) {
    case WP_STATE_ACTIVE:
        limited = drive_active(node, drive);
        break;
    case WP_STATE_STOPPING:
        ramp_set_point(node);
        limited = drive_by_speed(node, none, drive);
        break;
    case WP_STATE_ESTOP:
        memset(node->set_point_rad_s, 0, sizeof node->set_point_rad_s);
        node->braking = node->braking && node->state_ticks < WHEEL_STOP_LIMIT_TICKS && !at_rest(node);
        if (node->braking) {
            limited = drive_by_speed(node, none, drive);
        }
        break;
    default:
        memset(node->set_point_rad_s, 0, sizeof node->set_point_rad_s);
        break;
    }
    node->limited_ticks += limited ? 1u : 0u;
    node->setting.age_ticks += node->setting.age_ticks < UINT32_MAX ? 1u : 0u;
    node->state_ticks += node->state_ticks < UINT32_MAX ? 1u : 0u;
    node->tick++;
}

void wheel_node_queue(wheel_node *node, uint16_t id, uint8_t length, const uint8_t *payload) {
    if (node->queue_count == WHEEL_TRANSMIT_QUEUE) {
        node->transmit_overruns++;
        return;
    }
    wheel_frame *frame = &node->queue[(node->queue_head + node->queue_count) % WHEEL_TRANSMIT_QUEUE];
    frame->id = id;
    frame->length = length;
    memcpy(frame->payload, payload, length);
    node->queue_count++;
}

bool wheel_node_transmit(wheel_node *node, wheel_frame *frame) {
    if (node->queue_count == 0) {
        return false;
    }
    *frame = node->queue[node->queue_head];
    node->queue_head = (uint8_t)((node->queue_head + 1u) % WHEEL_TRANSMIT_QUEUE);
    node->queue_count--;
    return true;
}

bool wheel_node_step_pending(const wheel_node *node, uint32_t *ticks) {
    *ticks = node->step_ticks;
    return node->step_pending;
}

void wheel_node_step_done(wheel_node *node) {
    uint8_t payload[WP_STEP_DONE_LENGTH];
    const wp_step_done done = {.tick = node->tick};
    node->step_pending = false;
    if (wp_step_done_encode(&done, payload)) {
        wheel_node_queue(node, WP_STEP_DONE_ID, WP_STEP_DONE_LENGTH, payload);
    }
}
