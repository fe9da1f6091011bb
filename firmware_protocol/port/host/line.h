/* The controller's end of the wire: bytes of a serial line to frames, frames to bytes, and frames to
 * snapshots.
 *
 * Frames travel packed between these functions, one after the other: id16 LE, length8, payload.
 */
#ifndef WHEEL_LINE_H
#define WHEEL_LINE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "../../firmware/framing.h"

/* cffi: begin */
/* A serial line, both ways. */
typedef struct wheel_line wheel_line;

/* What came, and what was dropped by cause; PROTOCOL.md, "Serial framing". */
typedef struct {
    uint32_t frames; /* handed out */
    uint32_t lost;   /* missing in the sender's count */
    uint32_t cobs;
    uint32_t crc;
    uint32_t length;
    uint32_t unknown_id;
    uint32_t overrun;
} wheel_line_counts;

/* Bytes that wheel_line_init needs, with the alignment of malloc. */
size_t wheel_line_size(void);
void wheel_line_init(wheel_line *line);

/* Takes bytes in pieces of any size and packs the frames that they complete, whose number it returns.
 * `packed` has room for `length` bytes and WHEEL_LINE_OPEN more; `*used` becomes how many were written. */
size_t wheel_line_feed(wheel_line *line, const uint8_t *bytes, size_t length, uint8_t *packed, size_t *used);
#define WHEEL_LINE_OPEN 16

/* Writes a frame with its zero, counted in the line's sequence, and returns the number of bytes, at most
 * WHEEL_LINE_LONGEST; 0 when the length is not the id's. An ESTOP begins with a zero too. */
size_t wheel_line_encode(wheel_line *line, uint16_t id, const uint8_t *payload, size_t length, uint8_t *out);
#define WHEEL_LINE_LONGEST 16

void wheel_line_count(const wheel_line *line, wheel_line_counts *counts);

/* Puts snapshots together (PROTOCOL.md, "Feedback"), and hears what ends a step. */
typedef struct wheel_reader wheel_reader;

/* The newest snapshot, and what was read so far. The largest members come first, so that there is no padding.
 */
typedef struct {
    uint64_t robot_time_us; /* TICK.time_us; does not wrap from the first snapshot on */
    uint64_t frames;        /* that were taken */
    uint32_t completed;     /* snapshots */
    uint32_t slow;          /* of them with one of the last three parts */
    uint32_t ticks;         /* TICKs, of any snapshot; `sequences` has theirs */
    uint32_t incomplete;    /* snapshots that were dropped because a part was lost */
    uint32_t lost;          /* gaps in the snapshots' numbers; 128 and more in a row go unseen */
    uint32_t steps_done;    /* STEP_DONEs, and the tick of the newest */
    uint32_t step_done_tick;
    float speed_rad_s[4];
    uint16_t encoder_count[4];
    uint8_t state;
    uint8_t command_sequence;
    uint8_t command_age_ms;
    uint8_t newest_sequence; /* TICK.sequence of the newest TICK */
    /* What comes at a lower rate holds its last value, and is NaN before the first. */
    float current_a[4];
    float acceleration_m_s2[3];
    float yaw_rate_rad_s;
    uint8_t sequences[64]; /* TICK.sequence of TICK number n, from 0, at n modulo 64 */
} wheel_snapshot;

size_t wheel_reader_size(void);
void wheel_reader_init(wheel_reader *reader);

/* Begins anew with a robot that was lost or reset: its numbers and its clock may have begun anew too. */
void wheel_reader_restart(wheel_reader *reader);

/* Takes packed frames from `begin` on, as far as they are valid messages of snapshots, at most 64 TICKs of
 * them, and the STEP_DONE behind them if there is one; returns where the next frame begins, or `end`. */
size_t wheel_reader_take(wheel_reader *reader, const uint8_t *packed, size_t begin, size_t end);

/* What was read so far: the same address for as long as the reader. */
const wheel_snapshot *wheel_reader_snapshot(const wheel_reader *reader);
/* cffi: end */

#endif
