/* What the robot sends: messages, snapshots of its feedback, and the answers to STEP. */
#include "internal.h"
#include "packed.h"

#include <string.h>

/* The parts in the order in which they are sent, as in TICK.parts. */
enum { ENCODERS = 1, WHEEL_SPEEDS = 2, CURRENTS = 4, ACCELEROMETER = 8, GYRO = 16 };

#define HELLO_PAGES 8u
_Static_assert(WP_HELLO_FAULT_ADDRESS_ID == WP_HELLO_IDENTITY_ID + HELLO_PAGES - 1u,
               "the pages are numbered");

void wheel_feedback_restart(wheel_client *client) {
    client->missing = 0;
    client->has_number = false;
    client->has_time = false;
}

/* Snapshots */

/* Values of the robot's channels as values of wheels. */
static void set_wheels(const wheel_client *client, float wheels[4], const float channels[4]) {
    for (size_t i = 0; i < 4u; i++) {
        wheels[client->wheel_of_channel[i]] = (float)client->sign_of_channel[i] * channels[i];
    }
}

static void commit(wheel_client *client, int64_t now_ns) {
    wheel_view *view = &client->view;
    const wp_tick *tick = &client->open;
    const uint8_t parts = tick->parts;
    if ((parts & ENCODERS) != 0u) {
        const wp_encoders *e = &client->encoders;
        const uint16_t counts[4] = {e->fl_count, e->fr_count, e->rr_count, e->rl_count};
        for (size_t i = 0; i < 4u; i++) {
            view->encoder_count[client->wheel_of_channel[i]] =
                (uint16_t)(client->sign_of_channel[i] * counts[i]);
        }
    }
    if ((parts & WHEEL_SPEEDS) != 0u) {
        const wp_wheel_speeds *w = &client->speeds;
        set_wheels(client, view->speed_rad_s, (float[4]){w->fl_rad_s, w->fr_rad_s, w->rr_rad_s, w->rl_rad_s});
    }
    if ((parts & CURRENTS) != 0u) {
        const wp_currents *c = &client->currents;
        set_wheels(client, view->current_a, (float[4]){c->fl_a, c->fr_a, c->rr_a, c->rl_a});
    }
    if ((parts & ACCELEROMETER) != 0u) {
        const wp_accelerometer *a = &client->accelerometer;
        memcpy(view->acceleration_m_s2, (float[3]){a->x_m_s2, a->y_m_s2, a->z_m_s2}, 12u);
    }
    if ((parts & GYRO) != 0u) {
        view->yaw_rate_rad_s = client->gyro.z_rad_s;
    }
    if (client->has_time) {
        view->robot_time_us += (uint32_t)(tick->time_us - client->time_us);
    } else {
        view->robot_time_us = tick->time_us;
    }
    client->time_us = tick->time_us;
    client->has_time = true;
    view->state = tick->state;
    view->command_sequence = tick->sequence;
    view->command_age_ms = tick->command_age_ms;
    view->has_feedback = true;
    view->feedback_ns = now_ns;
    view->snapshots++;
}

static void open_snapshot(wheel_client *client, const wp_tick *tick, int64_t now_ns) {
    wheel_view *view = &client->view;
    view->incomplete += client->missing != 0u;
    if (client->has_number) {
        const uint8_t missing = (uint8_t)(tick->snapshot - client->number - 1u);
        /* Half the circle or more is a repeated TICK, one that was overtaken, or a robot that was reset. */
        view->lost += missing < 128u ? missing : 0u;
    }
    client->number = tick->snapshot;
    client->has_number = true;
    client->open = *tick;
    client->missing = tick->parts;
    if (tick->sequence == client->reported) {
        return;
    }
    client->reported = tick->sequence;
    const int64_t commanded_ns = client->commanded_ns[tick->sequence];
    if (commanded_ns >= 0) {
        client->commanded_ns[tick->sequence] = -1;
        view->round_trip_ns = now_ns - commanded_ns;
        view->round_trips_ns[view->round_trips++ % 256u] = view->round_trip_ns;
        view->log_is_due = view->log_is_due || (client->received_log.bytes != NULL &&
                                                view->round_trips - client->round_trips_logged >= 128u);
    }
}

static void take_part(wheel_client *client, uint8_t part, bool belongs, int64_t now_ns) {
    const uint8_t missing = client->missing;
    if (missing == 0u) {
        return;
    }
    const uint8_t turn = (uint8_t)(missing & (0u - missing)); /* the lowest bit */
    if (part != turn || !belongs) {
        client->missing = 0;
        client->view.incomplete++;
        return;
    }
    client->missing = (uint8_t)(missing & ~part);
    if (client->missing == 0u) {
        commit(client, now_ns);
    }
}

/* Takes a message of a snapshot; false if it is none, or not valid. */
static bool take_snapshot(wheel_client *client, const wheel_packed *frame, int64_t now_ns) {
    const uint8_t *payload = frame->payload;
    const size_t length = frame->length;
    const uint16_t open_ms = (uint16_t)(client->open.time_us / 1000u);
    uint16_t sampled_ms = open_ms; /* only the inertial sensors' parts carry their sampling instant */
    wp_tick tick;
    uint8_t part;
    bool is_valid;
    switch (frame->id) {
    case WP_TICK_ID:
        if (wp_tick_decode(payload, length, &tick)) {
            open_snapshot(client, &tick, now_ns);
            return true;
        }
        return false;
    case WP_ENCODERS_ID:
        part = ENCODERS;
        is_valid = wp_encoders_decode(payload, length, &client->encoders);
        break;
    case WP_WHEEL_SPEEDS_ID:
        part = WHEEL_SPEEDS;
        is_valid = wp_wheel_speeds_decode(payload, length, &client->speeds);
        break;
    case WP_CURRENTS_ID:
        part = CURRENTS;
        is_valid = wp_currents_decode(payload, length, &client->currents);
        break;
    case WP_ACCELEROMETER_ID:
        part = ACCELEROMETER;
        is_valid = wp_accelerometer_decode(payload, length, &client->accelerometer);
        sampled_ms = client->accelerometer.tick;
        break;
    case WP_GYRO_ID:
        part = GYRO;
        is_valid = wp_gyro_decode(payload, length, &client->gyro);
        sampled_ms = client->gyro.tick;
        break;
    default:
        return false;
    }
    if (is_valid) {
        take_part(client, part, sampled_ms == open_ms, now_ns);
    }
    return is_valid;
}

/* Other messages */

/* Whether this answer ended the step; if not, it is a duplicate: one more to an earlier STEP that was sent
 * again. A duplicate has the tick at which this step begins. A step of no ticks ends with that tick too, so
 * duplicates are counted. One that never comes costs the step its own answer, and it is sent again. */
static bool ends_step(wheel_client *client, uint32_t tick) {
    wheel_view *view = &client->view;
    view->step_done_tick = tick;
    if (view->step != WHEEL_STEP_AWAITED ||
        (client->step_ticks == 0u ? client->steps_owed != 0u : tick == client->step_from)) {
        client->steps_owed -= client->steps_owed != 0u;
        return false;
    }
    if (client->step_ticks != 0u && tick != view->step_target) {
        view->step = WHEEL_STEP_ELSEWHERE;
        return false;
    }
    view->tick = tick;
    view->step = WHEEL_STEP_DONE;
    /* Duplicates of earlier answers have come before this one, or never will. */
    client->steps_owed = client->steps_sent - 1u;
    return true;
}

/* X(NAME, name): decodes a message only to see whether it is valid. */
#define CHECK(NAME, name)                                                                                    \
    case WP_##NAME##_ID: {                                                                                   \
        wp_##name message;                                                                                   \
        return wp_##name##_decode(frame->payload, frame->length, &message);                                  \
    }

static bool is_valid(const wheel_packed *frame) {
    switch (frame->id) {
        WP_MESSAGES(CHECK)
    default:
        return false;
    }
}

/* Keeps a page of HELLO; false if it is not valid. Those of a processor's fault are for the caller. */
static bool keep_page(wheel_robot *robot, const wheel_packed *frame) {
    const uint8_t *payload = frame->payload;
    const size_t length = frame->length;
    switch (frame->id) {
    case WP_HELLO_IDENTITY_ID:
        return wp_hello_identity_decode(payload, length, &robot->identity);
    case WP_HELLO_FIRMWARE_ID:
        return wp_hello_firmware_decode(payload, length, &robot->firmware);
    case WP_HELLO_PARAMETERS_ID:
        return wp_hello_parameters_decode(payload, length, &robot->parameters);
    case WP_HELLO_GEOMETRY_ID:
        return wp_hello_geometry_decode(payload, length, &robot->geometry);
    case WP_HELLO_LIMITS_ID:
        return wp_hello_limits_decode(payload, length, &robot->limits);
    default:
        return is_valid(frame);
    }
}

static bool take_page(wheel_client *client, const wheel_packed *frame) {
    const wheel_robot *robot = &client->robot;
    if (!keep_page(&client->robot, frame)) {
        return false;
    }
    client->pages = (uint8_t)(client->pages | (1u << (frame->id - WP_HELLO_IDENTITY_ID)));
    client->view.is_greeted =
        client->view.is_greeted || (client->pages == (1u << HELLO_PAGES) - 1u &&
                                    robot->identity.protocol_version == WP_PROTOCOL_VERSION &&
                                    robot->identity.schema_hash == WP_SCHEMA_HASH);
    return true;
}

static bool take_other(wheel_client *client, const wheel_packed *frame) {
    if (frame->id == WP_STATUS_ID) {
        wp_status status;
        if (!wp_status_decode(frame->payload, frame->length, &status)) {
            return false;
        }
        client->status = status;
        client->has_status = true;
        return true;
    }
    if (frame->id >= WP_HELLO_IDENTITY_ID && frame->id < WP_HELLO_IDENTITY_ID + HELLO_PAGES) {
        return take_page(client, frame);
    }
    return is_valid(frame);
}

/* Whether a STEP_DONE is valid; `*is_logged` becomes whether it ended a step. */
static bool take_step_done(wheel_client *client, const wheel_packed *frame, bool *is_logged) {
    wp_step_done done;
    if (!wp_step_done_decode(frame->payload, frame->length, &done)) {
        return false;
    }
    *is_logged = ends_step(client, done.tick);
    return true;
}

size_t wheel_client_take(wheel_client *client, const uint8_t *packed, size_t begin, size_t end,
                         int64_t now_ns) {
    wheel_view *view = &client->view;
    wheel_packed frame;
    size_t at = begin;
    view->message_id = 0;
    while (wheel_packed_take(packed, at, end, &frame)) {
        const size_t size = frame.next - at;
        bool is_counted = frame.id < WP_HELLO_REQUEST_ID;
        bool is_logged = is_counted;
        if (!wheel_log_has_room(client, &client->received_log, size)) {
            return at;
        }
        if (take_snapshot(client, &frame, now_ns)) {
            /* the usual case */
        } else if (frame.id == WP_STEP_DONE_ID) {
            if (!take_step_done(client, &frame, &is_logged)) {
                view->out_of_range++;
                at = frame.next;
                continue;
            }
        } else if (take_other(client, &frame)) {
            view->message_id = frame.id;
            view->message_at = (uint32_t)at;
        } else {
            view->out_of_range++;
            at = frame.next;
            continue;
        }
        view->received += is_counted;
        if (is_logged) {
            wheel_log_add(client, &client->received_log, packed + at, size);
        }
        at = frame.next;
        if (view->message_id != 0u || view->step == WHEEL_STEP_ELSEWHERE) {
            return at;
        }
    }
    return at < end ? end : at; /* over a frame that is cut */
}
