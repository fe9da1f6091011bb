#include "fast_calls.h"

#include "../../client/wheel_client.h"
#include "../host/direct.h"

static wheel_python python;

void wheel_python_begin(const wheel_python *given) {
    python = *given;
}

/* Numbers of arguments are the caller's matter: fast_calls.py makes the functions, and they are private to
 * this package. What the arguments are is CPython's: it sets an exception for what is no number or no tuple.
 */

static bool failed(void) {
    return python.PyErr_Occurred() != NULL;
}

/* Reads a number; false with an exception. */
static bool number(void *object, double *value) {
    *value = python.PyFloat_AsDouble(object);
    return *value != -1.0 || !failed();
}

static bool numbers(void *tuple, ptrdiff_t count, double *values) {
    for (ptrdiff_t i = 0; i < count; i++) {
        void *item = python.PyTuple_GetItem(tuple, i);
        if (item == NULL || !number(item, &values[i])) {
            return false;
        }
    }
    return true;
}

void *wheel_python_command(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[0]);
    const int64_t now_ns = python.PyLong_AsLongLong(arguments[3]);
    double speed_rad_s[4];
    double torque_n_m[4];
    if (!numbers(arguments[1], 4, speed_rad_s) || !numbers(arguments[2], 4, torque_n_m) || failed()) {
        return NULL;
    }
    return python.PyLong_FromLongLong(wheel_client_command(client, speed_rad_s, torque_n_m, now_ns));
}

void *wheel_python_poll(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[0]);
    const int64_t now_ns = python.PyLong_AsLongLong(arguments[1]);
    return failed() ? NULL : python.PyBool_FromLong(wheel_client_poll(client, now_ns));
}

void *wheel_python_step(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_direct *direct = python.PyLong_AsVoidPtr(arguments[0]);
    wheel_host *robot = python.PyLong_AsVoidPtr(arguments[1]);
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[2]);
    const long long ticks = python.PyLong_AsLongLong(arguments[3]);
    const int64_t now_ns = python.PyLong_AsLongLong(arguments[4]);
    if (failed()) {
        return NULL;
    }
    /* A plant in a process of its own may take long, or hang: others must be able to end it. */
    void *thread = python.PyEval_SaveThread();
    const bool is_whole = wheel_direct_step(direct, robot, client, (uint16_t)ticks, now_ns);
    python.PyEval_RestoreThread(thread);
    return python.PyBool_FromLong(is_whole);
}

/* Returns a new tuple with room for `more` further items behind the whole numbers. */
static void *tuple_of(const long long *whole, ptrdiff_t count, ptrdiff_t more) {
    void *tuple = python.PyTuple_New(count + more);
    for (ptrdiff_t i = 0; tuple != NULL && i < count; i++) {
        python.PyTuple_SetItem(tuple, i, python.PyLong_FromLongLong(whole[i]));
    }
    return tuple;
}

/* Returns the view of the client at an address; NULL with an exception. */
static const wheel_view *view_at(void *address) {
    const wheel_client *client = python.PyLong_AsVoidPtr(address);
    return client == NULL ? NULL : wheel_client_view(client);
}

void *wheel_python_snapshot(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const wheel_view *view = view_at(arguments[0]);
    if (view == NULL) {
        return NULL;
    }
    const uint16_t *encoders = view->encoder_count;
    const long long whole[] = {view->snapshots,
                               view->round_trips,
                               view->slow,
                               view->round_trip_ns,
                               1000 * (long long)view->robot_time_us,
                               view->state,
                               view->command_sequence,
                               view->command_age_ms};
    void *snapshot = tuple_of(whole, 8, 2);
    void *counts = tuple_of((long long[]){encoders[0], encoders[1], encoders[2], encoders[3]}, 4, 0);
    void *speeds = python.PyTuple_New(4);
    if (snapshot == NULL || counts == NULL || speeds == NULL) {
        return NULL; /* no memory: what was made is lost with the process */
    }
    for (ptrdiff_t i = 0; i < 4; i++) {
        python.PyTuple_SetItem(speeds, i, python.PyFloat_FromDouble((double)view->speed_rad_s[i]));
    }
    python.PyTuple_SetItem(snapshot, 8, counts);
    python.PyTuple_SetItem(snapshot, 9, speeds);
    return snapshot;
}

void *wheel_python_counts(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const wheel_view *view = view_at(arguments[0]);
    if (view == NULL) {
        return NULL;
    }
    const long long whole[] = {(long long)view->sent, (long long)view->received,
                               (long long)view->lost + view->incomplete};
    return tuple_of(whole, 3, 0);
}

/* Reads bytes; false with an exception. */
static bool bytes_of(void *object, uint8_t **bytes, size_t *length) {
    char *start;
    ptrdiff_t size;
    if (python.PyBytes_AsStringAndSize(object, &start, &size) < 0) {
        return false;
    }
    *bytes = (uint8_t *)start;
    *length = (size_t)size;
    return true;
}

static void *new_bytes(const uint8_t *bytes, size_t length) {
    return python.PyBytes_FromStringAndSize((const char *)bytes, (ptrdiff_t)length);
}

void *wheel_python_out(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const wheel_client *client = python.PyLong_AsVoidPtr(arguments[0]);
    return new_bytes(wheel_client_out(client), wheel_client_view(client)->out_bytes);
}

void *wheel_python_sent(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_client_sent(python.PyLong_AsVoidPtr(arguments[0]));
    return python.PyBool_FromLong(false);
}

void *wheel_python_ask(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[0]);
    const long long ticks = python.PyLong_AsLongLong(arguments[1]);
    if (failed()) {
        return NULL;
    }
    return python.PyBool_FromLong(wheel_client_step(client, (uint16_t)ticks));
}

void *wheel_python_take(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[0]);
    const long long begin = python.PyLong_AsLongLong(arguments[2]);
    const int64_t now_ns = python.PyLong_AsLongLong(arguments[3]);
    uint8_t *packed;
    size_t length;
    if (failed() || !bytes_of(arguments[1], &packed, &length)) {
        return NULL;
    }
    return python.PyLong_FromLongLong(
        (long long)wheel_client_take(client, packed, (size_t)begin, length, now_ns));
}

void *wheel_python_exchange(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    wheel_direct *direct = python.PyLong_AsVoidPtr(arguments[0]);
    wheel_host *robot = python.PyLong_AsVoidPtr(arguments[1]);
    wheel_client *client = python.PyLong_AsVoidPtr(arguments[2]);
    uint8_t *packed;
    size_t length;
    if (!bytes_of(arguments[3], &packed, &length)) {
        return NULL;
    }
    void *thread = python.PyEval_SaveThread();
    wheel_direct_send(direct, robot, packed, length);
    wheel_direct_send(direct, robot, wheel_client_out(client), wheel_client_view(client)->out_bytes);
    wheel_client_sent(client);
    wheel_direct_receive(direct, robot);
    python.PyEval_RestoreThread(thread);
    return new_bytes(direct->answer, direct->answer_bytes);
}

void *wheel_python_split(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const long long limit = python.PyLong_AsLongLong(arguments[1]);
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
