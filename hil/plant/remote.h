/* The firmware's plant port through two pipes: the plant runs in a process of its own.
 *
 * A request and a reply are structures of one size each; both ends are of one build. The parent's side is in
 * C, so that a tick runs no Python there: no signal handler can raise between a request and its reply.
 */
#ifndef REMOTE_H
#define REMOTE_H

#include <stddef.h>
#include <stdint.h>

#include "plant_port.h"

/* cffi: begin */
typedef enum {
    REMOTE_SAMPLE, /* sample, no time passes */
    REMOTE_TICK,   /* hold `drive` for one tick, then sample */
    REMOTE_WIRE,   /* wire the channels, then sample */
    REMOTE_SET,    /* give a variable a value, then sample */
    REMOTE_RESET,  /* back to the start, then sample */
} remote_kind;

typedef struct {
    int32_t kind;
    int32_t wheel_of_channel[4];
    int32_t sign_of_channel[4];
    uint64_t place; /* of the variable among the settable ones */
    double value;
    wheel_drive drive;
} remote_request;

enum {
    REMOTE_DONE,
    REMOTE_FAILED,  /* `text` says why, and the rest means nothing; it is the last reply */
    REMOTE_REFUSED, /* the request was wrong, and nothing came of it; `text` says why */
};

#define REMOTE_MARK 0x7E09E51AU

typedef struct {
    uint32_t begin; /* REMOTE_MARK, as is `end`: an FMU may write into the pipe */
    int32_t status;
    wheel_sense sense;
    uint64_t time_ns;      /* since the start */
    double pose[3];        /* x_m, y_m, heading_rad, world frame */
    double twist[3];       /* vx_m_s, vy_m_s, yaw_rate_rad_s, world frame */
    double wheel_speed[4]; /* rad/s, FL, FR, RR, RL */
    char text[512];
    uint32_t end;
} remote_reply;

/* File descriptors; on Windows handles, because descriptors belong to one C library and there may be two. */
typedef struct {
    intptr_t read_end;
    intptr_t write_end;
} remote_pipes;

/* The parent's side. `asked` and `answered` differ while a reply is awaited; another thread may watch them.
 */
typedef struct {
    remote_pipes pipes;
    volatile uint32_t asked;
    volatile uint32_t answered;
    int lost;            /* the pipes broke: the process has ended, or was ended */
    int foreign;         /* `reply` has bytes that are no reply */
    int failed;          /* once set, every request fails */
    remote_reply reply;  /* the newest that came whole */
    remote_reply newest; /* the newest good one */
} remote_plant;

/* Sends a request and waits for its reply, however long it takes. Returns 0, or 1 when the plant failed or
 * its process is gone. */
int remote_ask(remote_plant *plant, const remote_request *request);

/* A wheel_plant_exchange whose context is a remote_plant. */
int remote_exchange(void *context, const wheel_drive *drive, wheel_sense *sense);

/* Sets one of the child's settable variables; the context is a remote_plant. Returns like remote_ask. */
int remote_set(void *context, size_t place, double value);

/* The child's side: waits for the next request; gives a reply, which it marks. They return 0, or 1 when the
 * parent is gone.
 */
int remote_next(const remote_pipes *pipes, remote_request *request);
int remote_answer(const remote_pipes *pipes, remote_reply *reply);

/* Makes C's stdout give each line at once, so that a crash loses no words. */
void remote_flush_lines(void);
/* cffi: end */

#endif
