/* A client and a robot in one thread: frames go over a serial line in memory, as bytes, both ways. */
#ifndef WHEEL_DIRECT_H
#define WHEEL_DIRECT_H

#include "../../client/wheel_client.h"
#include "../../client/wheel_line.h"
#include "host.h"

/* cffi: begin */
/* Bytes of packed frames that one exchange may bring: those of the robot's full queue. */
#define WHEEL_DIRECT_ROOM 65536
#define WHEEL_DIRECT_HELD 4096

typedef struct {
    wheel_line *here;  /* the client's end of the line, for what it receives */
    wheel_line *there; /* and for what it sends */
    uint32_t answer_bytes;
    uint32_t answer_frames;
    uint32_t answer_at;   /* wheel_direct_step: what comes from here on was not taken yet */
    uint64_t sent_frames; /* in all, to the robot and from it */
    uint64_t sent_bytes;
    uint64_t received_frames;
    uint64_t received_bytes;
    const wheel_view *waiting;  /* what waits in the client of this view counts as sent */
    uint64_t sent_bytes_before; /* at the beginning of the count of Direct.line_bytes() */
    uint64_t received_bytes_before;
    /* What waits for the next exchange counts as sent too: packed frames, and on the line. */
    uint32_t held_bytes;
    uint32_t held_frames;
    uint64_t held_line_bytes;
    bool may_hang;          /* whether the robot's plant may take for ever: Direct.step() */
    uint32_t stepped_bytes; /* of `stepped` */
    uint32_t stepped_frames;
    uint8_t held[WHEEL_DIRECT_HELD];
    uint8_t stepped[WHEEL_CLIENT_OUT]; /* the client's packed frames that the newest exchange sent */
    uint8_t answer[WHEEL_DIRECT_ROOM]; /* packed frames */
} wheel_direct;

/* Keeps packed frames, which must be messages, for the next exchange to send first. What has no room goes to
 * the robot now. */
void wheel_direct_hold(wheel_direct *direct, wheel_host *robot, const uint8_t *packed, size_t length);

/* Sends packed frames to the robot, up to one that has not the length of its id. */
void wheel_direct_send(wheel_direct *direct, wheel_host *robot, const uint8_t *packed, size_t length);

/* Sends what was held and what waits in the client, if there is one, and puts all that the robot then sends
 * into `answer`. */
void wheel_direct_exchange(wheel_direct *direct, wheel_host *robot, wheel_client *client);

/* Puts all that the robot sends into `answer`. */
void wheel_direct_receive(wheel_direct *direct, wheel_host *robot);

/* The same with a STEP of so many ticks; has the client take the answer. Returns
 * whether that was all: the step is done, nothing is left to take, and no log is due. */
bool wheel_direct_step(wheel_direct *direct, wheel_host *robot, wheel_client *client, uint16_t ticks,
                       int64_t now_ns);
/* cffi: end */

#endif
