#include "direct.h"

#define HEADER 3u /* id16, length8 */

static size_t tell(wheel_line *line, wheel_host *robot, const uint8_t *packed, size_t length) {
    uint8_t bytes[WHEEL_LINE_LONGEST];
    size_t sent = 0;
    size_t at = 0;
    while (at + HEADER <= length && at + HEADER + packed[at + 2u] <= length) {
        const uint16_t id = (uint16_t)(packed[at] | (packed[at + 1u] << 8));
        const size_t written = wheel_line_encode(line, id, packed + at + HEADER, packed[at + 2u], bytes);
        if (written == 0u) {
            break;
        }
        wheel_host_feed(robot, bytes, written);
        sent += written;
        at += HEADER + packed[at + 2u];
    }
    return sent;
}

size_t wheel_direct_converse(wheel_line *line, wheel_host *robot, const uint8_t *packed, size_t length,
                             uint8_t *answer, size_t room, wheel_direct_bytes *bytes) {
    uint8_t piece[WHEEL_DIRECT_ROOM / 2];
    size_t count = 0;
    *bytes = (wheel_direct_bytes){.sent = tell(line, robot, packed, length)};
    /* A piece becomes at most as many bytes as it has, and what was open before. */
    while (room - bytes->packed >= sizeof piece + WHEEL_LINE_OPEN) {
        const size_t taken = wheel_host_take_bytes(robot, piece, sizeof piece);
        if (taken == 0u) {
            break;
        }
        size_t written = 0;
        count += wheel_line_feed(line, piece, taken, answer + bytes->packed, &written);
        bytes->received += taken;
        bytes->packed += written;
    }
    return count;
}
