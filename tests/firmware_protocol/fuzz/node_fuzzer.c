/* Fuzzes the robot: a stream of the serial line into the firmware core, with a plant that may fail, starting
 * in IDLE, ARMED or ACTIVE. After every call of the core this file checks what has to hold whatever comes in.
 * It reads the protocol by itself: what may arm or keep the robot going is not asked of the code under test.
 */
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/firmware/node.h"
#include "check.h"
#include "wire_mutator.h"

/* The input begins with this many bytes of choices; the rest is the line. */
enum { START, BYTES_A_TICK, PLANT_FAULT, FAULT_WHEEL, FAULT_FROM, FAULT_TICKS, PARAMETER, WHICH_END, HEADER };
const size_t wire_header_size = HEADER;

#define START_ARMED 1u
#define START_SPEED 2u
#define START_TORQUE 3u
#define START_KIND 3u
#define WITH_LOCKSTEP 4u
#define WITHOUT_SLOW_PARTS 8u
#define SLOW_SENDER 16u /* the robot's line takes a frame a tick: its queue overflows */
#define UNTIL_GIVEN_UP                                                                                       \
    31u /* START / 8: goes on in silence until the wheels are given up on; rare, as it is slow */

#define TICKS_MAX 300u
#define INERTIA_KG_M2 0.033f
#define TICK_S 0.001f
#define COUNTS_A_RAD 651.9f

static const wheel_parameters BUILT_IN = {
    .counts_per_revolution = 4096.0f,
    .wheel_radius_m = 0.075f,
    .half_length_m = 0.3f,
    .half_width_m = 0.3f,
    .tracking_bandwidth_rad_s = 150.0f,
    .speed_kp_n_m_s_rad = 1.1f,
    .speed_ki_n_m_rad = 25.0f,
    .torque_limit_n_m = 5.0f,
    .torque_constant_n_m_a = 1.25f,
    .motor_resistance_ohm = 0.6f,
    .motor_inductance_h = 5e-4f,
    .current_limit_a = 20.0f,
    .current_bandwidth_rad_s = 1000.0f,
    .temperature_limit_degc = 120.0f,
    .undervoltage_v = 10.0f,
    .overspeed_rad_s = 100.0f,
    .encoder_fault_s = 0.02f,
    .watchdog_s = 0.02f,
    .ramp_s = 0.02f,
    .feedback_period_s = 0.005f,
};

typedef struct {
    const uint8_t *choice;
    wheel_node node;
    wheel_deframer deframer;
    wheel_drive drive;
    wheel_sense sense;
    uint8_t stored[WHEEL_STORED_SIZE];

    float angle_rad[WHEEL_COUNT];
    float speed_rad_s[WHEEL_COUNT];

    uint32_t silent_ticks; /* since the last command that may keep the robot going */
    uint8_t last_sequence;
    uint16_t announced; /* nonce of an IDLE request that holds */
    uint32_t ticks;
} robot;

uint8_t wire_parameter_check(void) {
    return (uint8_t)(wheel_parameters_hash(&BUILT_IN) & 0xFFu);
}

/* The state table again, as PROTOCOL.md tells it: bit n of a row allows state n to follow. */
static bool may_follow(uint8_t from, uint8_t to) {
    static const uint8_t after[] = {
        [WP_STATE_IDLE] = 1u << WP_STATE_ARMED | 1u << WP_STATE_FAULT | 1u << WP_STATE_ESTOP,
        [WP_STATE_ARMED] =
            1u << WP_STATE_IDLE | 1u << WP_STATE_ACTIVE | 1u << WP_STATE_FAULT | 1u << WP_STATE_ESTOP,
        [WP_STATE_ACTIVE] = 1u << WP_STATE_STOPPING | 1u << WP_STATE_FAULT | 1u << WP_STATE_ESTOP,
        [WP_STATE_STOPPING] = 1u << WP_STATE_IDLE | 1u << WP_STATE_FAULT | 1u << WP_STATE_ESTOP,
        [WP_STATE_FAULT] = 1u << WP_STATE_IDLE | 1u << WP_STATE_ESTOP,
        [WP_STATE_ESTOP] = 1u << WP_STATE_IDLE,
    };
    return from == to || (after[from] & 1u << to) != 0u;
}

static void check_counters(const wheel_node *before, const wheel_node *after) {
    uint32_t old[sizeof(wheel_rejections) / sizeof(uint32_t)];
    uint32_t now[sizeof old / sizeof old[0]];
    memcpy(old, &before->rejections, sizeof old);
    memcpy(now, &after->rejections, sizeof now);
    for (size_t i = 0; i < sizeof old / sizeof old[0]; i++) {
        CHECK(now[i] >= old[i] && now[i] <= old[i] + 2u);
    }
    CHECK(after->limited_ticks >= before->limited_ticks);
    CHECK(after->transmit_overruns >= before->transmit_overruns);
}

static void check_always(const wheel_node *before, const wheel_node *after) {
    CHECK(may_follow(before->state, after->state));
    CHECK(after->queue_count <= WHEEL_TRANSMIT_QUEUE);
    if (memcmp(&before->parameters, &after->parameters, sizeof before->parameters) != 0) {
        CHECK(before->state == WP_STATE_IDLE && after->state == WP_STATE_IDLE);
        CHECK(wheel_parameters_invalid(&after->parameters) < 0);
    }
    check_counters(before, after);
}

/* What a frame says when it is a wheel command of the mode in force. */
static bool command_of(const wheel_frame *frame, uint8_t mode, wp_wheel_command *m) {
    const uint16_t id = mode == WP_MODE_SPEED ? WP_WHEEL_COMMAND_ID : WP_TORQUE_COMMAND_ID;
    /* Both have the same bits, but for the scale. */
    return frame->id == id && wp_wheel_command_decode(frame->payload, frame->length, m);
}

/* True when the protocol lets this frame feed the watchdog. */
static bool may_feed(const robot *r, const wheel_frame *frame) {
    wp_wheel_command m;
    if (!command_of(frame, r->node.mode, &m) || m.session != (r->node.session_nonce & 0xFu)) {
        return false;
    }
    if (r->node.state == WP_STATE_ARMED) {
        return m.fl_rad_s == 0.0f && m.fr_rad_s == 0.0f && m.rr_rad_s == 0.0f && m.rl_rad_s == 0.0f;
    }
    const uint8_t ahead = (uint8_t)(m.sequence - r->last_sequence);
    return r->node.state == WP_STATE_ACTIVE && ahead >= 1u && ahead <= 20u;
}

/* True when the protocol lets this frame arm. */
static bool may_arm(const robot *r, const wheel_frame *frame) {
    wp_host_heartbeat m;
    const wheel_node *node = &r->node;
    return frame->id == WP_HOST_HEARTBEAT_ID && wp_host_heartbeat_decode(frame->payload, frame->length, &m) &&
           m.request == WP_REQUEST_ARM && node->state == WP_STATE_IDLE && m.nonce == r->announced &&
           m.nonce != node->session_nonce && m.schema_hash == WP_SCHEMA_HASH &&
           (node->session_nonce == 0u || (m.nonce & 0xFu) != (node->session_nonce & 0xFu)) &&
           m.parameter_check == (wheel_parameters_hash(&node->parameters) & 0xFFu);
}

static void follow_announcements(robot *r, const wheel_frame *frame, uint8_t state_before, bool repeated) {
    wp_host_heartbeat m;
    if (r->node.state != state_before) {
        r->announced = 0u;
    }
    if (frame->id == WP_HOST_HEARTBEAT_ID && wp_host_heartbeat_decode(frame->payload, frame->length, &m)) {
        if (m.request == WP_REQUEST_IDLE && r->node.state == WP_STATE_IDLE) {
            r->announced = m.nonce;
        } else if (m.request == WP_REQUEST_ARM && !repeated) {
            r->announced = 0u;
        }
    }
}

static void take(robot *r, const wheel_frame *frame) {
    const wheel_node before = r->node;
    wp_wheel_command command = {0};
    wp_host_heartbeat heartbeat = {0};
    const bool feeds = may_feed(r, frame);
    const bool arms = may_arm(r, frame);
    const bool repeated = wp_host_heartbeat_decode(frame->payload, frame->length, &heartbeat) &&
                          (before.state == WP_STATE_ARMED || before.state == WP_STATE_ACTIVE) &&
                          heartbeat.nonce == before.session_nonce;
    wheel_node_receive(&r->node, frame, r->node.tick * 1000u + 17u);
    check_always(&before, &r->node);
    CHECK(arms == (before.state == WP_STATE_IDLE && r->node.state == WP_STATE_ARMED));
    CHECK(feeds == (r->node.setting.age_ticks == 0u &&
                    (before.setting.age_ticks != 0u || before.setting.sequence != r->node.setting.sequence ||
                     (before.state == WP_STATE_ARMED && r->node.state == WP_STATE_ACTIVE))));
    if (feeds) {
        CHECK(r->node.state == WP_STATE_ACTIVE);
        (void)command_of(frame, r->node.mode, &command);
        r->last_sequence = command.sequence;
        r->silent_ticks = 0u;
    } else {
        CHECK(memcmp(&before.setting, &r->node.setting, sizeof before.setting) == 0 || arms);
    }
    if (before.state == WP_STATE_FAULT || before.state == WP_STATE_ESTOP) {
        /* These latch: only a CLEAR with a new nonce or an ESTOP does anything. */
        CHECK(r->node.state == before.state || frame->id == WP_ESTOP_ID ||
              (heartbeat.request == WP_REQUEST_CLEAR && heartbeat.nonce != before.cleared_nonce));
    }
    follow_announcements(r, frame, before.state, repeated);
    if (wheel_node_store_pending(&r->node, r->stored)) {
        wheel_parameters kept;
        CHECK(wheel_parameters_load(&kept, NULL, 0u, r->stored));
        wheel_node_stored(&r->node, (r->choice[START] & SLOW_SENDER) == 0u);
    }
}

static bool is_between(float x, float limit) {
    return x >= -limit && x <= limit; /* false for NaN */
}

static void check_drive(const robot *r, const wheel_node *before) {
    const wheel_node *node = &r->node;
    const wheel_parameters *p = &node->parameters;
    const bool may_drive = before->state == WP_STATE_ACTIVE || before->state == WP_STATE_STOPPING ||
                           (before->state == WP_STATE_ESTOP && before->braking);
    const float by_current = p->torque_constant_n_m_a * p->current_limit_a;
    const float limit = by_current < p->torque_limit_n_m ? by_current : p->torque_limit_n_m;
    const uint32_t watchdog = (uint32_t)(p->watchdog_s * 1000.0f + 0.5f);
    const uint32_t ramp = (uint32_t)(p->ramp_s * 1000.0f + 0.5f);
    CHECK(node->state == before->state && node->tick == before->tick + 1u);
    CHECK(r->drive.tick == before->tick);
    CHECK(r->drive.enabled <= (may_drive ? 1u : 0u));
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        CHECK(is_between(r->drive.torque_n_m[i], r->drive.enabled != 0u ? limit : 0.0f));
        CHECK(is_between(r->drive.duty[i], r->drive.enabled != 0u ? 1.0f : 0.0f));
        CHECK(r->silent_ticks < watchdog + ramp || node->set_point_rad_s[i] == 0.0f);
        CHECK(may_drive || node->set_point_rad_s[i] == 0.0f);
    }
    CHECK(node->state != WP_STATE_ACTIVE || r->silent_ticks < watchdog);
    /* An ESTOP in the last tick of a stop begins to brake anew. */
    CHECK(r->silent_ticks < watchdog + ramp + 2u * WHEEL_STOP_LIMIT_TICKS || r->drive.enabled == 0u);
}

/* Free wheels on a stand, and what a plant can do wrong. */
static void move_plant(robot *r) {
    const size_t wheel = r->choice[FAULT_WHEEL] % WHEEL_COUNT;
    const bool failing = r->ticks >= r->choice[FAULT_FROM] &&
                         r->ticks < (uint32_t)r->choice[FAULT_FROM] + r->choice[FAULT_TICKS];
    const uint8_t kind = failing ? r->choice[PLANT_FAULT] % 16u : 0u;
    wheel_sense *sense = &r->sense;
    const float extreme = (r->choice[FAULT_WHEEL] & 4u) != 0u ? 3.0e38f : -1.0e30f;
    sense->tick = r->node.tick;
    sense->battery_v = kind == 1u ? 9.0f : (kind == 2u ? extreme : 24.0f);
    sense->battery_a = kind == 3u ? extreme : 1.0f;
    for (size_t i = 0; i < 3u; i++) {
        sense->gyro_rad_s[i] = kind == 4u ? extreme * 10.0f : 0.0f;
        sense->acceleration_m_s2[i] = kind == 5u ? extreme : 9.81f;
    }
    for (size_t i = 0; i < WHEEL_COUNT; i++) {
        const bool here = i == wheel;
        r->speed_rad_s[i] += r->drive.torque_n_m[i] / INERTIA_KG_M2 * TICK_S;
        r->speed_rad_s[i] = here && kind == 6u ? 0.0f : r->speed_rad_s[i];
        r->speed_rad_s[i] = here && kind == 7u ? 60.0f : r->speed_rad_s[i];
        r->angle_rad[i] += r->speed_rad_s[i] * TICK_S;
        const int32_t counts = (int32_t)(r->angle_rad[i] * COUNTS_A_RAD);
        sense->count[i] = (uint16_t)((here && kind == 8u) ? -counts : counts);
        sense->count[i] = here && kind == 9u ? 0u : sense->count[i];
        sense->count[i] = here && kind == 10u ? (uint16_t)(r->ticks * 40503u) : sense->count[i];
        sense->current_a[i] = r->drive.torque_n_m[i] / BUILT_IN.torque_constant_n_m_a;
        sense->current_a[i] = here && kind == 11u ? 31.0f : sense->current_a[i];
        sense->current_a[i] = here && kind == 12u ? extreme : sense->current_a[i];
        sense->temperature_degc[i] = here && kind == 13u ? 110.0f + (float)(r->ticks % 16u) : 25.0f;
        sense->temperature_degc[i] = here && kind == 14u ? extreme : sense->temperature_degc[i];
    }
    if (kind == 15u) {
        wheel_node_fail(&r->node);
    }
}

/* What the robot sends is what a host can read. */
#define READ(NAME, name)                                                                                     \
    case WP_##NAME##_ID: {                                                                                   \
        wp_##name message;                                                                                   \
        CHECK(wp_##name##_decode(frame.payload, frame.length, &message));                                    \
        break;                                                                                               \
    }

static void send(robot *r) {
    wheel_frame frame;
    uint32_t room = (r->choice[START] & SLOW_SENDER) != 0u ? 1u : UINT32_MAX;
    while (room > 0u && wheel_node_transmit(&r->node, &frame, r->node.tick * 1000u)) {
        room--;
        switch (frame.id) {
            WP_MESSAGES(READ)
        default:
            CHECK(false);
        }
    }
}

static void tick(robot *r) {
    wheel_node before = r->node;
    wheel_node_drive(&r->node, &r->drive);
    check_always(&before, &r->node);
    check_drive(r, &before);
    r->silent_ticks++;
    r->ticks++;
    before = r->node;
    move_plant(r);
    CHECK(may_follow(before.state, r->node.state));
    before = r->node;
    wheel_node_sense(&r->node, &r->sense);
    check_always(&before, &r->node);
    CHECK(r->node.state != WP_STATE_ACTIVE || before.state == WP_STATE_ACTIVE);
    CHECK(r->node.state != WP_STATE_ARMED || before.state == WP_STATE_ARMED);
    if (before.state != r->node.state) {
        r->announced = 0u;
    }
    send(r);
}

static void feed(robot *r, uint8_t byte) {
    wheel_frame frame;
    uint32_t ticks;
    if (!wheel_deframer_feed(&r->deframer, byte, &frame)) {
        return;
    }
    take(r, &frame);
    if (wheel_node_step_pending(&r->node, &ticks)) {
        CHECK((r->choice[START] & WITH_LOCKSTEP) != 0u);
        for (uint32_t i = 0; i < ticks && r->ticks < TICKS_MAX; i++) {
            tick(r);
        }
        wheel_node_step_done(&r->node);
        send(r);
    }
}

static void say(robot *r, uint16_t id, const uint8_t *payload) {
    wheel_frame frame = {.id = id, .length = (uint8_t)wp_payload_length(id)};
    memcpy(frame.payload, payload, frame.length);
    take(r, &frame);
}

static void begin_in(robot *r, uint8_t kind) {
    uint8_t payload[WP_PAYLOAD_MAX];
    const uint8_t mode = kind == START_TORQUE ? WP_MODE_TORQUE : WP_MODE_SPEED;
    wp_host_heartbeat m = {.nonce = 0x1231u, .schema_hash = WP_SCHEMA_HASH, .mode = mode};
    m.parameter_check = (uint8_t)(wheel_parameters_hash(&r->node.parameters) & 0xFFu);
    for (m.request = WP_REQUEST_IDLE; m.request <= WP_REQUEST_ARM; m.request++) {
        CHECK(wp_host_heartbeat_encode(&m, payload));
        say(r, WP_HOST_HEARTBEAT_ID, payload);
    }
    CHECK(r->node.state == WP_STATE_ARMED);
    if (kind != START_ARMED) {
        const wp_wheel_command zero = {.session = 1u};
        CHECK(wp_wheel_command_encode(&zero, payload));
        say(r, mode == WP_MODE_SPEED ? WP_WHEEL_COMMAND_ID : WP_TORQUE_COMMAND_ID, payload);
        CHECK(r->node.state == WP_STATE_ACTIVE);
    }
}

static void begin(robot *r, const uint8_t *choice) {
    wheel_parameters parameters = BUILT_IN;
    const size_t index = choice[PARAMETER];
    if (index < WHEEL_PARAMETER_COUNT) {
        const wheel_parameter_info *info = &wheel_parameter_table[index];
        CHECK(wheel_parameter_set(&parameters, NULL, index,
                                  (choice[WHICH_END] & 1u) != 0u ? info->maximum : info->minimum));
    }
    wheel_identity identity = {.capabilities = 0x07FCu};
    identity.capabilities |= (choice[START] & WITH_LOCKSTEP) != 0u ? WHEEL_CAPABILITY_LOCKSTEP : 0u;
    if ((choice[START] & WITHOUT_SLOW_PARTS) != 0u) {
        identity.capabilities &= WHEEL_CAPABILITY_LOCKSTEP | WHEEL_CAPABILITY_SPEED | WHEEL_CAPABILITY_TORQUE;
    }
    memset(r, 0, sizeof *r);
    r->choice = choice;
    r->silent_ticks = UINT32_MAX / 2u;
    wheel_deframer_init(&r->deframer);
    wheel_node_init(&r->node, &parameters, NULL, &identity);
    CHECK(r->node.state == WP_STATE_IDLE);
    r->sense.battery_v = 24.0f;
    wheel_node_sense(&r->node, &r->sense);
    if ((choice[START] & START_KIND) != 0u && r->node.state == WP_STATE_IDLE) {
        begin_in(r, choice[START] & START_KIND);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    robot r;
    if (size < HEADER) {
        return -1;
    }
    begin(&r, data);
    const uint32_t bytes_a_tick = 1u + data[BYTES_A_TICK] % 64u;
    for (size_t i = HEADER; i < size && r.ticks < TICKS_MAX; i++) {
        feed(&r, data[i]);
        if (i % bytes_a_tick == 0u) {
            tick(&r);
        }
    }
    /* Silence: whatever was sent before, the set point goes to zero, and the drives off. */
    const uint32_t stop = wheel_ticks(r.node.parameters.watchdog_s) + wheel_ticks(r.node.parameters.ramp_s);
    const uint32_t rest = data[START] / 8u == UNTIL_GIVEN_UP ? 2u * WHEEL_STOP_LIMIT_TICKS : 0u;
    for (uint32_t i = 0; i < stop + rest + 2u; i++) {
        tick(&r);
    }
    return 0;
}
