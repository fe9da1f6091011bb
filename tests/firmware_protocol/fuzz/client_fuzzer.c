/* Fuzzes the host's half of the protocol: any order of calls, and any frames, also what is none. The stream
 * is a robot's serial line; its first bytes choose the calls that are made between its pieces. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "../../../firmware_protocol/client/wheel_client.h"
#include "../../../firmware_protocol/client/wheel_line.h"
#include "check.h"
#include "wire_mutator.h"

#define CALLS 24u
#define LOG (2u * WHEEL_CLIENT_OUT)

const size_t wire_header_size = CALLS;

uint8_t wire_parameter_check(void) {
    return 0x5Au;
}

static uint8_t sent_log[LOG];
static uint8_t received_log[LOG];

/* Whether the packed bytes are whole messages, each of the length of its id. */
static bool are_messages(const uint8_t *packed, size_t size) {
    size_t at = 0;
    while (at + 3u <= size) {
        const uint16_t id = (uint16_t)(packed[at] | (packed[at + 1u] << 8));
        if (wp_payload_length(id) != (int)packed[at + 2u]) {
            return false;
        }
        at += 3u + packed[at + 2u];
    }
    return at == size;
}

static void check(const wheel_client *client) {
    const wheel_view *view = &client->view;
    CHECK(view->state <= 6u && view->request <= 2u && view->step <= WHEEL_STEP_ELSEWHERE);
    CHECK(view->out_bytes <= WHEEL_CLIENT_OUT && are_messages(wheel_client_out(client), view->out_bytes));
    CHECK(client->sent_log.used <= LOG && are_messages(sent_log, client->sent_log.used));
    CHECK(client->received_log.used <= LOG && are_messages(received_log, client->received_log.used));
    CHECK(!view->has_feedback || view->snapshots > 0u);
    CHECK(view->snapshots > 0u || (isnan(view->yaw_rate_rad_s) && isnan(view->current_a[0])));
    CHECK(view->round_trips <= 256u || view->round_trip_ns >= 0);
}

static void take(wheel_client *client, const uint8_t *bytes, size_t size, int64_t now_ns) {
    uint8_t *packed = exactly(bytes, size);
    size_t at = 0;
    while (at < size) {
        const wheel_view before = client->view;
        const size_t end = wheel_client_take(client, packed, at, size, now_ns);
        CHECK(end >= at && end <= size);
        CHECK(client->view.snapshots >= before.snapshots && client->view.received >= before.received);
        CHECK(client->view.message_id == 0u ||
              (client->view.message_at >= at && client->view.message_at < end));
        check(client);
        if (end == at) {
            size_t logged[2];
            CHECK(client->view.log_is_due);
            wheel_client_log_take(client, logged);
            CHECK(logged[1] > 0u);
        }
        at = end;
    }
    free(packed);
}

static void call(wheel_client *client, uint8_t what, const double *values, int64_t now_ns) {
    size_t logged[2];
    switch (what % 16u) {
    case 0:
        wheel_client_poll(client, now_ns);
        break;
    case 1:
        CHECK(wheel_client_arm(client, what % 3u == 0u ? -1 : now_ns) <= WHEEL_ARMING_LATCHED);
        break;
    case 2:
    case 3:
        CHECK(wheel_client_command(client, values, values + (what & 64u) / 16u, now_ns) <= 255);
        break;
    case 4:
        wheel_client_request(client, what / 16u, now_ns);
        break;
    case 5:
        wheel_client_estop(client);
        break;
    case 6:
        wheel_client_add(client, (uint16_t)(what * 8u), (const uint8_t *)values, what / 16u % 9u);
        break;
    case 7:
    case 8:
        wheel_client_step(client, (uint16_t)(what * 9u));
        break;
    case 9:
        if ((what & 16u) != 0u) {
            wheel_client_step_again(client);
        } else {
            const uint8_t first = what / 32u % 4u;
            const uint8_t wheels[4] = {first, (first + 1u) % 4u, (first + 2u) % 4u,
                                       (first + 3u) % (what < 224u ? 4u : 8u)};
            CHECK(wheel_client_wire(client, wheels, (int8_t[4]){1, -1, -1, 1}) ==
                  (wheels[3] == (first + 3u) % 4u));
        }
        break;
    case 10:
        wheel_client_leave(client);
        break;
    case 11:
        wheel_client_begin(client, what);
        break;
    case 12:
        wheel_client_renew(client, what);
        break;
    case 13:
        wheel_client_unsent(client);
        break;
    case 14:
        if ((what & 16u) != 0u) {
            wheel_client_log(client, sent_log, received_log, LOG);
        } else {
            wheel_client_log_take(client, logged);
        }
        break;
    default:
        wheel_client_sent(client);
    }
    check(client);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    if (size < CALLS) {
        return 0;
    }
    wheel_client client;
    wheel_line line;
    double values[8];
    wheel_client_init(&client, data[0] & 1u, wire_parameter_check(), 1);
    wheel_client_log(&client, sent_log, received_log, LOG);
    wheel_line_init(&line);
    const uint8_t *stream = data + CALLS;
    const size_t length = size - CALLS;
    size_t done = 0;
    int64_t now_ns = 0;
    for (size_t i = 0; i < CALLS; i++) {
        for (size_t j = 0; j < 8u; j++) {
            values[j] =
                data[(i + j) % CALLS] % 64u == 63u ? (double)NAN : (data[(i + j) % CALLS] - 128.0) / 2.0;
        }
        call(&client, data[i], values, now_ns);
        const size_t end = length * (i + 1u) / CALLS;
        uint8_t *packed = malloc(end - done + WHEEL_LINE_OPEN);
        CHECK(packed != NULL);
        size_t used = 0;
        wheel_line_feed(&line, stream + done, end - done, packed, &used);
        take(&client, packed, used, now_ns);
        free(packed);
        done = end;
        now_ns += (int64_t)data[i] * 1000000;
    }
    take(&client, stream, length, now_ns);
    return 0;
}
