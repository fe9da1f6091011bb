/* A serial line between a controller and the robot of the host library, both in the caller's thread. Frames
 * are packed as in line.h.
 */
#ifndef WHEEL_DIRECT_H
#define WHEEL_DIRECT_H

#include "host.h"
#include "line.h"

/* cffi: begin */
/* Sends the robot packed frames by the line `there`, byte by byte as on any other, and packs what it has to
 * send then, as it comes by the line `back`; returns how many frames that are. `used` becomes how many bytes
 * were written into `answer`, which has room for WHEEL_DIRECT_ROOM, and how many the line carried for them.
 * What is sent ends at a frame that is cut or has not the length of its id. */
size_t wheel_direct_converse(wheel_line *there, wheel_line *back, wheel_host *robot, const uint8_t *packed,
                             size_t length, uint8_t *answer, size_t used[2]);
#define WHEEL_DIRECT_ROOM 65536
/* cffi: end */

#endif
