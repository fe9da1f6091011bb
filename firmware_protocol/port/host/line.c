#include "line.h"

#include "packed.h"

#include <math.h>
#include <string.h>

#define SEQUENCES (sizeof((wheel_snapshot *)0)->sequences)

_Static_assert(WHEEL_LINE_LONGEST >= 1u + WHEEL_FRAME_MAX, "a frame needs more room than is promised");
_Static_assert(WHEEL_LINE_OPEN >= WHEEL_FRAME_MAX, "what is open may be a whole frame but its zero");

struct wheel_line {
    wheel_deframer deframer;
    uint8_t sequence;
};

size_t wheel_line_size(void) {
    return sizeof(wheel_line);
}

void wheel_line_init(wheel_line *line) {
    wheel_deframer_init(&line->deframer);
    line->sequence = 0;
}

size_t wheel_line_feed(wheel_line *line, const uint8_t *bytes, size_t length, uint8_t *packed, size_t *used) {
    wheel_frame frame;
    size_t count = 0;
    uint8_t *out = packed;
    for (size_t i = 0; i < length; i++) {
        if (!wheel_deframer_feed(&line->deframer, bytes[i], &frame)) {
            continue;
        }
        out[0] = (uint8_t)(frame.id & 0xFFu);
        out[1] = (uint8_t)(frame.id >> 8);
        out[2] = frame.length;
        memcpy(out + WHEEL_PACKED_HEADER, frame.payload, frame.length);
        out += WHEEL_PACKED_HEADER + frame.length;
        count++;
    }
    *used = (size_t)(out - packed);
    return count;
}

size_t wheel_line_encode(wheel_line *line, uint16_t id, const uint8_t *payload, size_t length, uint8_t *out) {
    wheel_frame frame = {.id = id};
    if (length > sizeof frame.payload) {
        return 0;
    }
    frame.length = (uint8_t)length;
    memcpy(frame.payload, payload, length);
    /* An emergency stop is not to be lost behind half a frame that the line still holds. */
    const size_t cleared = id == WP_ESTOP_ID ? 1u : 0u;
    const size_t written = wheel_frame_encode(&frame, line->sequence, out + cleared);
    if (written == 0u) {
        return 0;
    }
    if (cleared > 0u) {
        out[0] = 0;
    }
    line->sequence++;
    return cleared + written;
}

void wheel_line_count(const wheel_line *line, wheel_line_counts *counts) {
    const wheel_deframer *deframer = &line->deframer;
    *counts = (wheel_line_counts){
        .frames = deframer->frames,
        .lost = deframer->lost,
        .cobs = deframer->cobs,
        .crc = deframer->crc,
        .length = deframer->length_errors,
        .unknown_id = deframer->unknown_id,
        .overrun = deframer->overruns,
    };
}

/* The parts in the order in which they are sent, as TICK.parts has them. */
enum { ENCODERS = 1, WHEEL_SPEEDS = 2, CURRENTS = 4, ACCELEROMETER = 8, GYRO = 16 };

struct wheel_reader {
    wheel_snapshot snapshot;
    wp_tick tick;
    uint8_t missing; /* parts; 0 when no snapshot is open */
    bool has_number;
    bool has_time;
    uint8_t number;
    uint32_t time_us;
    /* The parts of the open snapshot. */
    wp_encoders encoders;
    wp_wheel_speeds speeds;
    wp_currents currents;
    wp_accelerometer accelerometer;
    wp_gyro gyro;
};

size_t wheel_reader_size(void) {
    return sizeof(wheel_reader);
}

void wheel_reader_init(wheel_reader *reader) {
    memset(reader, 0, sizeof *reader);
    wheel_snapshot *s = &reader->snapshot;
    for (size_t i = 0; i < 4u; i++) {
        s->speed_rad_s[i] = s->current_a[i] = NAN;
    }
    s->acceleration_m_s2[0] = s->acceleration_m_s2[1] = s->acceleration_m_s2[2] = s->yaw_rate_rad_s = NAN;
}

const wheel_snapshot *wheel_reader_snapshot(const wheel_reader *reader) {
    return &reader->snapshot;
}

void wheel_reader_restart(wheel_reader *reader) {
    reader->missing = 0;
    reader->has_number = false;
    reader->has_time = false;
}

static void commit(wheel_reader *reader) {
    wheel_snapshot *s = &reader->snapshot;
    const wp_tick *tick = &reader->tick;
    const uint8_t parts = tick->parts;
    if ((parts & ENCODERS) != 0u) {
        const wp_encoders *e = &reader->encoders;
        memcpy(s->encoder_count, (uint16_t[4]){e->fl_count, e->fr_count, e->rr_count, e->rl_count}, 8u);
    }
    if ((parts & WHEEL_SPEEDS) != 0u) {
        const wp_wheel_speeds *w = &reader->speeds;
        memcpy(s->speed_rad_s, (float[4]){w->fl_rad_s, w->fr_rad_s, w->rr_rad_s, w->rl_rad_s}, 16u);
    }
    if ((parts & CURRENTS) != 0u) {
        const wp_currents *c = &reader->currents;
        memcpy(s->current_a, (float[4]){c->fl_a, c->fr_a, c->rr_a, c->rl_a}, 16u);
    }
    if ((parts & ACCELEROMETER) != 0u) {
        const wp_accelerometer *a = &reader->accelerometer;
        memcpy(s->acceleration_m_s2, (float[3]){a->x_m_s2, a->y_m_s2, a->z_m_s2}, 12u);
    }
    if ((parts & GYRO) != 0u) {
        s->yaw_rate_rad_s = reader->gyro.z_rad_s;
    }
    if (reader->has_time) {
        s->robot_time_us += (uint32_t)(tick->time_us - reader->time_us);
    } else {
        s->robot_time_us = tick->time_us;
    }
    reader->time_us = tick->time_us;
    reader->has_time = true;
    s->state = tick->state;
    s->command_sequence = tick->sequence;
    s->command_age_ms = tick->command_age_ms;
    s->completed++;
    s->slow += (parts & (CURRENTS | ACCELEROMETER | GYRO)) != 0u;
}

static void open_snapshot(wheel_reader *reader, const wp_tick *tick) {
    wheel_snapshot *s = &reader->snapshot;
    s->incomplete += reader->missing != 0u;
    if (reader->has_number) {
        const uint8_t missing = (uint8_t)(tick->snapshot - reader->number - 1u);
        /* Half the circle or more is a repeated TICK, one that was overtaken, or a robot that began anew. */
        s->lost += missing < 128u ? missing : 0u;
    }
    s->newest_sequence = s->sequences[s->ticks % SEQUENCES] = tick->sequence;
    s->ticks++;
    reader->number = tick->snapshot;
    reader->has_number = true;
    reader->tick = *tick;
    reader->missing = tick->parts;
}

/* The inertial sensors' parts say themselves when they were sampled. */
static bool belongs(const wheel_reader *reader, uint16_t sampled) {
    return sampled == (uint16_t)(reader->tick.time_us / 1000u);
}

static void take_part(wheel_reader *reader, uint8_t part, bool belongs_to_it) {
    const uint8_t missing = reader->missing;
    if (missing == 0u) {
        return;
    }
    const uint8_t turn = (uint8_t)(missing & (0u - missing)); /* the lowest bit */
    if (part != turn || !belongs_to_it) {
        reader->missing = 0;
        reader->snapshot.incomplete++;
        return;
    }
    reader->missing = (uint8_t)(missing & ~part);
    if (reader->missing == 0u) {
        commit(reader);
    }
}

/* False for what is no valid message of a snapshot, and no STEP_DONE. */
static bool take_frame(wheel_reader *reader, uint16_t id, const uint8_t *payload, size_t length) {
    wp_tick tick;
    wp_step_done done;
    switch (id) {
    case WP_STEP_DONE_ID:
        if (!wp_step_done_decode(payload, length, &done)) {
            return false;
        }
        reader->snapshot.step_done_tick = done.tick;
        reader->snapshot.steps_done++;
        return true;
    case WP_TICK_ID:
        if (!wp_tick_decode(payload, length, &tick)) {
            return false;
        }
        open_snapshot(reader, &tick);
        return true;
    case WP_ENCODERS_ID:
        if (!wp_encoders_decode(payload, length, &reader->encoders)) {
            return false;
        }
        take_part(reader, ENCODERS, true);
        return true;
    case WP_WHEEL_SPEEDS_ID:
        if (!wp_wheel_speeds_decode(payload, length, &reader->speeds)) {
            return false;
        }
        take_part(reader, WHEEL_SPEEDS, true);
        return true;
    case WP_CURRENTS_ID:
        if (!wp_currents_decode(payload, length, &reader->currents)) {
            return false;
        }
        take_part(reader, CURRENTS, true);
        return true;
    case WP_ACCELEROMETER_ID:
        if (!wp_accelerometer_decode(payload, length, &reader->accelerometer)) {
            return false;
        }
        take_part(reader, ACCELEROMETER, belongs(reader, reader->accelerometer.tick));
        return true;
    case WP_GYRO_ID:
        if (!wp_gyro_decode(payload, length, &reader->gyro)) {
            return false;
        }
        take_part(reader, GYRO, belongs(reader, reader->gyro.tick));
        return true;
    default:
        return false;
    }
}

size_t wheel_reader_take(wheel_reader *reader, const uint8_t *packed, size_t begin, size_t end) {
    size_t at = begin;
    const uint32_t ticks = reader->snapshot.ticks;
    wheel_packed frame;
    while (reader->snapshot.ticks - ticks < SEQUENCES && wheel_packed_take(packed, at, end, &frame)) {
        if (!take_frame(reader, frame.id, frame.payload, frame.length)) {
            break;
        }
        reader->snapshot.frames++;
        at = frame.next;
        if (frame.id == WP_STEP_DONE_ID) {
            break;
        }
    }
    return at;
}
