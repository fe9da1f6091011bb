#include "host.h"

#include <string.h>

struct wheel_host {
    wheel_node node;
    wheel_deframer deframer;
    wheel_plant_exchange exchange;
    void *context;
    wheel_sense sense;
    wheel_drive drive;
    bool plant_failed;
    uint32_t now_us;
    bool has_stored;
    uint8_t stored[WHEEL_STORED_SIZE];
    uint8_t serial_sequence;
    wheel_frame queue[WHEEL_HOST_QUEUE];
    size_t queue_head;
    size_t queue_count;
    uint32_t overruns;
};

static void collect(wheel_host *host) {
    wheel_frame frame;
    while (wheel_node_transmit(&host->node, &frame, host->now_us)) {
        if (host->queue_count == WHEEL_HOST_QUEUE) {
            host->overruns++;
            continue;
        }
        host->queue[(host->queue_head + host->queue_count) % WHEEL_HOST_QUEUE] = frame;
        host->queue_count++;
    }
}

size_t wheel_host_size(void) {
    return sizeof(wheel_host);
}

void wheel_host_init(wheel_host *host, const wheel_parameters *parameters, const uint8_t *stored,
                     uint16_t capabilities, uint8_t reset_cause, wheel_plant_exchange exchange,
                     void *context) {
    const wheel_identity identity = {
        .capabilities = capabilities, .version = {0, 1, 0}, .reset_cause = reset_cause};
    memset(host, 0, sizeof *host);
    host->exchange = exchange;
    host->context = context;
    wheel_deframer_init(&host->deframer);
    if (stored != NULL) {
        memcpy(host->stored, stored, sizeof host->stored);
        host->has_stored = true;
    }
    wheel_node_init(&host->node, parameters, stored, &identity);
    if (exchange(context, NULL, &host->sense) != 0) {
        host->plant_failed = true;
        wheel_node_fail(&host->node);
    }
    wheel_node_sense(&host->node, &host->sense);
    collect(host);
}

void wheel_host_run(wheel_host *host, uint32_t ticks) {
    for (uint32_t i = 0; i < ticks; i++) {
        wheel_node_drive(&host->node, &host->drive);
        host->plant_failed =
            host->plant_failed || host->exchange(host->context, &host->drive, &host->sense) != 0;
        host->now_us = host->node.tick * 1000u;
        if (host->plant_failed) {
            wheel_node_fail(&host->node); /* at every tick: a plant that is gone is not cleared */
        }
        wheel_node_sense(&host->node, &host->sense);
        collect(host);
    }
}

void wheel_host_set_clock(wheel_host *host, uint32_t now_us) {
    host->now_us = now_us;
}

size_t wheel_host_stored_size(void) {
    return WHEEL_STORED_SIZE;
}

bool wheel_host_stored(const wheel_host *host, uint8_t *bytes) {
    if (host->has_stored) {
        memcpy(bytes, host->stored, sizeof host->stored);
    }
    return host->has_stored;
}

void wheel_host_store(const wheel_parameters *parameters, uint16_t board, uint8_t *bytes) {
    wheel_parameters_store(parameters, board, bytes);
}

static void take(wheel_host *host, const wheel_frame *frame) {
    uint32_t ticks = 0;
    wheel_node_receive(&host->node, frame, host->now_us);
    if (wheel_node_store_pending(&host->node, host->stored)) {
        host->has_stored = true;
        wheel_node_stored(&host->node, true);
    }
    collect(host);
    if (wheel_node_step_pending(&host->node, &ticks)) {
        wheel_host_run(host, ticks);
        wheel_node_step_done(&host->node);
        collect(host);
    }
}

static void count_dropped(wheel_host *host) {
    const wheel_deframer *deframer = &host->deframer;
    wheel_transport_counters *counts = &host->node.transport;
    counts->cobs = deframer->cobs;
    counts->crc = deframer->crc;
    counts->length = deframer->length_errors;
    counts->overrun = deframer->overruns;
    counts->serial_lost = deframer->lost;
    counts->unknown_id = deframer->unknown_id;
}

void wheel_host_feed(wheel_host *host, const uint8_t *bytes, size_t length) {
    wheel_frame frame;
    size_t at = 0;
    while (wheel_deframer_take(&host->deframer, bytes, length, &at, &frame)) {
        count_dropped(host); /* the frame may be answered with the counts */
        take(host, &frame);
    }
    count_dropped(host);
}

void wheel_host_receive(wheel_host *host, uint16_t id, const uint8_t *payload, size_t length) {
    wheel_frame frame = {.id = id};
    if (length > sizeof frame.payload) {
        host->node.transport.length++;
        return;
    }
    frame.length = (uint8_t)length;
    memcpy(frame.payload, payload, length);
    take(host, &frame);
}

static wheel_frame pop(wheel_host *host) {
    const wheel_frame frame = host->queue[host->queue_head];
    host->queue_head = (host->queue_head + 1u) % WHEEL_HOST_QUEUE;
    host->queue_count--;
    return frame;
}

size_t wheel_host_take_bytes(wheel_host *host, uint8_t *bytes, size_t capacity) {
    size_t used = 0;
    while (host->queue_count > 0u && capacity - used >= WHEEL_FRAME_MAX) {
        const wheel_frame frame = pop(host);
        used += wheel_frame_encode(&frame, host->serial_sequence++, bytes + used);
    }
    return used;
}

int wheel_host_take_frame(wheel_host *host, uint16_t *id, uint8_t *payload) {
    if (host->queue_count == 0u) {
        return -1;
    }
    const wheel_frame frame = pop(host);
    *id = frame.id;
    memcpy(payload, frame.payload, frame.length);
    return (int)frame.length;
}

void wheel_host_count_unsent(wheel_host *host, uint32_t frames) {
    host->node.transmit_overruns += frames;
}

void wheel_host_look(const wheel_host *host, wheel_host_view *view) {
    const wheel_node *node = &host->node;
    const wheel_rejections *own = &node->rejections;
    memset(view, 0, sizeof *view);
    view->tick = node->tick;
    view->state = node->state;
    view->mode = node->mode;
    view->fault = node->fault;
    view->fault_wheel = node->fault_wheel;
    view->stop_reason = node->stop_reason;
    view->plant_failed = host->plant_failed;
    view->command_age_ticks = node->setting.age_ticks;
    memcpy(view->set_point_rad_s, node->set_point_rad_s, sizeof view->set_point_rad_s);
    memcpy(view->torque_n_m, host->drive.torque_n_m, sizeof view->torque_n_m);
    memcpy(view->duty, host->drive.duty, sizeof view->duty);
    view->rejected_cobs = node->transport.cobs;
    view->rejected_crc = node->transport.crc;
    view->rejected_length = node->transport.length + node->transport.overrun + own->length;
    view->rejected_unknown_id = node->transport.unknown_id + own->unknown_id;
    view->rejected_range = own->range;
    view->rejected_session = own->session;
    view->rejected_stale = own->stale;
    view->rejected_state = own->state;
    view->feedforward_unmatched = own->feedforward_unmatched;
    view->transmit_overruns = host->overruns + node->transmit_overruns;
}
