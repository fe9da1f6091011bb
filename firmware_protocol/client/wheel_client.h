/* The host's half of the wheel-command protocol (PROTOCOL.md), without I/O, allocation or static data.
 *
 * A client takes the frames that a robot sends and keeps what they say in one struct, `wheel_view`. It
 * makes the frames that the robot is to get. How frames travel is the caller's matter:
 *
 *     CAN      one frame is one CAN frame: its id, and its payload of up to 8 bytes
 *     serial   `wheel_line` (wheel_line.h) turns frames into bytes, and bytes into frames
 *
 * Frames are packed one after the other: id16 little-endian, length8, payload. A program that drives a
 * robot calls wheel_client_init and wheel_client_begin, and then this once a period, with the time of any
 * clock that does not jump [ns]:
 *
 *     wheel_client_take(client, packed, 0, used, now_ns)   what has arrived; again while it stops early
 *     wheel_client_poll(client, now_ns)                    HELLO and heartbeat, when they are due
 *     wheel_client_arm(client, now_ns)                     until it returns WHEEL_ARMING_DONE
 *     wheel_client_command(client, speed, torque, now_ns)  from then on
 *     wheel_client_out(client), wheel_client_sent(client)  the frames to send
 *
 * and ends with wheel_client_request(client, WP_REQUEST_IDLE, now_ns). The robot stops by itself when no
 * command comes (HELLO_PARAMETERS.watchdog_ms). docs/examples/drive.c is such a program.
 *
 * The host's session, and what changes it:
 *
 *     greeted    the robot has answered HELLO with all its pages, and has our protocol's version
 *     request    what each heartbeat asks for: IDLE, ARM or CLEAR
 *     heartbeat  when the next one is due; none before the first request, so that a host that only
 *                listens disarms nobody
 *     nonce      the number of this session; a robot refuses a number that it has seen before
 *
 *     call                          greeted   request         heartbeat     nonce
 *     HELLO answered                yes       -               -             -
 *     wheel_client_leave            no        IDLE            none          -
 *     wheel_client_begin            no        IDLE            none          the given one
 *     wheel_client_renew            -         IDLE            as before     the given one
 *     wheel_client_request          -         the given one   every 0.1 s   -
 *     wheel_client_estop            -         IDLE            as before     -
 *     wheel_client_arm, robot IDLE  -         IDLE, then ARM  every 0.1 s   -
 *
 * The robot arms on the change from IDLE to ARM, so IDLE is always sent first.
 *
 * A client without a log may be copied and moved. It is used by one thread at a time.
 */
#ifndef WHEEL_CLIENT_H
#define WHEEL_CLIENT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../generated/wheel_messages.h"

#ifdef __cplusplus
extern "C" {
#endif

/* cffi: begin */
/* What is known of the robot: read it, never write it. Wheels are in the order FL, FR, RR, RL. The first part
 * is the newest snapshot of feedback: all its values are of one sampling instant, except those that come at a
 * lower rate. */
typedef struct {
    uint64_t robot_time_us; /* the robot's clock at that instant; does not wrap after the first snapshot */
    int64_t feedback_ns;    /* when it was complete, by the clock of wheel_client_take: the age of feedback */
    int64_t round_trip_ns;  /* newest time from a command to the first TICK that reports it in force */
    float speed_rad_s[4];
    uint16_t encoder_count[4];
    uint8_t state;            /* enum wp_state */
    uint8_t command_sequence; /* of the command in force, and its age */
    uint8_t command_age_ms;
    bool has_feedback; /* whether a snapshot came since wheel_client_leave; if not, these are old */
    uint32_t snapshots;
    uint32_t round_trips; /* how many there were */

    /* At a lower rate: these hold their last value, and are NaN before the first. */
    float current_a[4];
    float acceleration_m_s2[3]; /* body frame: forward, left, up */
    float yaw_rate_rad_s;

    /* Lockstep: the robot's tick after the newest STEP, and how that went. */
    uint32_t tick;
    uint32_t step_target;    /* the tick that STEP asks for; with 0 ticks any is right */
    uint32_t step_done_tick; /* of the newest STEP_DONE */
    uint8_t step;            /* WHEEL_STEP_... */

    /* The session. */
    bool is_greeted;
    uint8_t request; /* enum wp_request */
    bool log_is_due; /* a log, or `round_trips_ns`, is filling up: wheel_client_log_take */
    uint16_t nonce;
    /* wheel_client_take has stopped behind this message, which began at `message_at`; 0 if behind none. */
    uint16_t message_id;
    uint32_t message_at;

    /* Counts. A snapshot is lost if its number never came (128 and more in a row are not noticed), and
     * incomplete if one of its messages is missing. HELLO is not counted. */
    uint32_t lost;
    uint32_t incomplete;
    uint32_t out_of_range; /* frames dropped because a value is out of its range */
    uint64_t sent;
    uint64_t received;

    /* The frames that wait to be sent: wheel_client_out. */
    uint32_t out_bytes; /* packed */
    uint32_t out_frames;
    uint32_t out_serial_bytes; /* as bytes of a serial line */

    /* The newest 256 round trips, number n at n modulo 256. */
    int64_t round_trips_ns[256];
} wheel_view;

#define WHEEL_STEP_NONE 0      /* no STEP was sent */
#define WHEEL_STEP_AWAITED 1   /* not answered yet */
#define WHEEL_STEP_DONE 2      /* answered with the expected tick */
#define WHEEL_STEP_ELSEWHERE 3 /* answered with another tick: the robot was reset, or has another host */

/* What wheel_client_arm found, and did. */
#define WHEEL_ARMING_DONE 0  /* the robot is ACTIVE in our session */
#define WHEEL_ARMING_WAIT 1  /* wait for the robot, or for the end of another host's session */
#define WHEEL_ARMING_HOLD 2  /* it is ARMED; zero commands were sent, of which the first makes it ACTIVE */
#define WHEEL_ARMING_ASKED 3 /* IDLE and ARM were sent */
#define WHEEL_ARMING_NEW_NONCE 4 /* it knows this nonce: call wheel_client_renew with another, then again */
#define WHEEL_ARMING_STRANGER 5  /* it has not answered HELLO */
#define WHEEL_ARMING_REFUSED 6   /* it refuses for a reason that no nonce changes: STATUS.arm_refusal */
#define WHEEL_ARMING_LATCHED 7   /* it is in FAULT or ESTOP: STATUS has the cause */

typedef struct wheel_client wheel_client;

size_t wheel_client_size(void);

/* Begins with a robot of which nothing is known. `mode` is enum wp_mode, and `parameter_check` the lowest 8
 * bits of the parameter hash that the robot has to have. */
void wheel_client_init(wheel_client *client, uint8_t mode, uint8_t parameter_check, uint16_t nonce);

/* Sets which wheel, 0 to 3 in the order of wheel_view, each of the robot's channels drives, and its
 * direction, 1 or -1. Commands and feedback are of wheels; frames are of channels. Before it the wheels are
 * the channels. Returns false, and changes nothing, unless each wheel is there once. */
bool wheel_client_wire(wheel_client *client, const uint8_t wheel_of_channel[4],
                       const int8_t sign_of_channel[4]);

/* The view of a client: the same address for as long as it lives. */
const wheel_view *wheel_client_view(const wheel_client *client);

/* Takes packed frames from offset `begin` on; returns where the next one begins, or `end`. It stops behind
 * each message that is no part of a snapshot, and tells its id, so that the caller can look at it; a frame
 * that is no valid message is dropped. It also stops, without a message, before a log would overflow, and
 * goes on once wheel_client_log_take was called; and behind each frame while `step` is
 * WHEEL_STEP_ELSEWHERE. */
size_t wheel_client_take(wheel_client *client, const uint8_t *packed, size_t begin, size_t end,
                         int64_t now_ns);

/* Adds what is due to the frames to send: HELLO every 0.2 s until it is answered, and the heartbeat. Returns
 * whether something was. */
bool wheel_client_poll(wheel_client *client, int64_t now_ns);

/* Takes the next step towards ACTIVE, and returns it. */
uint8_t wheel_client_arm(wheel_client *client, int64_t now_ns);

/* Adds a command, and returns its sequence number. In SPEED mode: four speeds [rad/s], and torques [N.m] as
 * feedforward, which are sent if one is not zero; in TORQUE mode the torques only. Returns -1, and adds
 * nothing, when a value is NaN or cannot be sent. */
int wheel_client_command(wheel_client *client, const double speed_rad_s[4], const double torque_n_m[4],
                         int64_t now_ns);

/* Sets what the heartbeats ask for (enum wp_request), and adds the first one; with a negative time no other
 * follows. Returns false, and changes nothing, if there is no room; IDLE then takes the place of all that
 * waits. */
bool wheel_client_request(wheel_client *client, uint8_t request, int64_t now_ns);

/* Adds ESTOP: the robot stops at once and stays in ESTOP. Without room it takes the place of all that waits.
 */
void wheel_client_estop(wheel_client *client);

/* Adds one message of another kind: HELLO_REQUEST, TIME_SYNC_REQUEST, or one for a robot's parameters. */
bool wheel_client_add(wheel_client *client, uint16_t id, const uint8_t *payload, size_t length);

/* Lockstep: adds a STEP of so many ticks, at most 1000, from `view.tick` on; 0 asks for the robot's tick.
 * Returns false, and changes nothing, for more ticks or without room. */
bool wheel_client_step(wheel_client *client, uint16_t ticks);

/* Adds the same STEP again, because no answer came. A robot that has done it only repeats its answer. Returns
 * whether there was room. */
bool wheel_client_step_again(wheel_client *client);

/* Leaves the robot, because the link or the robot was lost. */
void wheel_client_leave(wheel_client *client);

/* Leaves the robot, and begins anew with one that may have been reset, or may be another. */
void wheel_client_begin(wheel_client *client, uint16_t nonce);

/* Sets the check of the parameters that the robot has to have, before it is armed. */
void wheel_client_expect(wheel_client *client, uint8_t parameter_check);

/* Begins another session with the same robot. */
void wheel_client_renew(wheel_client *client, uint16_t nonce);

/* The packed frames that wait to be sent, `view.out_bytes` of them: the same address for as long as the
 * client lives. What does not fit into WHEEL_CLIENT_OUT bytes is not added. */
const uint8_t *wheel_client_out(const wheel_client *client);
#define WHEEL_CLIENT_OUT 1024

/* Says what became of these frames: they were sent, or they were not, and are no longer counted and logged.
 * Both forget them. */
void wheel_client_sent(wheel_client *client);
void wheel_client_unsent(wheel_client *client);

/* Keeps a log of both directions in two buffers of `capacity` bytes each, at least 2 * WHEEL_CLIENT_OUT: the
 * packed frames in order, without HELLO and repeated STEPs, whose number depends on the wall clock. Two runs
 * with the same log had the same session. */
void wheel_client_log(wheel_client *client, uint8_t *sent, uint8_t *received, size_t capacity);

/* Forgets what the logs hold; `bytes` becomes how much that was, sent and received. Read the newest round
 * trips before it. To be called while no frame waits to be sent: what waits is in the log already. */
void wheel_client_log_take(wheel_client *client, size_t bytes[2]);
/* cffi: end */

/* STATUS and the robot's answer to HELLO, as they came. */
typedef struct {
    wp_hello_identity identity;
    wp_hello_firmware firmware;
    wp_hello_parameters parameters;
    wp_hello_geometry geometry;
    wp_hello_limits limits;
} wheel_robot;

typedef struct {
    uint8_t *bytes;
    size_t used;
} wheel_log;

/* Complete here so that it can be a variable or a member. Only `view`, `robot` and `status` are for others,
 * and only to be read. */
struct wheel_client {
    wheel_view view;
    wheel_robot robot;
    wp_status status; /* valid if has_status */
    bool has_status;

    uint8_t wheel_of_channel[4];
    int8_t sign_of_channel[4];
    uint8_t mode;
    uint8_t parameter_check;
    uint8_t sequence;
    uint8_t pages;  /* of HELLO, a bit each */
    bool is_asking; /* for HELLO */
    bool has_heartbeat;
    int64_t heartbeat_ns; /* when the next one is due */
    int64_t hello_ns;
    uint32_t step_from;
    uint16_t step_ticks;
    uint32_t steps_sent; /* how often the newest STEP was sent */
    uint32_t steps_owed; /* duplicate answers to earlier STEPs that may still come */

    /* The snapshot whose parts are coming. */
    wp_tick open;
    uint8_t missing; /* parts; 0 when none is open */
    bool has_number;
    bool has_time;
    uint8_t number;
    uint32_t time_us;
    wp_encoders encoders;
    wp_wheel_speeds speeds;
    wp_currents currents;
    wp_accelerometer accelerometer;
    wp_gyro gyro;

    int64_t commanded_ns[256]; /* by sequence; -1 when it was reported, or never sent */
    int16_t reported;          /* the sequence of the newest TICK; -1 before the first */

    uint8_t out[WHEEL_CLIENT_OUT];
    uint32_t out_counted;
    uint32_t out_logged;
    wheel_log sent_log;
    wheel_log received_log;
    size_t log_capacity;
    uint32_t round_trips_logged;
};

#ifdef __cplusplus
}
#endif

#endif
