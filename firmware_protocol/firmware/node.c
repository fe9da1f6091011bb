#include "node.h"

#include <string.h>

uint32_t wheel_ticks(float seconds) {
    return (uint32_t)(seconds * 1000.0f + 0.5f);
}

float wheel_magnitude(float x) {
    return x < 0.0f ? -x : x;
}

void wheel_node_init(wheel_node *node, const wheel_parameters *built_in, const uint8_t *stored,
                     const wheel_identity *identity) {
    memset(node, 0, sizeof *node);
    node->identity = *identity;
    node->state = WP_STATE_BOOT;
    node->setting.age_ticks = UINT32_MAX;
    for (size_t i = 0; i < WHEEL_PARAMETER_COUNT; i++) {
        if (!wheel_parameter_set(&node->built_in, identity->maximum, i, wheel_parameter_get(built_in, i))) {
            /* A fault for good; with a number in its place, so that all that computes with it may. */
            (void)wheel_parameter_set(&node->built_in, NULL, i, wheel_parameter_table[i].minimum);
            node->fault = WP_FAULT_PARAMETERS;
        }
    }
    node->parameters = node->built_in;
    if (stored != NULL) {
        (void)wheel_parameters_load(&node->parameters, identity->maximum, identity->board, stored);
    }
    wheel_node_event(node, node->fault == WP_FAULT_NONE ? WHEEL_EVENT_READY : WHEEL_EVENT_FAULT);
}

static void begin_session(wheel_node *node) {
    memset(&node->setting, 0, sizeof node->setting);
    node->setting.age_ticks = UINT32_MAX; /* no command yet */
    memset(&node->speed_loop, 0, sizeof node->speed_loop);
    memset(&node->current_loop, 0, sizeof node->current_loop);
    memset(node->encoder, 0, sizeof node->encoder);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        /* A wheel may still roll, and be braked from the first tick on: it has not gained this speed. */
        node->encoder[i].slowest_rad_s = wheel_magnitude(node->speed_rad_s[i]);
    }
    node->staged.present = false;
    node->stop_reason = WP_STOP_REASON_NONE;
}

/* A stop begins at the set point or at the speed that the wheel really has, whichever is nearer to zero, and
 * with an empty integral: what was wound up against an obstacle must not drive the robot once that gives way.
 */
static void begin_stop(wheel_node *node) {
    memset(&node->speed_loop, 0, sizeof node->speed_loop);
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const float target = node->set_point_rad_s[i];
        const float speed = node->speed_rad_s[i];
        const bool nearer = wheel_magnitude(speed) < wheel_magnitude(target);
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
        node->fault_wheel = WP_FAULT_WHEEL_NONE;
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

void wheel_node_fault(wheel_node *node, uint8_t cause, uint8_t wheel) {
    if (node->fault == WP_FAULT_NONE) {
        node->fault = cause;
        node->fault_wheel = wheel;
    }
    node->braking = false;
    wheel_node_stop(node, WHEEL_EVENT_FAULT, WP_STOP_REASON_FAULT);
}

void wheel_node_fail(wheel_node *node) {
    wheel_node_fault(node, WP_FAULT_SENSOR, WP_FAULT_WHEEL_NONE);
}

void wheel_node_sense(wheel_node *node, const wheel_sense *sense) {
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const uint32_t turned = (uint32_t)(uint16_t)(sense->count[i] - node->sense.count[i]);
        if (node->tracker[i].running) {
            node->absolute_count[i] += turned < 0x8000u ? turned : turned - 0x10000u;
        }
        node->speed_rad_s[i] = wheel_tracker_update(&node->tracker[i], sense->count[i], &node->parameters);
    }
    node->sense = *sense;
    wheel_node_supervise(node);
    wheel_node_send_feedback(node);
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
                                   feedforward_n_m, &node->parameters, wheel_node_torque_limit(node),
                                   drive->torque_n_m);
}

static bool drive_active(wheel_node *node, wheel_drive *drive) {
    if (node->mode == WP_MODE_SPEED) {
        memcpy(node->set_point_rad_s, node->setting.target, sizeof node->set_point_rad_s);
        const bool slowed = wheel_scale_to_limit(node->set_point_rad_s, wheel_node_speed_limit(node));
        return drive_by_speed(node, node->setting.feedforward_n_m, drive) || slowed;
    }
    /* A stop that follows begins at the speed that the wheels have. */
    memcpy(node->set_point_rad_s, node->speed_rad_s, sizeof node->set_point_rad_s);
    memcpy(drive->torque_n_m, node->setting.target, sizeof drive->torque_n_m);
    return wheel_scale_to_limit(drive->torque_n_m, wheel_node_torque_limit(node));
}

/* The duties that drive these torques through motors without a current loop of their own. */
static void drive_currents(wheel_node *node, wheel_drive *drive) {
    float target_a[WHEEL_COUNT];
    /* A robot that is cleared and armed within a tick is switched on for it before its fault is found again.
     * Without sensors it gives no duty: that of a current of NaN would be NaN. */
    if (drive->enabled == 0u || !wheel_sense_is_plausible(&node->sense)) {
        memset(&node->current_loop, 0, sizeof node->current_loop);
        return;
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        target_a[i] = drive->torque_n_m[i] / node->parameters.torque_constant_n_m_a;
    }
    wheel_current_loop_update(&node->current_loop, target_a, node->sense.current_a, node->speed_rad_s,
                              node->sense.battery_v, &node->parameters, drive->duty);
}

void wheel_node_drive(wheel_node *node, wheel_drive *drive) {
    static const float none[WHEEL_COUNT] = {0.0f, 0.0f, 0.0f, 0.0f};
    bool limited = false;
    memset(drive, 0, sizeof *drive);
    drive->tick = node->tick;
    switch (node->state) {
    case WP_STATE_ACTIVE:
        drive->enabled = 1u;
        limited = drive_active(node, drive);
        break;
    case WP_STATE_STOPPING:
        drive->enabled = 1u;
        ramp_set_point(node);
        limited = drive_by_speed(node, none, drive);
        break;
    case WP_STATE_ESTOP:
        memset(node->set_point_rad_s, 0, sizeof node->set_point_rad_s);
        node->braking =
            node->braking && node->state_ticks < WHEEL_STOP_LIMIT_TICKS && !wheel_node_at_rest(node);
        if (node->braking) {
            drive->enabled = 1u;
            limited = drive_by_speed(node, none, drive);
        }
        break;
    default:
        memset(node->set_point_rad_s, 0, sizeof node->set_point_rad_s);
        break;
    }
    drive_currents(node, drive);
    memcpy(node->torque_n_m, drive->torque_n_m, sizeof node->torque_n_m);
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

/* The answer to a TIME_SYNC_REQUEST tells how long it waited here. */
static void stamp(wheel_frame *frame, uint32_t now_us) {
    wp_time_sync_response m;
    if (wp_time_sync_response_decode(frame->payload, frame->length, &m)) {
        const uint32_t held_us = now_us - m.received_us;
        m.held_us = held_us > 0xFFFFu ? 0xFFFFu : (uint16_t)held_us;
        (void)wp_time_sync_response_encode(&m, frame->payload);
    }
}

bool wheel_node_transmit(wheel_node *node, wheel_frame *frame, uint32_t now_us) {
    if (node->queue_count == 0) {
        return false;
    }
    *frame = node->queue[node->queue_head];
    node->queue_head = (uint8_t)((node->queue_head + 1u) % WHEEL_TRANSMIT_QUEUE);
    node->queue_count--;
    if (frame->id == WP_TIME_SYNC_RESPONSE_ID) {
        stamp(frame, now_us);
    }
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
