#include "direct.h"

#include "../../client/packed.h"

#define CHUNK 512u

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
    direct->answer_bytes = direct->answer_at = 0;
    while ((taken = wheel_host_take_bytes(robot, bytes, sizeof bytes)) > 0u) {
        size_t written = 0;
        direct->received_frames +=
            wheel_line_feed(direct->here, bytes, taken, direct->answer + direct->answer_bytes, &written);
        direct->answer_bytes += (uint32_t)written;
        direct->received_bytes += taken;
    }
}

bool wheel_direct_step(wheel_direct *direct, wheel_host *robot, wheel_client *client, uint16_t ticks,
                       int64_t now_ns) {
    const wheel_view *known = wheel_client_view(client);
    if (!wheel_client_step(client, ticks)) {
        direct->answer_at = direct->answer_bytes = 0;
        return false;
    }
    wheel_direct_send(direct, robot, wheel_client_out(client), known->out_bytes);
    wheel_client_sent(client);
    wheel_direct_receive(direct, robot);
    direct->answer_at = (uint32_t)wheel_client_take(client, direct->answer, 0, direct->answer_bytes, now_ns);
    return known->step == WHEEL_STEP_DONE && known->message_id == 0u && !known->log_is_due &&
           direct->answer_at == direct->answer_bytes;
}
