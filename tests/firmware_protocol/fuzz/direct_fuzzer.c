/* Fuzzes a client and a robot in one thread: any frames wait and cross, in any order of calls. The same
 * frames as bytes of a line, to another robot, have to have the same effect. */
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/port/host/direct.h"
#include "check.h"
#include "wire_mutator.h"

/* The input begins with this many bytes: one for each call, then how often it holds the same frames. */
enum { CALLS = 12, REPEATS = CALLS, HEADER };
enum { EXCHANGE_ALONE, EXCHANGE, STEP, KINDS };
const size_t wire_header_size = HEADER;

#define MOST 16384u /* packed bytes that wait */

typedef struct {
    wheel_direct direct;
    wheel_line here;
    wheel_line there;
    wheel_line mirrored;
    wheel_client client;
    wheel_host *robot;
    wheel_host *other;
    uint8_t waiting[MOST];
    size_t waits;
    uint64_t given; /* frames */
    uint64_t heard;
} talk;

static const wheel_parameters BUILT_IN = {
    .counts_per_revolution = 4096.0f,
    .wheel_radius_m = 0.075f,
    .half_length_m = 0.3f,
    .half_width_m = 0.3f,
    .tracking_bandwidth_rad_s = 150.0f,
    .torque_limit_n_m = 5.0f,
    .torque_constant_n_m_a = 1.25f,
    .motor_resistance_ohm = 0.6f,
    .motor_inductance_h = 5e-4f,
    .current_limit_a = 20.0f,
    .current_bandwidth_rad_s = 1000.0f,
    .temperature_limit_degc = 120.0f,
    .overspeed_rad_s = 100.0f,
    .encoder_fault_s = 0.02f,
    .watchdog_s = 0.02f,
    .ramp_s = 0.02f,
    .feedback_period_s = 0.005f,
};

uint8_t wire_parameter_check(void) {
    return (uint8_t)(wheel_parameters_hash(&BUILT_IN) & 0xFFu);
}

static int still(void *context, const wheel_drive *drive, wheel_sense *sense) {
    (void)context, (void)drive;
    memset(sense, 0, sizeof *sense);
    return 0;
}

static wheel_host *new_robot(void) {
    wheel_host *robot = calloc(1, wheel_host_size());
    CHECK(robot != NULL);
    wheel_host_init(robot, &BUILT_IN, NULL, WHEEL_CAPABILITY_LOCKSTEP, WP_RESET_CAUSE_POWER_ON, still, NULL);
    return robot;
}

static uint64_t frames_of(const uint8_t *packed, size_t used) {
    uint64_t frames = 0;
    for (size_t at = 0; at < used; at += 3u + packed[at + 2u]) {
        CHECK(at + 3u + packed[at + 2u] <= used);
        frames++;
    }
    return frames;
}

static void hold(talk *t, const uint8_t *packed, size_t used) {
    uint8_t *copy = exactly(packed, used);
    wheel_direct_hold(&t->direct, t->robot, copy, used);
    free(copy);
    memcpy(t->waiting + t->waits, packed, used);
    t->waits += used;
    t->given += frames_of(packed, used);
    CHECK(t->direct.held_bytes <= sizeof t->direct.held);
    CHECK(frames_of(t->direct.held, t->direct.held_bytes) == t->direct.held_frames);
    CHECK(t->direct.sent_frames + t->direct.held_frames == t->given);
}

/* Gives the other robot the bytes of what waits and of what the client sent. */
static void mirror(talk *t) {
    const wheel_direct *direct = &t->direct;
    static uint8_t bytes[WHEEL_LINE_GROWTH * (MOST + WHEEL_CLIENT_OUT)];
    memcpy(t->waiting + t->waits, direct->stepped, direct->stepped_bytes);
    const size_t length =
        wheel_line_encode(&t->mirrored, t->waiting, t->waits + direct->stepped_bytes, bytes);
    wheel_host_feed(t->other, bytes, length);
    t->waits = 0;
    t->given += direct->stepped_frames;
    t->heard += direct->answer_frames;
    CHECK(direct->held_bytes == 0u && direct->held_frames == 0u && direct->held_line_bytes == 0u);
    CHECK(frames_of(direct->stepped, direct->stepped_bytes) == direct->stepped_frames);
    CHECK(frames_of(direct->answer, direct->answer_bytes) == direct->answer_frames);
    CHECK(direct->sent_frames == t->given && direct->received_frames == t->heard);
    CHECK(direct->sent_bytes >= length); /* all of it, so far */
    wheel_host_view here;
    wheel_host_view there;
    wheel_host_look(t->robot, &here);
    wheel_host_look(t->other, &there);
    CHECK(memcmp(&here, &there, sizeof here) == 0);
    while (wheel_host_take_bytes(t->other, bytes, sizeof bytes) > 0u) {
    }
}

static void call(talk *t, uint8_t choice) {
    const wheel_view *view = wheel_client_view(&t->client);
    const uint16_t ticks = choice / KINDS % 8u;
    switch (choice % KINDS) {
    case EXCHANGE_ALONE:
        wheel_direct_exchange(&t->direct, t->robot, NULL);
        CHECK(t->direct.stepped_bytes == 0u);
        break;
    case EXCHANGE:
        wheel_client_request(&t->client, WP_REQUEST_IDLE, 0);
        wheel_direct_exchange(&t->direct, t->robot, &t->client);
        CHECK(t->direct.stepped_frames == 1u && view->out_bytes == 0u);
        break;
    default: {
        const bool is_whole = wheel_direct_step(&t->direct, t->robot, &t->client, ticks, 0);
        CHECK(t->direct.stepped_frames == 1u && t->direct.answer_at <= t->direct.answer_bytes);
        CHECK(!is_whole || (view->step == WHEEL_STEP_DONE && t->direct.answer_at == t->direct.answer_bytes));
    }
    }
    mirror(t);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < HEADER) {
        return 0;
    }
    talk *t = calloc(1, sizeof *t);
    CHECK(t != NULL);
    wheel_line_init(&t->here);
    wheel_line_init(&t->there);
    wheel_line_init(&t->mirrored);
    wheel_client_init(&t->client, WP_MODE_SPEED, wire_parameter_check(), 7u);
    t->robot = new_robot();
    t->other = new_robot();
    t->direct.here = &t->here;
    t->direct.there = &t->there;
    const uint8_t *stream = data + HEADER;
    const size_t piece = (size - HEADER) / CALLS;
    wheel_line heard;
    wheel_line_init(&heard);
    for (size_t i = 0; i < CALLS; i++) {
        const size_t length = i + 1u < CALLS ? piece : size - HEADER - i * piece;
        uint8_t packed[1024 + WHEEL_LINE_OPEN];
        size_t used = 0;
        CHECK(length <= 1024u);
        wheel_line_feed(&heard, stream + i * piece, length, packed, &used);
        for (size_t repeat = data[REPEATS] % 16u + 1u;
             repeat > 0u && t->waits + used <= MOST - WHEEL_CLIENT_OUT; repeat--) {
            hold(t, packed, used);
        }
        call(t, data[i]);
    }
    free(t->robot);
    free(t->other);
    free(t);
    return 0;
}
