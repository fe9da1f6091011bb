/* The host library: the firmware core behind a byte stream or a CAN bus, with a plant behind its drives.
 *
 * All of it runs in the caller's thread. A STEP that arrives is run at once, ticks and plant included, so
 * that one call does all that a lockstep tick needs.
 */
#ifndef WHEEL_HOST_H
#define WHEEL_HOST_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../../firmware/node.h"

#define WHEEL_HOST_QUEUE 4096u

/* cffi: begin */
typedef struct wheel_host wheel_host;

typedef struct {
    uint32_t tick;
    uint8_t state;
    uint8_t mode;
    uint8_t fault;
    uint8_t fault_wheel;
    uint8_t stop_reason;
    bool plant_failed;
    uint32_t command_age_ticks; /* since the newest accepted command; UINT32_MAX when there was none */
    float set_point_rad_s[4];   /* what the speed loop follows; in torque mode the measured speed */
    float torque_n_m[4];        /* the last torque set points given to the drives */
    float duty[4];              /* and the duties */
    uint32_t rejected_cobs;
    uint32_t rejected_crc;
    uint32_t rejected_length;
    uint32_t rejected_unknown_id;
    uint32_t rejected_range;
    uint32_t rejected_session;
    uint32_t rejected_stale;
    uint32_t rejected_state;
    uint32_t feedforward_unmatched;
    uint32_t transmit_overruns;
} wheel_host_view;

/* Bytes that wheel_host_init needs, with the alignment of malloc. */
size_t wheel_host_size(void);

/* Powers the robot on, or begins it anew: samples the plant once and starts in IDLE. `stored` is what an
 * earlier STORE kept, of `wheel_host_stored_size` bytes, or NULL; `reset_cause` is what STATUS tells. */
void wheel_host_init(wheel_host *host, const wheel_parameters *parameters, const uint8_t *stored,
                     uint16_t capabilities, uint8_t reset_cause, wheel_plant_exchange exchange,
                     void *context);

/* Sets the robot's clock between two ticks [us], for the time stamps of what arrives and leaves. Without it
 * the clock stands still within a tick. */
void wheel_host_set_clock(wheel_host *host, uint32_t now_us);

/* What the robot keeps across a reset: the bytes of the newest STORE. Returns false when there was none. */
size_t wheel_host_stored_size(void);
bool wheel_host_stored(const wheel_host *host, uint8_t *bytes);

/* What a STORE of these parameters on a board keeps, `wheel_host_stored_size` bytes: for a robot that is to
 * begin with them.
 */
void wheel_host_store(const wheel_parameters *parameters, uint16_t board, uint8_t *bytes);

/* Takes bytes of a serial line, or one CAN frame. */
void wheel_host_feed(wheel_host *host, const uint8_t *bytes, size_t length);
void wheel_host_receive(wheel_host *host, uint16_t id, const uint8_t *payload, size_t length);

/* Lets robot time pass: so many 1 ms ticks. */
void wheel_host_run(wheel_host *host, uint32_t ticks);

/* Takes what the robot has to send, as bytes of a serial line; whole frames only. Returns their number. */
size_t wheel_host_take_bytes(wheel_host *host, uint8_t *bytes, size_t capacity);

/* Takes the next frame to send for CAN; returns its payload's length, or -1 when there is none. */
int wheel_host_take_frame(wheel_host *host, uint16_t *id, uint8_t *payload);

/* Takes note that so many frames that were taken could not be sent. */
void wheel_host_count_unsent(wheel_host *host, uint32_t frames);

void wheel_host_look(const wheel_host *host, wheel_host_view *view);
/* cffi: end */

#endif
