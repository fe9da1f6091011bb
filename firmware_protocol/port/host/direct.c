#include "direct.h"

#include "packed.h"

_Static_assert(WHEEL_HOST_QUEUE *(WHEEL_PACKED_HEADER + sizeof((wheel_frame *)0)->payload) +
                       WHEEL_LINE_OPEN <=
                   WHEEL_DIRECT_ROOM,
               "a full queue of the robot has no room");

static void tell(wheel_line *line, wheel_host *robot, const uint8_t *packed, size_t length) {
    uint8_t bytes[WHEEL_LINE_LONGEST];
    wheel_packed frame;
    for (size_t at = 0; wheel_packed_take(packed, at, length, &frame); at = frame.next) {
        const size_t written = wheel_line_encode(line, frame.id, frame.payload, frame.length, bytes);
        if (written == 0u) {
            return;
        }
        wheel_host_feed(robot, bytes, written);
    }
}

size_t wheel_direct_converse(wheel_line *there, wheel_line *back, wheel_host *robot, const uint8_t *packed,
                             size_t length, uint8_t *answer, size_t used[2]) {
    uint8_t bytes[512];
    size_t count = 0;
    size_t taken;
    used[0] = used[1] = 0;
    tell(there, robot, packed, length);
    while ((taken = wheel_host_take_bytes(robot, bytes, sizeof bytes)) > 0u) {
        size_t written = 0;
        count += wheel_line_feed(back, bytes, taken, answer + used[0], &written);
        used[0] += written;
        used[1] += taken;
    }
    return count;
}
