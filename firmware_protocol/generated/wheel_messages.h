/* Generated from wheel.dbc by `python -m firmware_protocol.generate`; do not edit. */
#ifndef WHEEL_MESSAGES_H
#define WHEEL_MESSAGES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define WP_PROTOCOL_VERSION 2u
#define WP_SCHEMA_HASH 0x8DC26BB0u
#define WP_PAYLOAD_MAX 8u

enum wp_request {
    WP_REQUEST_IDLE = 0,
    WP_REQUEST_ARM = 1,
    WP_REQUEST_CLEAR = 2,
};

enum wp_mode {
    WP_MODE_SPEED = 0,
    WP_MODE_TORQUE = 1,
};

enum wp_state {
    WP_STATE_BOOT = 0,
    WP_STATE_IDLE = 1,
    WP_STATE_ARMED = 2,
    WP_STATE_ACTIVE = 3,
    WP_STATE_STOPPING = 4,
    WP_STATE_FAULT = 5,
    WP_STATE_ESTOP = 6,
};

enum wp_fault {
    WP_FAULT_NONE = 0,
    WP_FAULT_SENSOR = 1,
    WP_FAULT_OVERSPEED = 2,
    WP_FAULT_PARAMETERS = 3,
    WP_FAULT_OVERCURRENT = 4,
    WP_FAULT_OVERTEMPERATURE = 5,
    WP_FAULT_UNDERVOLTAGE = 6,
    WP_FAULT_ENCODER_STUCK = 7,
    WP_FAULT_WRONG_DIRECTION = 8,
};

enum wp_fault_wheel {
    WP_FAULT_WHEEL_NONE = 0,
    WP_FAULT_WHEEL_FL = 1,
    WP_FAULT_WHEEL_FR = 2,
    WP_FAULT_WHEEL_RR = 3,
    WP_FAULT_WHEEL_RL = 4,
};

enum wp_stop_reason {
    WP_STOP_REASON_NONE = 0,
    WP_STOP_REASON_HOST_REQUEST = 1,
    WP_STOP_REASON_COMMAND_TIMEOUT = 2,
    WP_STOP_REASON_ARM_TIMEOUT = 3,
    WP_STOP_REASON_ESTOP = 4,
    WP_STOP_REASON_FAULT = 5,
};

enum wp_reset_cause {
    WP_RESET_CAUSE_UNKNOWN = 0,
    WP_RESET_CAUSE_POWER_ON = 1,
    WP_RESET_CAUSE_BROWN_OUT = 2,
    WP_RESET_CAUSE_PIN = 3,
    WP_RESET_CAUSE_SOFTWARE = 4,
    WP_RESET_CAUSE_WATCHDOG = 5,
    WP_RESET_CAUSE_LOW_POWER = 6,
    WP_RESET_CAUSE_PROCESSOR_FAULT = 7,
};

enum wp_arm_refusal {
    WP_ARM_REFUSAL_NONE = 0,
    WP_ARM_REFUSAL_SCHEMA = 1,
    WP_ARM_REFUSAL_PARAMETERS = 2,
    WP_ARM_REFUSAL_NOT_IDLE = 3,
    WP_ARM_REFUSAL_NONCE_USED = 4,
    WP_ARM_REFUSAL_SESSION_USED = 5,
    WP_ARM_REFUSAL_MODE = 6,
    WP_ARM_REFUSAL_NOT_ANNOUNCED = 7,
};

enum wp_operation {
    WP_OPERATION_READ = 0,
    WP_OPERATION_READ_MINIMUM = 1,
    WP_OPERATION_READ_MAXIMUM = 2,
    WP_OPERATION_WRITE = 3,
    WP_OPERATION_STORE = 4,
    WP_OPERATION_RESTORE = 5,
};

enum wp_result {
    WP_RESULT_OK = 0,
    WP_RESULT_PARAMETER = 1,
    WP_RESULT_RANGE = 2,
    WP_RESULT_STATE = 3,
    WP_RESULT_STORAGE = 4,
};

enum wp_type {
    WP_TYPE_FLOAT32 = 0,
    WP_TYPE_UINT32 = 1,
};

/* Payload bytes of the message with this id, or -1 when no message has it. */
int wp_payload_length(uint16_t id);

/* X(NAME, name) for every message. */
/* clang-format off */
#define WP_MESSAGES(X) \
    X(ESTOP, estop) \
    X(HOST_HEARTBEAT, host_heartbeat) \
    X(TORQUE_FEEDFORWARD, torque_feedforward) \
    X(WHEEL_COMMAND, wheel_command) \
    X(TORQUE_COMMAND, torque_command) \
    X(TICK, tick) \
    X(ENCODERS, encoders) \
    X(WHEEL_SPEEDS, wheel_speeds) \
    X(CURRENTS, currents) \
    X(ACCELEROMETER, accelerometer) \
    X(GYRO, gyro) \
    X(STATUS, status) \
    X(POWER, power) \
    X(TEMPERATURES, temperatures) \
    X(LINK_COUNTERS, link_counters) \
    X(ABSOLUTE_FRONT, absolute_front) \
    X(ABSOLUTE_REAR, absolute_rear) \
    X(PORT_COUNTERS, port_counters) \
    X(TIME_SYNC_REQUEST, time_sync_request) \
    X(TIME_SYNC_RESPONSE, time_sync_response) \
    X(PARAMETER_REQUEST, parameter_request) \
    X(PARAMETER_RESPONSE, parameter_response) \
    X(STEP, step) \
    X(STEP_DONE, step_done) \
    X(HELLO_REQUEST, hello_request) \
    X(HELLO_IDENTITY, hello_identity) \
    X(HELLO_FIRMWARE, hello_firmware) \
    X(HELLO_PARAMETERS, hello_parameters) \
    X(HELLO_GEOMETRY, hello_geometry) \
    X(HELLO_LIMITS, hello_limits) \
    X(HELLO_FAULT_STATUS, hello_fault_status) \
    X(HELLO_FAULT_PLACE, hello_fault_place) \
    X(HELLO_FAULT_ADDRESS, hello_fault_address)
/* clang-format on */

/* Encoders return false, with the payload untouched, when a value is out of its range or not finite.
 * Decoders return false, with the message untouched, for a wrong length or a value out of its range. */

#define WP_ESTOP_ID 0x010u
#define WP_ESTOP_LENGTH 2u

/* Stop driving at once and latch. Needs no session; sent on the event and repeated until STATUS
 * answers ESTOP. */
typedef struct {
    uint8_t source;
    uint8_t reason;
} wp_estop;

bool wp_estop_encode(const wp_estop *message, uint8_t *payload);
bool wp_estop_decode(const uint8_t *payload, size_t length, wp_estop *message);

#define WP_HOST_HEARTBEAT_ID 0x020u
#define WP_HOST_HEARTBEAT_LENGTH 8u

/* What the host wishes, sent at 10 Hz and on every change. IDLE announces a nonce, ARM with that nonce
 * arms once; repeating it never re-arms. */
typedef struct {
    /* With IDLE: the nonce that the next ARM will have. With ARM: the session nonce, whose low 4 bits are
     * the session in every command. With CLEAR: a new one for each. */
    uint16_t nonce;
    /* The host's schema hash; ARM is refused unless it equals the robot's. */
    uint32_t schema_hash;
    uint8_t request;
    uint8_t mode;
    /* Low 8 bits of the parameter hash that the host expects; ARM is refused unless it equals the robot's. */
    uint8_t parameter_check;
} wp_host_heartbeat;

bool wp_host_heartbeat_encode(const wp_host_heartbeat *message, uint8_t *payload);
bool wp_host_heartbeat_decode(const uint8_t *payload, size_t length, wp_host_heartbeat *message);

#define WP_TORQUE_FEEDFORWARD_ID 0x030u
#define WP_TORQUE_FEEDFORWARD_LENGTH 8u
#define WP_TORQUE_FEEDFORWARD_STEP 0.00390625
#define WP_TORQUE_FEEDFORWARD_MAX 15.99609375

/* Torque feedforward, staged: applied only together with the WHEEL_COMMAND of the same session and
 * sequence that follows it. */
typedef struct {
    float fl_n_m;
    float fr_n_m;
    float rr_n_m;
    float rl_n_m;
    uint8_t sequence;
    uint8_t session;
} wp_torque_feedforward;

bool wp_torque_feedforward_encode(const wp_torque_feedforward *message, uint8_t *payload);
bool wp_torque_feedforward_decode(const uint8_t *payload, size_t length, wp_torque_feedforward *message);

#define WP_WHEEL_COMMAND_ID 0x040u
#define WP_WHEEL_COMMAND_LENGTH 8u
#define WP_WHEEL_COMMAND_STEP 0.015625
#define WP_WHEEL_COMMAND_MAX 63.984375

/* Wheel speed set points. In speed mode the only message that feeds the watchdog. */
typedef struct {
    float fl_rad_s;
    float fr_rad_s;
    float rr_rad_s;
    float rl_rad_s;
    uint8_t sequence;
    uint8_t session;
} wp_wheel_command;

bool wp_wheel_command_encode(const wp_wheel_command *message, uint8_t *payload);
bool wp_wheel_command_decode(const uint8_t *payload, size_t length, wp_wheel_command *message);

#define WP_TORQUE_COMMAND_ID 0x041u
#define WP_TORQUE_COMMAND_LENGTH 8u
#define WP_TORQUE_COMMAND_STEP 0.00390625
#define WP_TORQUE_COMMAND_MAX 15.99609375

/* Wheel torque set points. In torque mode the only message that feeds the watchdog. */
typedef struct {
    float fl_n_m;
    float fr_n_m;
    float rr_n_m;
    float rl_n_m;
    uint8_t sequence;
    uint8_t session;
} wp_torque_command;

bool wp_torque_command_encode(const wp_torque_command *message, uint8_t *payload);
bool wp_torque_command_decode(const uint8_t *payload, size_t length, wp_torque_command *message);

#define WP_TICK_ID 0x080u
#define WP_TICK_LENGTH 8u

/* Opens a feedback snapshot at the loop rate; the parts that it announces follow it. */
typedef struct {
    /* Robot time of the sampling instant, wrapping. */
    uint32_t time_us;
    /* Sequence of the command in force. */
    uint8_t sequence;
    /* Robot time since the newest accepted command; 255 means 255 or more, or none yet. */
    uint8_t command_age_ms;
    uint8_t state;
    /* Parts that follow: bit 0 ENCODERS, bit 1 WHEEL_SPEEDS, bit 2 CURRENTS, bit 3 ACCELEROMETER, bit 4
     * GYRO. */
    uint8_t parts;
    /* Counts snapshots, wrapping. */
    uint8_t snapshot;
} wp_tick;

bool wp_tick_encode(const wp_tick *message, uint8_t *payload);
bool wp_tick_decode(const uint8_t *payload, size_t length, wp_tick *message);

#define WP_ENCODERS_ID 0x081u
#define WP_ENCODERS_LENGTH 8u

/* Encoder counts, wrapping. */
typedef struct {
    uint16_t fl_count;
    uint16_t fr_count;
    uint16_t rr_count;
    uint16_t rl_count;
} wp_encoders;

bool wp_encoders_encode(const wp_encoders *message, uint8_t *payload);
bool wp_encoders_decode(const uint8_t *payload, size_t length, wp_encoders *message);

#define WP_WHEEL_SPEEDS_ID 0x082u
#define WP_WHEEL_SPEEDS_LENGTH 8u

/* Wheel speeds as the tracking filter estimates them. */
typedef struct {
    float fl_rad_s;
    float fr_rad_s;
    float rr_rad_s;
    float rl_rad_s;
} wp_wheel_speeds;

bool wp_wheel_speeds_encode(const wp_wheel_speeds *message, uint8_t *payload);
bool wp_wheel_speeds_decode(const uint8_t *payload, size_t length, wp_wheel_speeds *message);

#define WP_CURRENTS_ID 0x083u
#define WP_CURRENTS_LENGTH 8u

/* Motor currents, each the mean over the feedback period that ends at time_us. */
typedef struct {
    float fl_a;
    float fr_a;
    float rr_a;
    float rl_a;
} wp_currents;

bool wp_currents_encode(const wp_currents *message, uint8_t *payload);
bool wp_currents_decode(const uint8_t *payload, size_t length, wp_currents *message);

#define WP_ACCELEROMETER_ID 0x090u
#define WP_ACCELEROMETER_LENGTH 8u

/* Acceleration of the robot's centre without gravity's, in the body frame: at rest z is 9.81 m/s2. The
 * mean over the feedback period that ends at time_us. */
typedef struct {
    float x_m_s2;
    float y_m_s2;
    float z_m_s2;
    /* As in GYRO. */
    uint16_t tick;
} wp_accelerometer;

bool wp_accelerometer_encode(const wp_accelerometer *message, uint8_t *payload);
bool wp_accelerometer_decode(const uint8_t *payload, size_t length, wp_accelerometer *message);

#define WP_GYRO_ID 0x091u
#define WP_GYRO_LENGTH 8u

/* Angular rates in the body frame at time_us, x forward, y left, z up. */
typedef struct {
    float x_rad_s;
    float y_rad_s;
    float z_rad_s;
    /* Low 16 bits of TICK.time_us / 1000 of the snapshot that this part belongs to. */
    uint16_t tick;
} wp_gyro;

bool wp_gyro_encode(const wp_gyro *message, uint8_t *payload);
bool wp_gyro_decode(const uint8_t *payload, size_t length, wp_gyro *message);

#define WP_STATUS_ID 0x100u
#define WP_STATUS_LENGTH 8u

/* State, and why the robot last stopped or refused to arm; 10 Hz and on every change of state. */
typedef struct {
    uint8_t state;
    uint8_t mode;
    uint8_t fault;
    /* Wheel of the fault, 1 to 4 for FL, FR, RR, RL; 0 when it is not one wheel's. */
    uint8_t fault_wheel;
    uint8_t stop_reason;
    /* Why the robot began anew the last time. */
    uint8_t reset_cause;
    /* Nonce of the last session; 0 when there was none. */
    uint16_t nonce;
    uint8_t arm_refusal;
    /* Ticks in which all four wheels were scaled at a limit of torque, current, temperature or speed,
     * wrapping. */
    uint16_t limited;
} wp_status;

bool wp_status_encode(const wp_status *message, uint8_t *payload);
bool wp_status_decode(const uint8_t *payload, size_t length, wp_status *message);

#define WP_POWER_ID 0x101u
#define WP_POWER_LENGTH 4u

/* Battery, the means over the newest feedback period; 10 Hz. */
typedef struct {
    float battery_v;
    /* Out of the battery; negative while braking charges it. */
    float battery_a;
} wp_power;

bool wp_power_encode(const wp_power *message, uint8_t *payload);
bool wp_power_decode(const uint8_t *payload, size_t length, wp_power *message);

#define WP_TEMPERATURES_ID 0x102u
#define WP_TEMPERATURES_LENGTH 8u

/* Temperatures of the motors' windings; 10 Hz. */
typedef struct {
    float fl_degc;
    float fr_degc;
    float rr_degc;
    float rl_degc;
} wp_temperatures;

bool wp_temperatures_encode(const wp_temperatures *message, uint8_t *payload);
bool wp_temperatures_decode(const uint8_t *payload, size_t length, wp_temperatures *message);

#define WP_LINK_COUNTERS_ID 0x103u
#define WP_LINK_COUNTERS_LENGTH 8u

/* Frames rejected, by cause, each wrapping; 10 Hz. */
typedef struct {
    uint8_t cobs;
    uint8_t crc;
    /* Frames of a wrong length. */
    uint8_t length;
    uint8_t unknown_id;
    uint8_t range;
    uint8_t session;
    uint8_t stale;
    uint8_t state;
} wp_link_counters;

bool wp_link_counters_encode(const wp_link_counters *message, uint8_t *payload);
bool wp_link_counters_decode(const uint8_t *payload, size_t length, wp_link_counters *message);

#define WP_ABSOLUTE_FRONT_ID 0x104u
#define WP_ABSOLUTE_FRONT_LENGTH 8u

/* Encoder counts since power-on in two's complement: whole turns that ENCODERS no longer tells; 1 Hz. */
typedef struct {
    uint32_t fl_count;
    uint32_t fr_count;
} wp_absolute_front;

bool wp_absolute_front_encode(const wp_absolute_front *message, uint8_t *payload);
bool wp_absolute_front_decode(const uint8_t *payload, size_t length, wp_absolute_front *message);

#define WP_ABSOLUTE_REAR_ID 0x105u
#define WP_ABSOLUTE_REAR_LENGTH 8u

/* As ABSOLUTE_FRONT. */
typedef struct {
    uint32_t rr_count;
    uint32_t rl_count;
} wp_absolute_rear;

bool wp_absolute_rear_encode(const wp_absolute_rear *message, uint8_t *payload);
bool wp_absolute_rear_decode(const uint8_t *payload, size_t length, wp_absolute_rear *message);

#define WP_PORT_COUNTERS_ID 0x106u
#define WP_PORT_COUNTERS_LENGTH 6u

/* What the robot's ports lost, each wrapping; 10 Hz. */
typedef struct {
    /* Serial frames too long, and bytes that the port could not take in time. */
    uint8_t overrun;
    /* Torque feedforwards without their command. */
    uint8_t feedforward_unmatched;
    /* Frames that the robot could not send in time. */
    uint8_t transmit_overrun;
    /* Frames of the host that are missing in its line count. */
    uint8_t serial_lost;
    /* CAN error frames seen by the robot's controller. */
    uint8_t can_errors;
    /* Times that the robot's controller went off the bus and came back. */
    uint8_t bus_off;
} wp_port_counters;

bool wp_port_counters_encode(const wp_port_counters *message, uint8_t *payload);
bool wp_port_counters_decode(const uint8_t *payload, size_t length, wp_port_counters *message);

#define WP_TIME_SYNC_REQUEST_ID 0x180u
#define WP_TIME_SYNC_REQUEST_LENGTH 1u

/* Asks for the robot's clock; 4 Hz. */
typedef struct {
    uint8_t sequence;
} wp_time_sync_request;

bool wp_time_sync_request_encode(const wp_time_sync_request *message, uint8_t *payload);
bool wp_time_sync_request_decode(const uint8_t *payload, size_t length, wp_time_sync_request *message);

#define WP_TIME_SYNC_RESPONSE_ID 0x181u
#define WP_TIME_SYNC_RESPONSE_LENGTH 7u

/* Answers TIME_SYNC_REQUEST. */
typedef struct {
    /* The robot's clock, that of TICK.time_us, when the request arrived. */
    uint32_t received_us;
    /* Time from then until this answer was handed to the port; 65535 or more is 65535. */
    uint16_t held_us;
    uint8_t sequence;
} wp_time_sync_response;

bool wp_time_sync_response_encode(const wp_time_sync_response *message, uint8_t *payload);
bool wp_time_sync_response_decode(const uint8_t *payload, size_t length, wp_time_sync_response *message);

#define WP_PARAMETER_REQUEST_ID 0x200u
#define WP_PARAMETER_REQUEST_LENGTH 7u

/* Reads or changes one of the firmware's parameters; STORE and RESTORE concern all. */
typedef struct {
    uint8_t parameter;
    /* WRITE, STORE and RESTORE are done in IDLE only. RESTORE takes the values that the firmware was built
     * with. */
    uint8_t operation;
    /* Comes back in the answer. */
    uint8_t transaction;
    /* WRITE: the bits of the value, by its type. Otherwise 0. */
    uint32_t value;
} wp_parameter_request;

bool wp_parameter_request_encode(const wp_parameter_request *message, uint8_t *payload);
bool wp_parameter_request_decode(const uint8_t *payload, size_t length, wp_parameter_request *message);

#define WP_PARAMETER_RESPONSE_ID 0x280u
#define WP_PARAMETER_RESPONSE_LENGTH 8u

/* Answers PARAMETER_REQUEST. */
typedef struct {
    uint8_t parameter;
    uint8_t operation;
    uint8_t transaction;
    /* PARAMETER: no such one. RANGE: not from its minimum to its maximum. STATE: not in IDLE. STORAGE:
     * could not be kept. */
    uint8_t result;
    uint8_t type;
    /* The bits of the value, or of a limit, as it is now; for STORE and RESTORE, done or refused, the
     * parameter hash. */
    uint32_t value;
} wp_parameter_response;

bool wp_parameter_response_encode(const wp_parameter_response *message, uint8_t *payload);
bool wp_parameter_response_decode(const uint8_t *payload, size_t length, wp_parameter_response *message);

#define WP_STEP_ID 0x300u
#define WP_STEP_LENGTH 6u

/* Lockstep only. At this tick, run so many 1 ms ticks. Repeating it runs nothing twice; 0 substeps
 * asks for the tick. */
typedef struct {
    uint32_t tick;
    uint16_t substeps;
} wp_step;

bool wp_step_encode(const wp_step *message, uint8_t *payload);
bool wp_step_decode(const uint8_t *payload, size_t length, wp_step *message);

#define WP_STEP_DONE_ID 0x301u
#define WP_STEP_DONE_LENGTH 4u

/* Lockstep only. The tick reached; sent after the feedback of the step. */
typedef struct {
    uint32_t tick;
} wp_step_done;

bool wp_step_done_encode(const wp_step_done *message, uint8_t *payload);
bool wp_step_done_decode(const uint8_t *payload, size_t length, wp_step_done *message);

#define WP_HELLO_REQUEST_ID 0x700u
#define WP_HELLO_REQUEST_LENGTH 1u

/* Asks for the HELLO pages. Ids 1792-1807 and the layout of page 0 are frozen for ever. */
typedef struct {
    uint8_t protocol_version;
} wp_hello_request;

bool wp_hello_request_encode(const wp_hello_request *message, uint8_t *payload);
bool wp_hello_request_decode(const uint8_t *payload, size_t length, wp_hello_request *message);

#define WP_HELLO_IDENTITY_ID 0x701u
#define WP_HELLO_IDENTITY_LENGTH 8u

/* HELLO page 0. */
typedef struct {
    uint8_t protocol_version;
    /* How many pages follow each other from this id on. */
    uint8_t pages;
    /* Bit 0 POWER_STAGE, 1 LOCKSTEP, 2 SPEED, 3 TORQUE, 4 FEEDFORWARD, 5 CURRENTS, 6 GYRO, 7
     * ACCELEROMETER, 8 POWER, 9 TEMPERATURES, 10 STORAGE. */
    uint16_t capabilities;
    uint32_t schema_hash;
} wp_hello_identity;

bool wp_hello_identity_encode(const wp_hello_identity *message, uint8_t *payload);
bool wp_hello_identity_decode(const uint8_t *payload, size_t length, wp_hello_identity *message);

#define WP_HELLO_FIRMWARE_ID 0x702u
#define WP_HELLO_FIRMWARE_LENGTH 8u

/* HELLO page 1. */
typedef struct {
    uint8_t major;
    uint8_t minor;
    uint8_t patch;
    /* 0 is the host library. */
    uint8_t board;
    /* First 32 bits of the build's source hash; 0 when unknown. */
    uint32_t build;
} wp_hello_firmware;

bool wp_hello_firmware_encode(const wp_hello_firmware *message, uint8_t *payload);
bool wp_hello_firmware_decode(const uint8_t *payload, size_t length, wp_hello_firmware *message);

#define WP_HELLO_PARAMETERS_ID 0x703u
#define WP_HELLO_PARAMETERS_LENGTH 8u

/* HELLO page 2. */
typedef struct {
    uint32_t parameter_hash;
    uint16_t watchdog_ms;
    uint16_t feedback_period_ms;
} wp_hello_parameters;

bool wp_hello_parameters_encode(const wp_hello_parameters *message, uint8_t *payload);
bool wp_hello_parameters_decode(const uint8_t *payload, size_t length, wp_hello_parameters *message);

#define WP_HELLO_GEOMETRY_ID 0x704u
#define WP_HELLO_GEOMETRY_LENGTH 8u

/* HELLO page 3: the robot's size, as its firmware knows it. */
typedef struct {
    float wheel_radius_m;
    /* From the centre to an axle. */
    float half_length_m;
    /* From the centre to a wheel. */
    float half_width_m;
    uint16_t counts_per_revolution;
} wp_hello_geometry;

bool wp_hello_geometry_encode(const wp_hello_geometry *message, uint8_t *payload);
bool wp_hello_geometry_decode(const uint8_t *payload, size_t length, wp_hello_geometry *message);

#define WP_HELLO_LIMITS_ID 0x705u
#define WP_HELLO_LIMITS_LENGTH 6u

/* HELLO page 4: what the robot keeps its wheels to. */
typedef struct {
    /* WHEEL_COMMANDs beyond it are scaled to it, all four wheels by one factor. */
    float speed_limit_rad_s;
    /* A wheel faster than this is a fault. */
    float overspeed_rad_s;
    /* Of one wheel; beyond it all four are scaled. */
    float torque_limit_n_m;
} wp_hello_limits;

bool wp_hello_limits_encode(const wp_hello_limits *message, uint8_t *payload);
bool wp_hello_limits_decode(const uint8_t *payload, size_t length, wp_hello_limits *message);

#define WP_HELLO_FAULT_STATUS_ID 0x706u
#define WP_HELLO_FAULT_STATUS_LENGTH 8u

/* HELLO page 5: fault status registers of the processor fault that reset the robot; 0 when none did. */
typedef struct {
    uint32_t cfsr;
    uint32_t hfsr;
} wp_hello_fault_status;

bool wp_hello_fault_status_encode(const wp_hello_fault_status *message, uint8_t *payload);
bool wp_hello_fault_status_decode(const uint8_t *payload, size_t length, wp_hello_fault_status *message);

#define WP_HELLO_FAULT_PLACE_ID 0x707u
#define WP_HELLO_FAULT_PLACE_LENGTH 8u

/* HELLO page 6: where the processor was at that fault; 0 when it is not known. */
typedef struct {
    /* Address of the instruction. */
    uint32_t pc;
    /* Where its function would have returned to. */
    uint32_t lr;
} wp_hello_fault_place;

bool wp_hello_fault_place_encode(const wp_hello_fault_place *message, uint8_t *payload);
bool wp_hello_fault_place_decode(const uint8_t *payload, size_t length, wp_hello_fault_place *message);

#define WP_HELLO_FAULT_ADDRESS_ID 0x708u
#define WP_HELLO_FAULT_ADDRESS_LENGTH 8u

/* HELLO page 7: which address that fault was about, where cfsr says that it holds one. */
typedef struct {
    /* Of a memory management fault. */
    uint32_t mmfar;
    /* Of a bus fault. */
    uint32_t bfar;
} wp_hello_fault_address;

bool wp_hello_fault_address_encode(const wp_hello_fault_address *message, uint8_t *payload);
bool wp_hello_fault_address_decode(const uint8_t *payload, size_t length, wp_hello_fault_address *message);

#ifdef __cplusplus
}
#endif

#endif
