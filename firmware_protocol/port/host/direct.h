/* A serial line between a controller and the robot of the host library, both in the caller's thread. Frames
 * are packed as in line.h.
 */
#ifndef WHEEL_DIRECT_H
#define WHEEL_DIRECT_H

#include "host.h"
#include "line.h"

/* cffi: begin */
/* What became of a conversation, in bytes. */
typedef struct {
    size_t sent;     /* over the line, to the robot */
    size_t received; /* over the line, from the robot */
    size_t packed;   /* were written */
} wheel_direct_bytes;

/* Sends the robot packed frames, byte by byte as on any line, and packs all that it has to send then, as far
 * as there is room, which is at least WHEEL_DIRECT_ROOM; returns how many frames that are. What is sent ends
 * at a frame that is cut or has not the length of its id. */
size_t wheel_direct_converse(wheel_line *line, wheel_host *robot, const uint8_t *packed, size_t length,
                             uint8_t *answer, size_t room, wheel_direct_bytes *bytes);
#define WHEEL_DIRECT_ROOM 1024
/* cffi: end */

#endif
