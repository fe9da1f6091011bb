#include "direct.h"

#include "../../client/packed.h"

#include <string.h>

#define CHUNK 512u
#define LINE_OVERHEAD (7u - WHEEL_PACKED_HEADER) /* bytes of a frame on the line, more than packed */

_Static_assert(WHEEL_HOST_QUEUE *(WHEEL_PACKED_HEADER + WP_PAYLOAD_MAX) + WHEEL_LINE_OPEN <=
                   WHEEL_DIRECT_ROOM,
               "a full queue of the robot has no room");

void wheel_direct_send(wheel_direct *direct, wheel_host *robot, const uint8_t *packed, size_t length) {
    uint8_t bytes[WHEEL_LINE_GROWTH * (WHEEL_PACKED_HEADER + WP_PAYLOAD_MAX)];
    wheel_packed frame;
    for (size_t at = 0; wheel_packed_take(packed, at, length, &frame); at = frame.next) {
        const size_t size = frame.next - at;
        const size_t written = size > WHEEL_PACKED_HEADER + WP_PAYLOAD_MAX
                                   ? 0u
                                   : wheel_line_encode(direct->there, packed + at, size, bytes);
        if (written == 0u) {
            return;
        }
        direct->sent_frames++;
        direct->sent_bytes += written;
        wheel_host_feed(robot, bytes, written);
    }
}

void wheel_direct_receive(wheel_direct *direct, wheel_host *robot) {
    uint8_t bytes[CHUNK];
    size_t taken;
    const uint64_t before = direct->received_frames;
    direct->answer_bytes = direct->answer_at = 0;
    while ((taken = wheel_host_take_bytes(robot, bytes, sizeof bytes)) > 0u) {
        size_t written = 0;
        direct->received_frames +=
            wheel_line_feed(direct->here, bytes, taken, direct->answer + direct->answer_bytes, &written);
        direct->answer_bytes += (uint32_t)written;
        direct->received_bytes += taken;
    }
    direct->answer_frames = (uint32_t)(direct->received_frames - before);
}

static void send_held(wheel_direct *direct, wheel_host *robot) {
    wheel_direct_send(direct, robot, direct->held, direct->held_bytes);
    direct->held_bytes = direct->held_frames = 0;
    direct->held_line_bytes = 0;
}

void wheel_direct_hold(wheel_direct *direct, wheel_host *robot, const uint8_t *packed, size_t length) {
    wheel_packed frame;
    if (direct->held_bytes + length > sizeof direct->held) {
        send_held(direct, robot);
    }
    if (length > sizeof direct->held) {
        wheel_direct_send(direct, robot, packed, length);
        return;
    }
    for (size_t at = 0; wheel_packed_take(packed, at, length, &frame); at = frame.next) {
        direct->held_frames++;
        direct->held_line_bytes += LINE_OVERHEAD + (frame.id == WP_ESTOP_ID);
    }
    memcpy(direct->held + direct->held_bytes, packed, length);
    direct->held_bytes += (uint32_t)length;
    direct->held_line_bytes += length;
}

void wheel_direct_exchange(wheel_direct *direct, wheel_host *robot, wheel_client *client) {
    send_held(direct, robot);
    direct->stepped_bytes = direct->stepped_frames = 0;
    if (client != NULL) {
        direct->stepped_bytes = wheel_client_view(client)->out_bytes;
        direct->stepped_frames = wheel_client_view(client)->out_frames;
        memcpy(direct->stepped, wheel_client_out(client), direct->stepped_bytes);
        wheel_direct_send(direct, robot, direct->stepped, direct->stepped_bytes);
        wheel_client_sent(client);
    }
    wheel_direct_receive(direct, robot);
}

bool wheel_direct_step(wheel_direct *direct, wheel_host *robot, wheel_client *client, uint16_t ticks,
                       int64_t now_ns) {
    const wheel_view *known = wheel_client_view(client);
    if (!wheel_client_step(client, ticks)) {
        direct->answer_at = direct->answer_bytes = direct->stepped_bytes = 0;
        return false;
    }
    wheel_direct_exchange(direct, robot, client);
    direct->answer_at = (uint32_t)wheel_client_take(client, direct->answer, 0, direct->answer_bytes, now_ns);
    return known->step == WHEEL_STEP_DONE && known->message_id == 0u && !known->log_is_due &&
           direct->answer_at == direct->answer_bytes;
}
