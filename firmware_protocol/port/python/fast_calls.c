#include "fast_calls.h"

#include "../../client/wheel_client.h"
#include "../host/direct.h"
#include "internal.h"

#include <math.h>

wheel_python python;

void wheel_python_begin(const wheel_python *given) {
    python = *given;
}

/* Numbers of arguments are the caller's matter: fast_calls.py makes the functions, and they are private to
 * this package. What the arguments are is CPython's: it sets an exception for what is no number or no tuple.
 * `self` is an int that fast_calls.py has made of an address.
 */

/* Reads the ticks of a STEP; what is no such number becomes one that no STEP may have. */
static uint16_t ticks_of(void *object) {
    const long long ticks = integer(object);
    return ticks < 0 || ticks > UINT16_MAX ? UINT16_MAX : (uint16_t)ticks;
}

void *wheel_python_command(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_client *client = address(self);
    const int64_t now_ns = integer(arguments[2]);
    double speed_rad_s[4];
    double torque_n_m[4];
    if (!numbers(arguments[0], 4, speed_rad_s) || !numbers(arguments[1], 4, torque_n_m) || failed()) {
        return NULL;
    }
    return python.PyLong_FromLongLong(wheel_client_command(client, speed_rad_s, torque_n_m, now_ns));
}

void *wheel_python_within(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    double four[4];
    double limit;
    if (!numbers(arguments[0], 4, four) || !number(arguments[1], &limit)) {
        return NULL;
    }
    bool is_within = true;
    for (size_t i = 0; i < 4u; i++) {
        is_within = is_within && four[i] >= -limit && four[i] <= limit;
    }
    return python.PyBool_FromLong(is_within);
}

void *wheel_python_poll(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_client *client = address(self);
    const int64_t now_ns = integer(arguments[0]);
    return failed() ? NULL : python.PyBool_FromLong(wheel_client_poll(client, now_ns));
}

void *wheel_python_step(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_direct *direct = address(self);
    wheel_host *robot = address(arguments[0]);
    wheel_client *client = address(arguments[1]);
    const uint16_t ticks = ticks_of(arguments[2]);
    const int64_t now_ns = integer(arguments[3]);
    if (failed()) {
        return NULL;
    }
    /* Other threads must be able to end a plant that hangs. To let them run takes a thirtieth of a plain
     * tick. */
    void *thread = direct->may_hang ? python.PyEval_SaveThread() : NULL;
    const bool is_whole = wheel_direct_step(direct, robot, client, ticks, now_ns);
    if (thread != NULL) {
        python.PyEval_RestoreThread(thread);
    }
    return python.PyBool_FromLong(is_whole);
}

void *wheel_python_link_figures(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    const wheel_view *view = wheel_client_view(address(self));
    const double lost = (double)view->lost + view->incomplete;
    const double round_trip_ms = view->round_trips == 0u ? (double)NAN : (double)view->round_trip_ns * 1e-6;
    return floats((double[]){(double)view->sent, (double)view->received, lost, round_trip_ms}, 4);
}

void *wheel_python_line_bytes(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    const wheel_direct *direct = address(self);
    const uint64_t waiting = direct->waiting->out_serial_bytes + direct->held_line_bytes;
    const uint64_t sent = direct->sent_bytes + waiting - direct->sent_bytes_before;
    const uint64_t received = direct->received_bytes - direct->received_bytes_before;
    return floats((double[]){(double)sent, (double)received}, 2);
}

void *wheel_python_out(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    const wheel_client *client = address(self);
    return new_bytes(wheel_client_out(client), wheel_client_view(client)->out_bytes);
}

void *wheel_python_sent(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    wheel_client *client = address(self);
    const long long frames = wheel_client_view(client)->out_frames;
    wheel_client_sent(client);
    return python.PyLong_FromLongLong(frames);
}

void *wheel_python_ask(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_client *client = address(self);
    const uint16_t ticks = ticks_of(arguments[0]);
    if (failed()) {
        return NULL;
    }
    return python.PyBool_FromLong(wheel_client_step(client, ticks));
}

void *wheel_python_take(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_client *client = address(self);
    const long long begin = integer(arguments[1]);
    const int64_t now_ns = integer(arguments[2]);
    uint8_t *packed;
    size_t length;
    if (failed() || !bytes_of(arguments[0], &packed, &length)) {
        return NULL;
    }
    if (begin < 0) {
        python.PyErr_BadArgument();
        return NULL;
    }
    return python.PyLong_FromLongLong(
        (long long)wheel_client_take(client, packed, (size_t)begin, length, now_ns));
}

void *wheel_python_receive(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_line *line = address(self);
    wheel_client *client = address(arguments[0]);
    const int64_t now_ns = integer(arguments[2]);
    uint8_t *bytes;
    uint8_t *packed;
    size_t length;
    size_t used;
    if (failed() || !bytes_of(arguments[1], &bytes, &length)) {
        return NULL;
    }
    void *room = new_bytes(NULL, length + WHEEL_LINE_OPEN);
    if (!bytes_of(room, &packed, &used)) {
        return NULL;
    }
    const wheel_view *view = wheel_client_view(client);
    const size_t frames = wheel_line_feed(line, bytes, length, packed, &used);
    const size_t at = wheel_client_take(client, packed, 0, used, now_ns);
    void *result;
    if (at == used && view->message_id == 0u && !view->log_is_due && !wheel_client_poll(client, now_ns)) {
        result = python.PyLong_FromLongLong((long long)frames);
    } else {
        result = python.PyTuple_New(2);
        python.PyTuple_SetItem(result, 0, new_bytes(packed, used));
        python.PyTuple_SetItem(result, 1, python.PyLong_FromLongLong((long long)at));
    }
    python.Py_DecRef(room);
    return result;
}

void *wheel_python_encode(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_line *line = address(self);
    const wheel_client *client = address(arguments[0]);
    uint8_t bytes[WHEEL_LINE_GROWTH * WHEEL_CLIENT_OUT];
    const size_t length = wheel_client_view(client)->out_bytes;
    return new_bytes(bytes, wheel_line_encode(line, wheel_client_out(client), length, bytes));
}

void *wheel_python_hold(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_direct *direct = address(self);
    wheel_host *robot = address(arguments[0]);
    uint8_t *packed;
    size_t length;
    if (!bytes_of(arguments[1], &packed, &length)) {
        return NULL;
    }
    void *thread = python.PyEval_SaveThread();
    wheel_direct_hold(direct, robot, packed, length);
    python.PyEval_RestoreThread(thread);
    return python.PyLong_FromLongLong(direct->held_frames);
}

void *wheel_python_exchange(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_direct *direct = address(self);
    wheel_host *robot = address(arguments[0]);
    wheel_client *client = address(arguments[1]);
    const uint16_t ticks = ticks_of(arguments[2]);
    if (failed()) {
        return NULL;
    }
    if (client != NULL && !wheel_client_step(client, ticks)) {
        return none();
    }
    void *thread = python.PyEval_SaveThread();
    wheel_direct_exchange(direct, robot, client);
    python.PyEval_RestoreThread(thread);
    return new_bytes(direct->answer, direct->answer_bytes);
}

void *wheel_python_crossed(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    const wheel_direct *direct = address(self);
    void *all = python.PyTuple_New(4);
    if (all != NULL) {
        python.PyTuple_SetItem(all, 0, new_bytes(direct->stepped, direct->stepped_bytes));
        python.PyTuple_SetItem(all, 1, python.PyLong_FromLongLong(direct->stepped_frames));
        python.PyTuple_SetItem(all, 2, new_bytes(direct->answer, direct->answer_bytes));
        python.PyTuple_SetItem(all, 3, python.PyLong_FromLongLong(direct->answer_frames));
    }
    return all;
}

void *wheel_python_split(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const long long limit = integer(arguments[1]);
    uint8_t *packed;
    uint8_t *sorted;
    size_t length;
    size_t used;
    if (failed() || !bytes_of(arguments[0], &packed, &length)) {
        return NULL;
    }
    void *room = new_bytes(NULL, length);
    void *groups = python.PyTuple_New(2);
    if (bytes_of(room, &sorted, &used)) {
        const size_t below = wheel_packed_split(packed, length, (uint16_t)limit, sorted, &used);
        python.PyTuple_SetItem(groups, 0, new_bytes(sorted, below));
        python.PyTuple_SetItem(groups, 1, new_bytes(sorted + below, used - below));
    }
    python.Py_DecRef(room);
    return groups;
}

void *wheel_python_noise(void *self, void *const *arguments, ptrdiff_t count) {
    (void)arguments, (void)count;
    wheel_line_counts counts;
    wheel_line_count(address(self), &counts);
    return python.PyLong_FromLongLong((long long)counts.cobs + counts.crc + counts.length +
                                      counts.unknown_id + counts.overrun);
}
