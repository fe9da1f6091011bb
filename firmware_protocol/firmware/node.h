/* The firmware core: one structure an instance, no statics, no I/O, no allocation; time is passed in as
 * ticks.
 *
 * A port (a board, or the host library) does three things from one context:
 *   wheel_node_receive   for each valid frame that arrives,
 *   wheel_node_sense     at the beginning of each 1 kHz tick, with what was sampled then,
 *   wheel_node_drive     right after it, for the set points that hold during the tick,
 * and sends what wheel_node_transmit hands out.
 */
#ifndef WHEEL_NODE_H
#define WHEEL_NODE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "control.h"
#include "framing.h"
#include "parameters.h"
#include "plant_port.h"
#include "states.h"

#define WHEEL_CAPABILITY_POWER_STAGE 0x0001u /* motors are behind the drives */
#define WHEEL_CAPABILITY_LOCKSTEP 0x0002u    /* robot time comes from STEP */
#define WHEEL_CAPABILITY_SPEED 0x0004u
#define WHEEL_CAPABILITY_TORQUE 0x0008u
#define WHEEL_CAPABILITY_FEEDFORWARD 0x0010u
#define WHEEL_CAPABILITY_CURRENTS 0x0020u
#define WHEEL_CAPABILITY_GYRO 0x0040u
#define WHEEL_CAPABILITY_ACCELEROMETER 0x0080u
#define WHEEL_CAPABILITY_POWER 0x0100u
#define WHEEL_CAPABILITY_TEMPERATURES 0x0200u
#define WHEEL_CAPABILITY_STORAGE 0x0400u /* parameters are kept across a reset */

#define WHEEL_SEQUENCE_WINDOW 20u     /* forward distances 1..20 of 256 are accepted */
#define WHEEL_ARM_TIMEOUT_TICKS 1000u /* ARMED without a command */
#define WHEEL_STOP_LIMIT_TICKS 1000u  /* after the ramp the wheels are held for at most so long */
#define WHEEL_STATUS_PERIOD_TICKS 100u
#define WHEEL_ABSOLUTE_PERIOD_TICKS 1000u
#define WHEEL_SLOW_PART_PERIOD_TICKS 5u /* CURRENTS, ACCELEROMETER and GYRO at 200 Hz at most */
#define WHEEL_TRANSMIT_QUEUE 32u

/* What a Cortex-M tells of the fault that stopped it; all zero when none did. */
typedef struct {
    uint32_t cfsr; /* configurable fault status */
    uint32_t hfsr; /* hard fault status */
    uint32_t pc;   /* of the instruction */
    uint32_t lr;
    uint32_t mmfar;
    uint32_t bfar;
} wheel_processor_fault;

typedef struct {
    uint16_t capabilities;
    uint8_t board; /* 0 is the host library */
    uint8_t version[3];
    uint32_t build;                        /* first 32 bits of the source hash, 0 when unknown */
    uint8_t reset_cause;                   /* WP_RESET_CAUSE_..., of the reset that this node begins after */
    wheel_processor_fault processor_fault; /* that this reset came from */
    const wheel_parameters
        *maximum; /* what the board stands (wheel_parameter_maximum); lives as long as the node */
} wheel_identity;

/* Frames that were valid on the wire and refused here, by cause. */
typedef struct {
    uint32_t length;
    uint32_t unknown_id;
    uint32_t range;
    uint32_t session;
    uint32_t stale;
    uint32_t state;
    uint32_t feedforward_unmatched;
} wheel_rejections;

/* What the transport dropped or lost before the core saw it; the port keeps it current, LINK_COUNTERS and
 * PORT_COUNTERS report it. */
typedef struct {
    uint32_t cobs;
    uint32_t crc;
    uint32_t length;
    uint32_t unknown_id;
    uint32_t overrun;
    uint32_t serial_lost;
    uint32_t can_errors;
    uint32_t bus_off;
} wheel_transport_counters;

/* What the supervision of a wheel's encoder remembers. */
typedef struct {
    uint32_t still_ticks;    /* for how long it stood still while it should turn */
    float still_from_rad_s;  /* speed when `still_ticks` began */
    uint32_t backward_ticks; /* for how long it said the opposite of its set point, and was not braking */
    float slowest_rad_s;     /* least speed since it was driven against */
    float fastest_rad_s;     /* greatest speed since `backward_ticks` began */
} wheel_encoder_watch;

/* What the robot tells as means over the feedback period. */
typedef struct {
    float current_a[WHEEL_COUNT];
    float acceleration_m_s2[3];
    float battery_v;
    float battery_a;
} wheel_measured;

/* An accepted command, held until the next one. */
typedef struct {
    float target[WHEEL_COUNT]; /* rad/s in speed mode, N m in torque mode */
    float feedforward_n_m[WHEEL_COUNT];
    uint8_t sequence;
    uint32_t age_ticks;
} wheel_setting;

typedef struct {
    bool present;
    uint8_t sequence;
    float torque_n_m[WHEEL_COUNT];
} wheel_staged;

typedef struct {
    wheel_parameters parameters;
    wheel_identity identity;
    uint32_t tick;
    uint8_t state;
    uint8_t mode;
    uint8_t fault;
    uint8_t fault_wheel; /* 1 to 4, 0 for none */
    uint8_t stop_reason;
    uint8_t arm_refusal;

    uint16_t session_nonce;   /* of the last session */
    uint16_t announced_nonce; /* by an IDLE request heard in IDLE; 0 when none waits for its ARM */
    uint16_t cleared_nonce;   /* of the last CLEAR */

    wheel_setting setting;
    wheel_staged staged;

    wheel_tracker tracker[WHEEL_COUNT];
    wheel_speed_loop speed_loop;
    wheel_current_loop current_loop;
    wheel_sense sense;  /* of this tick */
    wheel_measured sum; /* over the ticks of the feedback period so far whose values were plausible */
    uint32_t summed_ticks;
    wheel_measured mean; /* over the newest whole feedback period */
    bool has_mean;
    float torque_n_m[WHEEL_COUNT]; /* given to the drives in the last tick */
    uint32_t absolute_count[WHEEL_COUNT];
    wheel_encoder_watch encoder[WHEEL_COUNT];
    uint32_t overcurrent_ticks;
    uint32_t undervoltage_ticks;
    float speed_rad_s[WHEEL_COUNT];
    float set_point_rad_s[WHEEL_COUNT]; /* what the speed loop follows; in torque mode the measured speed */
    float ramp_from_rad_s[WHEEL_COUNT];
    uint32_t state_ticks; /* since the state was entered */
    bool braking;         /* ESTOP: the drives still work, to stop the wheels */
    uint32_t rest_ticks;  /* for how long all four wheels have stood still */

    uint32_t limited_ticks;
    uint8_t snapshot;
    wheel_rejections rejections;
    wheel_transport_counters transport;

    bool step_pending;
    uint32_t step_ticks;

    wheel_parameters built_in; /* what RESTORE goes back to */
    bool store_pending;
    wp_parameter_request store_request;

    uint32_t now_us; /* when the frame in hand arrived */

    wheel_frame queue[WHEEL_TRANSMIT_QUEUE];
    uint8_t queue_head;
    uint8_t queue_count;
    uint32_t transmit_overruns;
} wheel_node;

/* Starts in IDLE, or in FAULT for good when a parameter of the build is out of its range. `built_in` are the
 * parameters of the build; `stored` what the port kept across the reset, WHEEL_STORED_SIZE bytes, or NULL.
 * Bytes that are damaged, or of another firmware, leave the built-in ones in force; the parameter hash tells.
 */
void wheel_node_init(wheel_node *node, const wheel_parameters *built_in, const uint8_t *stored,
                     const wheel_identity *identity);

/* Takes one frame that passed the checks of its transport. Wrong content is dropped and counted. `now_us` is
 * the robot's clock, that of TICK.time_us, when the frame was complete. */
void wheel_node_receive(wheel_node *node, const wheel_frame *frame, uint32_t now_us);

/* Begins a tick: estimates, supervises, and queues feedback. */
void wheel_node_sense(wheel_node *node, const wheel_sense *sense);

/* The set points that hold during this tick; ends the tick. */
void wheel_node_drive(wheel_node *node, wheel_drive *drive);

/* The drives or sensors failed: a fault, with the drives off. */
void wheel_node_fail(wheel_node *node);

/* Hands out the next frame to send at `now_us`; false when there is none. */
bool wheel_node_transmit(wheel_node *node, wheel_frame *frame, uint32_t now_us);

/* True when a STEP asks for ticks; the port runs them and then calls wheel_node_step_done. */
bool wheel_node_step_pending(const wheel_node *node, uint32_t *ticks);
void wheel_node_step_done(wheel_node *node);

/* True when a STORE asks to keep `bytes`; the port writes them and then calls wheel_node_stored. */
bool wheel_node_store_pending(const wheel_node *node, uint8_t bytes[WHEEL_STORED_SIZE]);
void wheel_node_stored(wheel_node *node, bool kept);

/* Used between the files of the core. */
void wheel_node_event(wheel_node *node, wheel_event event);
void wheel_node_stop(wheel_node *node, wheel_event event, uint8_t reason);
void wheel_node_fault(wheel_node *node, uint8_t cause, uint8_t wheel);
void wheel_node_supervise(wheel_node *node);
bool wheel_node_at_rest(const wheel_node *node);

/* What a wheel may drive with [N m]: the torque limit, or the current limit as far as heat leaves it. */
float wheel_node_torque_limit(const wheel_node *node);

/* The largest speed that a wheel is told to have [rad/s]: so far below the overspeed limit that a speed loop
 * which overshoots does not reach that. A whole number of the steps of WHEEL_COMMAND. */
float wheel_node_speed_limit(const wheel_node *node);

bool wheel_node_on_time_sync(wheel_node *node, const wheel_frame *frame);
bool wheel_node_on_parameter(wheel_node *node, const wheel_frame *frame);
void wheel_node_queue(wheel_node *node, uint16_t id, uint8_t length, const uint8_t *payload);
void wheel_node_send_hello(wheel_node *node);
void wheel_node_send_feedback(wheel_node *node);
void wheel_node_send_status(wheel_node *node);
bool wheel_sense_is_plausible(const wheel_sense *sense);
uint32_t wheel_ticks(float seconds);
float wheel_magnitude(float x);

#endif
