/* The host's session, and what the host sends. */
#include "internal.h"
#include "packed.h"

#include <math.h>
#include <string.h>

#define HEARTBEAT_NS 100000000
#define HELLO_NS 200000000
#define ESTOP_BY_HOST 1u
#define SERIAL_OVERHEAD 7u /* bytes of a frame on a serial line besides its payload */

size_t wheel_client_size(void) {
    return sizeof(wheel_client);
}

const wheel_view *wheel_client_view(const wheel_client *client) {
    return &client->view;
}

static void forget_commands(wheel_client *client) {
    for (size_t i = 0; i < 256u; i++) {
        client->commanded_ns[i] = -1;
    }
}

void wheel_client_init(wheel_client *client, uint8_t mode, uint8_t parameter_check, uint16_t nonce) {
    memset(client, 0, sizeof *client);
    wheel_view *view = &client->view;
    for (size_t i = 0; i < 4u; i++) {
        view->speed_rad_s[i] = view->current_a[i] = NAN;
    }
    view->acceleration_m_s2[0] = view->acceleration_m_s2[1] = view->acceleration_m_s2[2] = NAN;
    view->yaw_rate_rad_s = NAN;
    view->nonce = nonce;
    client->mode = mode;
    client->parameter_check = parameter_check;
    client->reported = -1;
    for (uint8_t i = 0; i < 4u; i++) {
        client->wheel_of_channel[i] = i;
        client->sign_of_channel[i] = 1;
    }
    forget_commands(client);
}

bool wheel_client_wire(wheel_client *client, const uint8_t wheel_of_channel[4],
                       const int8_t sign_of_channel[4]) {
    unsigned wheels = 0;
    bool are_signs = true;
    for (size_t i = 0; i < 4u; i++) {
        wheels |= wheel_of_channel[i] < 4u ? 1u << wheel_of_channel[i] : 0u;
        are_signs = are_signs && (sign_of_channel[i] == 1 || sign_of_channel[i] == -1);
    }
    if (wheels != 0xFu || !are_signs) {
        return false;
    }
    memcpy(client->wheel_of_channel, wheel_of_channel, sizeof client->wheel_of_channel);
    memcpy(client->sign_of_channel, sign_of_channel, sizeof client->sign_of_channel);
    return true;
}

/* Frames to send */

static bool has_room(const wheel_client *client, size_t size, bool is_counted) {
    return client->view.out_bytes + size <= sizeof client->out &&
           (!is_counted || wheel_log_has_room(client, &client->sent_log, size));
}

static bool add(wheel_client *client, uint16_t id, const uint8_t *payload, size_t length, bool is_counted) {
    wheel_view *view = &client->view;
    const size_t size = WHEEL_PACKED_HEADER + length;
    if (!has_room(client, size, is_counted)) {
        return false;
    }
    uint8_t *at = client->out + view->out_bytes;
    at[0] = (uint8_t)(id & 0xFFu);
    at[1] = (uint8_t)(id >> 8);
    at[2] = (uint8_t)length;
    memcpy(at + WHEEL_PACKED_HEADER, payload, length);
    view->out_bytes += (uint32_t)size;
    view->out_frames++;
    view->out_serial_bytes += (uint32_t)(SERIAL_OVERHEAD + length + (id == WP_ESTOP_ID));
    if (is_counted) {
        view->sent++;
        client->out_counted++;
        client->out_logged += (uint32_t)wheel_log_add(client, &client->sent_log, at, size);
    }
    return true;
}

bool wheel_client_add(wheel_client *client, uint16_t id, const uint8_t *payload, size_t length) {
    return wp_payload_length(id) == (int)length && add(client, id, payload, length, id < WP_HELLO_REQUEST_ID);
}

const uint8_t *wheel_client_out(const wheel_client *client) {
    return client->out;
}

void wheel_client_sent(wheel_client *client) {
    client->view.out_bytes = client->view.out_frames = client->view.out_serial_bytes = 0;
    client->out_counted = client->out_logged = 0;
}

void wheel_client_unsent(wheel_client *client) {
    client->view.sent -= client->out_counted;
    client->sent_log.used -= client->out_logged;
    wheel_client_sent(client);
}

/* The nearest value that the wire carries, halves away from zero, and exact in single precision. NaN for a
 * value that is not within the limit. */
static float on_wire(double value, double limit, double step) {
    if (!(value >= -limit && value <= limit)) {
        return NAN;
    }
    const int32_t twice = (int32_t)(value * (2.0 / step));
    return (float)((twice < 0 ? (twice - 1) / 2 : (twice + 1) / 2) * step);
}

int wheel_client_command(wheel_client *client, const double speed_rad_s[4], const double torque_n_m[4],
                         int64_t now_ns) {
    const bool is_torque = client->mode == WP_MODE_TORQUE;
    const uint8_t sequence = (uint8_t)(client->sequence + 1u);
    const uint8_t session = (uint8_t)(client->view.nonce & 0xFu);
    uint8_t command[WP_WHEEL_COMMAND_LENGTH];
    uint8_t forward[WP_TORQUE_FEEDFORWARD_LENGTH];
    bool has_forward = false;
    float torque[4];
    for (size_t i = 0; i < 4u; i++) {
        const double torque_of_channel = client->sign_of_channel[i] * torque_n_m[client->wheel_of_channel[i]];
        torque[i] = on_wire(torque_of_channel, WP_TORQUE_COMMAND_MAX, WP_TORQUE_COMMAND_STEP);
        has_forward = has_forward || torque_n_m[i] != 0.0;
    }
    client->sequence = sequence;
    if (is_torque) {
        const wp_torque_command message = {torque[0], torque[1], torque[2], torque[3], sequence, session};
        if (!wp_torque_command_encode(&message, command)) {
            return -1;
        }
    } else {
        float speed[4];
        for (size_t i = 0; i < 4u; i++) {
            const double speed_of_channel =
                client->sign_of_channel[i] * speed_rad_s[client->wheel_of_channel[i]];
            speed[i] = on_wire(speed_of_channel, WP_WHEEL_COMMAND_MAX, WP_WHEEL_COMMAND_STEP);
        }
        const wp_torque_feedforward ahead = {torque[0], torque[1], torque[2], torque[3], sequence, session};
        const wp_wheel_command message = {speed[0], speed[1], speed[2], speed[3], sequence, session};
        if (!wp_wheel_command_encode(&message, command) || !wp_torque_feedforward_encode(&ahead, forward)) {
            return -1;
        }
    }
    if (!has_room(client, 2u * (WHEEL_PACKED_HEADER + WP_PAYLOAD_MAX), true)) {
        return -1;
    }
    client->commanded_ns[sequence] = now_ns;
    if (!is_torque && has_forward) {
        add(client, WP_TORQUE_FEEDFORWARD_ID, forward, sizeof forward, true);
    }
    add(client, is_torque ? WP_TORQUE_COMMAND_ID : WP_WHEEL_COMMAND_ID, command, sizeof command, true);
    return sequence;
}

/* Adds a frame that stops the robot in the place of all that waits, even if the log is full. */
static void replace_all(wheel_client *client, uint16_t id, const uint8_t *payload, size_t length) {
    wheel_client_unsent(client);
    if (!add(client, id, payload, length, true)) {
        add(client, id, payload, length, false);
    }
}

void wheel_client_estop(wheel_client *client) {
    uint8_t payload[WP_ESTOP_LENGTH];
    client->view.request = WP_REQUEST_IDLE;
    wp_estop_encode(&(wp_estop){.source = ESTOP_BY_HOST}, payload);
    if (!add(client, WP_ESTOP_ID, payload, sizeof payload, true)) {
        replace_all(client, WP_ESTOP_ID, payload, sizeof payload);
    }
}

static bool add_step(wheel_client *client, uint32_t from, uint16_t ticks, bool is_counted) {
    uint8_t payload[WP_STEP_LENGTH];
    return wp_step_encode(&(wp_step){.tick = from, .substeps = ticks}, payload) &&
           add(client, WP_STEP_ID, payload, sizeof payload, is_counted);
}

bool wheel_client_step(wheel_client *client, uint16_t ticks) {
    wheel_view *view = &client->view;
    if (!add_step(client, view->tick, ticks, true)) {
        return false;
    }
    client->step_from = view->tick;
    client->step_ticks = ticks;
    client->steps_sent = 1;
    view->step_target = view->tick + ticks;
    view->step = WHEEL_STEP_AWAITED;
    return true;
}

bool wheel_client_step_again(wheel_client *client) {
    if (!add_step(client, client->step_from, client->step_ticks, false)) {
        return false;
    }
    client->steps_sent++;
    return true;
}

/* The session */

bool wheel_client_request(wheel_client *client, uint8_t request, int64_t now_ns) {
    uint8_t payload[WP_HOST_HEARTBEAT_LENGTH];
    const wp_host_heartbeat heartbeat = {
        .nonce = client->view.nonce,
        .schema_hash = WP_SCHEMA_HASH,
        .request = request,
        .mode = client->mode,
        .parameter_check = client->parameter_check,
    };
    if (!wp_host_heartbeat_encode(&heartbeat, payload)) {
        return false;
    }
    if (!add(client, WP_HOST_HEARTBEAT_ID, payload, sizeof payload, true)) {
        if (request != WP_REQUEST_IDLE) {
            return false;
        }
        replace_all(client, WP_HOST_HEARTBEAT_ID, payload, sizeof payload); /* a stop is not lost */
    }
    client->view.request = request;
    if (now_ns >= 0) {
        client->has_heartbeat = true;
        client->heartbeat_ns = now_ns + HEARTBEAT_NS;
    }
    return true;
}

bool wheel_client_poll(wheel_client *client, int64_t now_ns) {
    const uint32_t waiting = client->view.out_bytes;
    if (client->is_asking && !client->view.is_greeted && now_ns >= client->hello_ns) {
        uint8_t payload[WP_HELLO_REQUEST_LENGTH];
        client->hello_ns = now_ns + HELLO_NS;
        wp_hello_request_encode(&(wp_hello_request){.protocol_version = WP_PROTOCOL_VERSION}, payload);
        add(client, WP_HELLO_REQUEST_ID, payload, sizeof payload, false);
    }
    if (client->has_heartbeat && now_ns >= client->heartbeat_ns) {
        wheel_client_request(client, client->view.request, now_ns);
    }
    return client->view.out_bytes != waiting;
}

void wheel_client_leave(wheel_client *client) {
    client->view.request = WP_REQUEST_IDLE;
    client->view.is_greeted = client->view.has_feedback = false;
    client->has_heartbeat = client->has_status = client->is_asking = false;
    client->pages = 0;
    client->steps_owed = 0;
    client->view.step = WHEEL_STEP_NONE;
    wheel_client_unsent(client); /* a command from before must not follow a new arming */
}

void wheel_client_begin(wheel_client *client, uint16_t nonce) {
    wheel_client_leave(client);
    client->is_asking = true;
    client->hello_ns = 0;
    client->view.nonce = nonce;
    client->view.tick = 0; /* of this robot it is not known */
    forget_commands(client);
    wheel_feedback_restart(client);
}

void wheel_client_expect(wheel_client *client, uint8_t parameter_check) {
    client->parameter_check = parameter_check;
}

void wheel_client_renew(wheel_client *client, uint16_t nonce) {
    client->view.request = WP_REQUEST_IDLE;
    client->view.nonce = nonce;
}

/* The log */

void wheel_client_log(wheel_client *client, uint8_t *sent, uint8_t *received, size_t capacity) {
    client->sent_log = (wheel_log){sent, 0};
    client->received_log = (wheel_log){received, 0};
    client->log_capacity = capacity;
    client->round_trips_logged = client->view.round_trips;
    client->out_logged = 0;
    client->view.log_is_due = false;
}

size_t wheel_log_add(wheel_client *client, wheel_log *log, const uint8_t *packed, size_t size) {
    if (log->bytes == NULL) {
        return 0;
    }
    memcpy(log->bytes + log->used, packed, size);
    log->used += size;
    client->view.log_is_due = client->view.log_is_due || 4u * log->used >= client->log_capacity;
    return size;
}

void wheel_client_log_take(wheel_client *client, size_t bytes[2]) {
    bytes[0] = client->sent_log.used;
    bytes[1] = client->received_log.used;
    client->sent_log.used = client->received_log.used = 0;
    client->out_logged = 0;
    client->round_trips_logged = client->view.round_trips;
    client->view.log_is_due = false;
}
