/* What a received frame does. Only an accepted command touches the watchdog's age. */
#include <string.h>

#include "node.h"

static uint8_t session_of(uint16_t nonce) {
    return (uint8_t)(nonce & 0x0Fu);
}

static bool takes_commands(const wheel_node *node) {
    return node->state == WP_STATE_ARMED || node->state == WP_STATE_ACTIVE;
}

static bool all_zero(const float value[WHEEL_COUNT]) {
    bool zero = true;
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        zero = zero && value[i] == 0.0f;
    }
    return zero;
}

/* True when a command of this mode, session and sequence may be used now; counts the reason when not. */
static bool command_is_fresh(wheel_node *node, uint8_t mode, uint8_t session, uint8_t sequence) {
    if (!takes_commands(node) || mode != node->mode) {
        node->rejections.state++;
        return false;
    }
    if (session != session_of(node->session_nonce)) {
        node->rejections.session++;
        return false;
    }
    if (node->state == WP_STATE_ACTIVE) {
        const uint8_t distance = (uint8_t)(sequence - node->setting.sequence);
        if (distance == 0u || distance > WHEEL_SEQUENCE_WINDOW) {
            node->rejections.stale++;
            return false;
        }
    }
    return true;
}

static void accept_command(wheel_node *node, const float target[WHEEL_COUNT], uint8_t sequence) {
    if (node->state == WP_STATE_ARMED && !all_zero(target)) {
        /* Nothing moves on the first command: the host has to begin at rest. */
        node->rejections.state++;
        return;
    }
    memcpy(node->setting.target, target, sizeof node->setting.target);
    memset(node->setting.feedforward_n_m, 0, sizeof node->setting.feedforward_n_m);
    if (node->staged.present) {
        if (node->staged.sequence == sequence) {
            memcpy(node->setting.feedforward_n_m, node->staged.torque_n_m,
                   sizeof node->setting.feedforward_n_m);
        } else {
            node->rejections.feedforward_unmatched++;
        }
        node->staged.present = false;
    }
    node->setting.sequence = sequence;
    node->setting.age_ticks = 0;
    wheel_node_event(node, WHEEL_EVENT_COMMAND);
}

static bool on_wheel_command(wheel_node *node, const wheel_frame *frame) {
    wp_wheel_command m;
    if (!wp_wheel_command_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    const float target[WHEEL_COUNT] = {m.fl_rad_s, m.fr_rad_s, m.rr_rad_s, m.rl_rad_s};
    if (command_is_fresh(node, WP_MODE_SPEED, m.session, m.sequence)) {
        accept_command(node, target, m.sequence);
    }
    return true;
}

static bool on_torque_command(wheel_node *node, const wheel_frame *frame) {
    wp_torque_command m;
    if (!wp_torque_command_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    const float target[WHEEL_COUNT] = {m.fl_n_m, m.fr_n_m, m.rr_n_m, m.rl_n_m};
    if (command_is_fresh(node, WP_MODE_TORQUE, m.session, m.sequence)) {
        accept_command(node, target, m.sequence);
    }
    return true;
}

static bool on_torque_feedforward(wheel_node *node, const wheel_frame *frame) {
    wp_torque_feedforward m;
    if (!wp_torque_feedforward_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    const float torque[WHEEL_COUNT] = {m.fl_n_m, m.fr_n_m, m.rr_n_m, m.rl_n_m};
    if (node->state != WP_STATE_ACTIVE) {
        /* The command that arms is zero, and so is what goes with it. */
        node->rejections.state++;
    } else if (command_is_fresh(node, WP_MODE_SPEED, m.session, m.sequence)) {
        if (node->staged.present) {
            node->rejections.feedforward_unmatched++;
        }
        node->staged.present = true;
        node->staged.sequence = m.sequence;
        memcpy(node->staged.torque_n_m, torque, sizeof node->staged.torque_n_m);
    }
    return true;
}

static uint8_t arm_refusal(const wheel_node *node, const wp_host_heartbeat *m) {
    if (m->nonce == node->session_nonce) {
        return WP_ARM_REFUSAL_NONCE_USED;
    }
    if (node->state != WP_STATE_IDLE) {
        return WP_ARM_REFUSAL_NOT_IDLE;
    }
    if (m->nonce != node->announced_nonce) {
        /* A wish that was held through a stop, a fault or a reset of this node. */
        return WP_ARM_REFUSAL_NOT_ANNOUNCED;
    }
    if (node->session_nonce != 0u && session_of(m->nonce) == session_of(node->session_nonce)) {
        /* Commands of the old session still on their way would pass for new ones. */
        return WP_ARM_REFUSAL_SESSION_USED;
    }
    if (m->schema_hash != WP_SCHEMA_HASH) {
        return WP_ARM_REFUSAL_SCHEMA;
    }
    if (m->parameter_check != (uint8_t)(wheel_parameters_hash(&node->parameters) & 0xFFu)) {
        return WP_ARM_REFUSAL_PARAMETERS;
    }
    const uint16_t needed = m->mode == WP_MODE_TORQUE ? WHEEL_CAPABILITY_TORQUE : WHEEL_CAPABILITY_SPEED;
    return (node->identity.capabilities & needed) != 0u ? WP_ARM_REFUSAL_NONE : WP_ARM_REFUSAL_MODE;
}

/* Arming is an edge: the nonce was announced by an IDLE request in IDLE, and arms once. */
static void on_arm_request(wheel_node *node, const wp_host_heartbeat *m) {
    if (takes_commands(node) && m->nonce == node->session_nonce) {
        return; /* the heartbeat of the session in force */
    }
    const uint8_t refusal = arm_refusal(node, m);
    const bool news = node->arm_refusal != refusal;
    node->arm_refusal = refusal;
    node->announced_nonce = 0u;
    if (refusal == WP_ARM_REFUSAL_NONE) {
        node->session_nonce = m->nonce;
        node->mode = m->mode;
        wheel_node_event(node, WHEEL_EVENT_ARM);
    } else if (news) {
        wheel_node_send_status(node);
    }
}

static void on_idle_request(wheel_node *node, uint16_t nonce) {
    wheel_node_stop(node, WHEEL_EVENT_DISARM, WP_STOP_REASON_HOST_REQUEST);
    if (node->state == WP_STATE_IDLE) {
        node->announced_nonce = nonce;
    }
}

/* CLEAR is an edge as arming is: a repeated wish does not clear the next fault. An emergency stop that still
 * brakes is not cleared: without drives the robot would roll on. */
static void on_clear_request(wheel_node *node, uint16_t nonce) {
    if (node->braking) {
        return;
    }
    const bool is_new = nonce != node->cleared_nonce;
    node->cleared_nonce = nonce;
    if (is_new && node->fault != WP_FAULT_PARAMETERS) {
        wheel_node_event(node, WHEEL_EVENT_CLEAR);
    }
}

static bool on_heartbeat(wheel_node *node, const wheel_frame *frame) {
    wp_host_heartbeat m;
    if (!wp_host_heartbeat_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    switch (m.request) {
    case WP_REQUEST_ARM:
        on_arm_request(node, &m);
        break;
    case WP_REQUEST_CLEAR:
        on_clear_request(node, m.nonce);
        break;
    default:
        on_idle_request(node, m.nonce);
        break;
    }
    return true;
}

/* Whatever source and reason it gives: a stop is a stop. */
static bool on_estop(wheel_node *node, const wheel_frame *frame) {
    (void)frame;
    wheel_node_stop(node, WHEEL_EVENT_ESTOP, WP_STOP_REASON_ESTOP);
    return true;
}

/* Idempotent: a step that was run is answered again with the tick that it reached. */
static bool on_step(wheel_node *node, const wheel_frame *frame) {
    wp_step m;
    if (!wp_step_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    const uint16_t capabilities = node->identity.capabilities;
    if ((capabilities & WHEEL_CAPABILITY_LOCKSTEP) == 0u ||
        (capabilities & WHEEL_CAPABILITY_POWER_STAGE) != 0u) {
        node->rejections.state++;
        return true;
    }
    node->step_ticks = m.tick == node->tick ? m.substeps : 0u;
    node->step_pending = true;
    return true;
}

/* Answered to a host of any version, so that it can find out that it is of another. */
static bool on_hello_request(wheel_node *node, const wheel_frame *frame) {
    (void)frame;
    /* A host that greets has asked for nothing yet: what was refused to another is not its business. */
    node->arm_refusal = WP_ARM_REFUSAL_NONE;
    wheel_node_send_hello(node);
    return true;
}

void wheel_node_receive(wheel_node *node, const wheel_frame *frame, uint32_t now_us) {
    node->now_us = now_us;
    static const struct {
        uint16_t id;
        bool (*take)(wheel_node *, const wheel_frame *);
    } handlers[] = {
        {WP_ESTOP_ID, on_estop},
        {WP_TIME_SYNC_REQUEST_ID, wheel_node_on_time_sync},
        {WP_HOST_HEARTBEAT_ID, on_heartbeat},
        {WP_TORQUE_FEEDFORWARD_ID, on_torque_feedforward},
        {WP_WHEEL_COMMAND_ID, on_wheel_command},
        {WP_TORQUE_COMMAND_ID, on_torque_command},
        {WP_PARAMETER_REQUEST_ID, wheel_node_on_parameter},
        {WP_STEP_ID, on_step},
        {WP_HELLO_REQUEST_ID, on_hello_request},
    };
    for (size_t i = 0; i < sizeof handlers / sizeof handlers[0]; i++) {
        if (handlers[i].id == frame->id) {
            if (wp_payload_length(frame->id) != (int)frame->length) {
                node->rejections.length++;
            } else if (!handlers[i].take(node, frame)) {
                node->rejections.range++;
            }
            return;
        }
    }
    node->rejections.unknown_id++;
}
