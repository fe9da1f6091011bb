/* The steps by which the host makes a robot ACTIVE. They use only the calls of wheel_client.h. */
#include "wheel_client.h"

/* Refusals that another nonce may end. */
static bool another_nonce_helps(uint8_t refusal) {
    return refusal == WP_ARM_REFUSAL_NONCE_USED || refusal == WP_ARM_REFUSAL_SESSION_USED ||
           refusal == WP_ARM_REFUSAL_NOT_IDLE || refusal == WP_ARM_REFUSAL_NOT_ANNOUNCED;
}

/* STATUS may report a state later than the feedback does: without it the cause is not known yet. */
static bool is_latched(const wheel_client *client, uint8_t state) {
    return client->has_status && client->status.state == state;
}

/* (state of the robot, what holds) -> what the host does; otherwise it waits. */
static uint8_t arming(const wheel_client *client) {
    const wheel_view *view = &client->view;
    /* Another host may have armed the robot meanwhile. */
    const bool is_ours = client->has_status && client->status.nonce == view->nonce;
    const uint8_t refusal = client->has_status ? client->status.arm_refusal : (uint8_t)WP_ARM_REFUSAL_NONE;
    if (!view->has_feedback) {
        return WHEEL_ARMING_WAIT;
    }
    switch (view->state) {
    case WP_STATE_ACTIVE:
        return is_ours ? WHEEL_ARMING_DONE : WHEEL_ARMING_WAIT;
    case WP_STATE_ARMED:
        return is_ours ? WHEEL_ARMING_HOLD : WHEEL_ARMING_WAIT;
    case WP_STATE_IDLE:
        if (!view->is_greeted) {
            return WHEEL_ARMING_STRANGER;
        }
        if (view->request == WP_REQUEST_IDLE) {
            return WHEEL_ARMING_ASKED;
        }
        if (another_nonce_helps(refusal)) {
            return WHEEL_ARMING_NEW_NONCE;
        }
        return refusal != WP_ARM_REFUSAL_NONE ? WHEEL_ARMING_REFUSED : WHEEL_ARMING_WAIT;
    case WP_STATE_FAULT:
    case WP_STATE_ESTOP:
        return is_latched(client, view->state) ? WHEEL_ARMING_LATCHED : WHEEL_ARMING_WAIT;
    default:
        return WHEEL_ARMING_WAIT;
    }
}

uint8_t wheel_client_arm(wheel_client *client, int64_t now_ns) {
    static const double rest[4] = {0.0, 0.0, 0.0, 0.0};
    const uint8_t step = arming(client);
    if (step == WHEEL_ARMING_HOLD) {
        wheel_client_command(client, rest, rest, now_ns);
    } else if (step == WHEEL_ARMING_ASKED) {
        wheel_client_request(client, WP_REQUEST_IDLE, now_ns);
        wheel_client_request(client, WP_REQUEST_ARM, now_ns);
    } else if (step == WHEEL_ARMING_NEW_NONCE) {
        client->has_status = false;
    }
    return step;
}
