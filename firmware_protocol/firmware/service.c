/* Requests that move nothing: the robot's clock, and its parameters. */
#include "node.h"

bool wheel_node_on_time_sync(wheel_node *node, const wheel_frame *frame) {
    wp_time_sync_request m = {0};
    const bool decoded = wp_time_sync_request_decode(frame->payload, frame->length, &m);
    const wp_time_sync_response answer = {.received_us = node->now_us, .sequence = m.sequence};
    uint8_t payload[WP_TIME_SYNC_RESPONSE_LENGTH];
    if (decoded && wp_time_sync_response_encode(&answer, payload)) {
        wheel_node_queue(node, WP_TIME_SYNC_RESPONSE_ID, WP_TIME_SYNC_RESPONSE_LENGTH, payload);
    }
    return decoded;
}

static void answer(wheel_node *node, const wp_parameter_request *m, uint8_t result, uint32_t value) {
    const wp_parameter_response response = {
        .parameter = m->parameter,
        .operation = m->operation,
        .transaction = m->transaction,
        .result = result,
        .type =
            m->parameter < WHEEL_PARAMETER_COUNT ? wheel_parameter_table[m->parameter].type : WP_TYPE_FLOAT32,
        .value = value,
    };
    uint8_t payload[WP_PARAMETER_RESPONSE_LENGTH];
    if (wp_parameter_response_encode(&response, payload)) {
        wheel_node_queue(node, WP_PARAMETER_RESPONSE_ID, WP_PARAMETER_RESPONSE_LENGTH, payload);
    }
}

static void write_one(wheel_node *node, const wp_parameter_request *m) {
    float value;
    uint8_t result = WP_RESULT_OK;
    if (node->state != WP_STATE_IDLE || node->store_pending) {
        result = WP_RESULT_STATE;
    } else if (!wheel_parameter_from_bits(m->parameter, m->value, &value) ||
               !wheel_parameter_set(&node->parameters, node->identity.maximum, m->parameter, value)) {
        result = WP_RESULT_RANGE;
    }
    answer(node, m, result,
           wheel_parameter_bits(m->parameter, wheel_parameter_get(&node->parameters, m->parameter)));
}

static void on_one(wheel_node *node, const wp_parameter_request *m) {
    if (m->parameter >= WHEEL_PARAMETER_COUNT) {
        answer(node, m, WP_RESULT_PARAMETER, 0u);
        return;
    }
    const wheel_parameter_info *info = &wheel_parameter_table[m->parameter];
    switch (m->operation) {
    case WP_OPERATION_READ_MINIMUM:
        answer(node, m, WP_RESULT_OK, wheel_parameter_bits(m->parameter, info->minimum));
        break;
    case WP_OPERATION_READ_MAXIMUM:
        answer(node, m, WP_RESULT_OK,
               wheel_parameter_bits(m->parameter,
                                    wheel_parameter_maximum(node->identity.maximum, m->parameter)));
        break;
    case WP_OPERATION_WRITE:
        write_one(node, m);
        break;
    default:
        answer(node, m, WP_RESULT_OK,
               wheel_parameter_bits(m->parameter, wheel_parameter_get(&node->parameters, m->parameter)));
        break;
    }
}

/* STORE and RESTORE: in IDLE only, one at a time. */
static void on_all(wheel_node *node, const wp_parameter_request *m) {
    const bool store = m->operation == WP_OPERATION_STORE;
    uint8_t result = WP_RESULT_OK;
    if (node->state != WP_STATE_IDLE || node->store_pending) {
        result = WP_RESULT_STATE;
    } else if (store && (node->identity.capabilities & WHEEL_CAPABILITY_STORAGE) == 0u) {
        result = WP_RESULT_STORAGE;
    } else if (store) {
        node->store_pending = true;
        node->store_request = *m;
        return; /* answered when it is done */
    } else {
        node->parameters = node->built_in;
    }
    answer(node, m, result, wheel_parameters_hash(&node->parameters));
}

bool wheel_node_on_parameter(wheel_node *node, const wheel_frame *frame) {
    wp_parameter_request m;
    if (!wp_parameter_request_decode(frame->payload, frame->length, &m)) {
        return false;
    }
    if (m.operation == WP_OPERATION_STORE || m.operation == WP_OPERATION_RESTORE) {
        on_all(node, &m);
    } else {
        on_one(node, &m);
    }
    return true;
}

bool wheel_node_store_pending(const wheel_node *node, uint8_t bytes[WHEEL_STORED_SIZE]) {
    if (node->store_pending) {
        wheel_parameters_store(&node->parameters, node->identity.board, bytes);
    }
    return node->store_pending;
}

void wheel_node_stored(wheel_node *node, bool kept) {
    if (node->store_pending) {
        node->store_pending = false;
        answer(node, &node->store_request, kept ? WP_RESULT_OK : WP_RESULT_STORAGE,
               wheel_parameters_hash(&node->parameters));
    }
}
