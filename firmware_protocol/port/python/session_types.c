/* A host's session with a robot: Client, Line, Node and Direct. */
#include "../../client/wheel_client.h"
#include "../../client/wheel_line.h"
#include "../host/direct.h"
#include "internal.h"

#include <math.h>
#include <string.h>

/* Reads the ticks of a STEP; what is no such number becomes one that no STEP may have. */
static bool ticks_of(PyObject *object, uint16_t *ticks) {
    int64_t value;
    const bool is_number = integer(object, &value);
    *ticks = value < 0 || value > UINT16_MAX ? UINT16_MAX : (uint16_t)value;
    return is_number;
}

/* Client: `held` are the arguments, and tuples that are used again while their numbers stay the same, for
 * what changes in few of the calls. */

typedef OWNER(struct {
    wheel_client client;
    PyObject *feedback; /* classes of the tuples, and a tuple of the robot's states; borrowed */
    PyObject *wheels;
    PyObject *states;
    float kept[HELD][4]; /* the numbers of `held` */
}) client_object;

INIT(client_init) {
    client_object *it = (client_object *)self;
    unsigned char mode;
    unsigned char check;
    int nonce;
    PyObject *feedback;
    PyObject *wheels;
    PyObject *states;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "bbiOOO:Client", &mode, &check, &nonce, &feedback, &wheels, &states) ||
        !wheel_is_kind(feedback) || !wheel_is_kind(wheels)) {
        return -1;
    }
    if (nonce < 0 || nonce > UINT16_MAX) {
        PyErr_Format(PyExc_ValueError, "a Client with nonce %d; expected 0 to 65535", nonce);
        return -1;
    }
    hold(&it->base.held[0], again(arguments));
    it->owned.feedback = feedback;
    it->owned.wheels = wheels;
    it->owned.states = states;
    wheel_client_init(&it->owned.client, mode, check, (uint16_t)nonce);
    return 0;
}

static PyObject *floats_of(PyObject *kind, const float *values, Py_ssize_t count) {
    double four[4];
    for (Py_ssize_t i = 0; i < count; i++) {
        four[i] = (double)values[i];
    }
    return wheel_floats(kind, four, count);
}

static PyObject *kept(client_object *it, size_t place, PyObject *kind, const float *values,
                      Py_ssize_t count) {
    const size_t size = sizeof(float) * (size_t)count;
    if (it->base.held[place] == NULL || memcmp(it->owned.kept[place], values, size) != 0) {
        hold(&it->base.held[place], floats_of(kind, values, count));
        memcpy(it->owned.kept[place], values, size);
    }
    return it->base.held[place] == NULL ? NULL : again(it->base.held[place]);
}

static PyObject *feedback_of(client_object *it) {
    const wheel_view *view = wheel_client_view(&it->owned.client);
    if (!view->has_feedback) {
        return none();
    }
    PyObject *state = item(it->owned.states, view->state);
    if (state == NULL) {
        return NULL;
    }
    PyObject *counts[4];
    for (size_t i = 0; i < 4u; i++) {
        counts[i] = PyLong_FromLongLong(view->encoder_count[i]);
    }
    return JOINED(
        it->owned.feedback, PyLong_FromLongLong((long long)view->robot_time_us * 1000), again(state),
        PyLong_FromLongLong(view->command_sequence), PyLong_FromLongLong(view->command_age_ms),
        wheel_joined(NULL, counts, 4), floats_of(it->owned.wheels, view->speed_rad_s, 4),
        kept(it, 1, it->owned.wheels, view->current_a, 4), kept(it, 2, NULL, view->acceleration_m_s2, 3),
        PyFloat_FromDouble((double)view->yaw_rate_rad_s));
}

CALL_OF_NONE(client_feedback) {
    (void)unused;
    return wheel_owned(self, CLIENT) == NULL ? NULL : feedback_of((client_object *)self);
}

CALL_OF_ONE(client_poll) {
    int64_t now_ns;
    return integer(given, &now_ns) ? PyBool_FromLong(wheel_client_poll(OWNED(wheel_client, self), now_ns))
                                   : NULL;
}

CALL(client_command) {
    double speed_rad_s[4];
    double torque_n_m[4];
    int64_t now_ns;
    if (!TAKES("command", 3) || !numbers(given[0], 4, speed_rad_s) || !numbers(given[1], 4, torque_n_m) ||
        !integer(given[2], &now_ns)) {
        return NULL;
    }
    return PyLong_FromLongLong(
        wheel_client_command(OWNED(wheel_client, self), speed_rad_s, torque_n_m, now_ns));
}

CALL_OF_NONE(client_link_figures) {
    const wheel_view *view = wheel_client_view(OWNED(wheel_client, self));
    (void)unused;
    return FLOATS((double)view->sent, (double)view->received, (double)view->lost + view->incomplete,
                  view->round_trips == 0u ? (double)NAN : (double)view->round_trip_ns * 1e-6);
}

CALL_OF_NONE(client_packed) {
    const wheel_client *client = OWNED(wheel_client, self);
    (void)unused;
    return new_bytes(wheel_client_out(client), wheel_client_view(client)->out_bytes);
}

CALL_OF_NONE(client_sent) {
    wheel_client *client = OWNED(wheel_client, self);
    const uint32_t frames = wheel_client_view(client)->out_frames;
    (void)unused;
    wheel_client_sent(client);
    return PyLong_FromLongLong(frames);
}

CALL_OF_ONE(client_ask) {
    uint16_t ticks;
    return ticks_of(given, &ticks) ? PyBool_FromLong(wheel_client_step(OWNED(wheel_client, self), ticks))
                                   : NULL;
}

CALL(client_take) {
    int64_t begin;
    int64_t now_ns;
    uint8_t *packed;
    size_t length;
    if (!TAKES("take", 3) || !bytes_of(given[0], &packed, &length) || !integer(given[1], &begin) ||
        !integer(given[2], &now_ns)) {
        return NULL;
    }
    if (begin < 0) {
        return PyErr_Format(PyExc_ValueError, "take() from place %R on; expected 0 or more", given[1]);
    }
    return PyLong_FromLongLong(
        (long long)wheel_client_take(OWNED(wheel_client, self), packed, (size_t)begin, length, now_ns));
}

static PyMethodDef client_methods[] = {
    METHOD("feedback", client_feedback, METH_NOARGS, "Return the newest snapshot; None before the first."),
    METHOD("poll", client_poll, METH_O, "Add HELLO and the heartbeat if due [ns]; return whether one was."),
    METHOD("command", client_command, METH_FASTCALL,
           "Add speeds [rad/s] and torques [N.m] at a time [ns]; return the sequence number, or -1."),
    METHOD("link_figures", client_link_figures, METH_NOARGS,
           "Return messages sent and received, snapshots lost or incomplete, newest round trip [ms] or NaN."),
    METHOD("packed", client_packed, METH_NOARGS, "Return the frames that wait to be sent."),
    METHOD("sent", client_sent, METH_NOARGS, "Forget the frames of packed(); return their number."),
    METHOD("ask", client_ask, METH_O, "Add a STEP of so many ticks; return False if it cannot be sent."),
    METHOD("take", client_take, METH_FASTCALL,
           "Take packed frames from a place on, at a time [ns]; return where the next one begins."),
    END};
static PyType_Slot client_slots[] = {
    SLOTS("Client(mode, parameter_check, nonce, Feedback, Wheels, states): a session (wheel_client.h).",
          client_init, client_methods),
    {0, NULL}};

/* Line */

typedef OWNER(wheel_line) line_object;

INIT(line_init) {
    (void)unused;
    wheel_line_init(OWNED(wheel_line, self));
    return PyArg_ParseTuple(arguments, ":Line") ? hold(&HELD_BY(self)[0], again(arguments)), 0 : -1;
}

CALL(line_receive_for) {
    wheel_line *line = OWNED(wheel_line, self);
    wheel_client *client;
    uint8_t *bytes;
    uint8_t *packed;
    size_t length;
    size_t used;
    int64_t now_ns;
    if (!TAKES("receive_for", 3) || (client = wheel_owned(given[0], CLIENT)) == NULL ||
        !bytes_of(given[1], &bytes, &length) || !integer(given[2], &now_ns)) {
        return NULL;
    }
    PyObject *room = new_bytes(NULL, length + WHEEL_LINE_OPEN);
    if (room == NULL || !bytes_of(room, &packed, &used)) {
        return NULL;
    }
    const wheel_view *view = wheel_client_view(client);
    const size_t frames = wheel_line_feed(line, bytes, length, packed, &used);
    const size_t at = wheel_client_take(client, packed, 0, used, now_ns);
    const bool is_all = at == used && view->message_id == 0u && !view->log_is_due;
    PyObject *result = is_all && !wheel_client_poll(client, now_ns)
                           ? PyLong_FromLongLong((long long)frames)
                           : JOINED(NULL, new_bytes(packed, used), PyLong_FromLongLong((long long)at));
    Py_DecRef(room);
    return result;
}

CALL_OF_ONE(line_encode_for) {
    const wheel_client *client = wheel_owned(given, CLIENT);
    uint8_t bytes[WHEEL_LINE_GROWTH * WHEEL_CLIENT_OUT];
    if (client == NULL) {
        return NULL;
    }
    const size_t length = wheel_client_view(client)->out_bytes;
    return new_bytes(bytes,
                     wheel_line_encode(OWNED(wheel_line, self), wheel_client_out(client), length, bytes));
}

CALL_OF_NONE(line_noise) {
    wheel_line_counts counts;
    (void)unused;
    wheel_line_count(OWNED(wheel_line, self), &counts);
    return PyLong_FromLongLong((long long)counts.cobs + counts.crc + counts.length + counts.unknown_id +
                               counts.overrun);
}

static PyMethodDef line_methods[] = {
    METHOD(
        "receive_for", line_receive_for, METH_FASTCALL,
        "Have a client take received bytes at a time [ns], and add what is due. Return the number of frames; "
        "if the client needs attention, the packed frames and how far it took them."),
    METHOD("encode_for", line_encode_for, METH_O, "Return the frames that wait in a client as bytes."),
    METHOD("noise", line_noise, METH_NOARGS, "Return how many pieces of what was received were no frame."),
    END};
static PyType_Slot line_slots[] = {
    SLOTS("Line(): both directions of a serial line (wheel_line.h).", line_init, line_methods), {0, NULL}};

/* Node */

INIT(node_init) {
    PyObject *parameters;
    PyObject *stored;
    unsigned short capabilities;
    unsigned char reset_cause;
    Py_ssize_t exchange;
    Py_ssize_t context;
    wheel_parameters values;
    uint8_t *bytes;
    uint8_t *kept_bytes = NULL;
    size_t length;
    size_t kept_length = wheel_host_stored_size();
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "OOHbnn:Node", &parameters, &stored, &capabilities, &reset_cause,
                          &exchange, &context) ||
        !bytes_of(parameters, &bytes, &length) ||
        (stored != &_Py_NoneStruct && !bytes_of(stored, &kept_bytes, &kept_length))) {
        return -1;
    }
    if (length != sizeof values || kept_length != wheel_host_stored_size()) {
        PyErr_Format(PyExc_ValueError, "%zd bytes of parameters and %zd stored bytes; expected %zd and %zd",
                     length, kept_length, sizeof values, wheel_host_stored_size());
        return -1;
    }
    memcpy(&values, bytes, sizeof values);
    wheel_host_init(OWNED(wheel_host, self), &values, kept_bytes, capabilities, reset_cause,
                    (wheel_plant_exchange)(uintptr_t)exchange, (void *)context);
    hold(&HELD_BY(self)[0], again(arguments));
    return 0;
}

static PyMethodDef no_methods[] = {END};
static PyType_Slot node_slots[] = {SLOTS("Node(parameters, stored, capabilities, reset_cause, exchange, "
                                         "context): a robot's firmware (host.h), of "
                                         "bytes of wheel_parameters, what it stored or None, and addresses "
                                         "of the plant's C function and context.",
                                         node_init, no_methods),
                                   {0, NULL}};

/* Direct: `held` are the lines there and here, and the client. */

typedef OWNER(wheel_direct) direct_object;
enum { THERE, HERE, SERVED };

INIT(direct_init) {
    wheel_direct *direct = OWNED(wheel_direct, self);
    PyObject *there;
    int may_hang;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "Op:Direct", &there, &may_hang) || wheel_owned(there, LINE) == NULL) {
        return -1;
    }
    direct->there = wheel_owned(there, LINE);
    hold(&HELD_BY(self)[THERE], again(there));
    direct->may_hang = may_hang != 0;
    return 0;
}

CALL_OF_ONE(direct_listen) {
    wheel_line *line = wheel_owned(given, LINE);
    if (line == NULL) {
        return NULL;
    }
    OWNED(wheel_direct, self)->here = line;
    hold(&HELD_BY(self)[HERE], again(given));
    return none();
}

CALL_OF_ONE(direct_serve) {
    const wheel_client *client = wheel_owned(given, CLIENT);
    if (client == NULL) {
        return NULL;
    }
    OWNED(wheel_direct, self)->waiting = wheel_client_view(client);
    hold(&HELD_BY(self)[SERVED], again(given));
    return none();
}

/* Whether both lines are there, and if it is asked for a client; false with an exception. */
static bool is_ready(PyObject *self, bool with_client) {
    PyObject *const *held = HELD_BY(self);
    if (held[THERE] != NULL && held[HERE] != NULL && (held[SERVED] != NULL || !with_client)) {
        return true;
    }
    PyErr_Format(PyExc_RuntimeError, "call listen() and serve() of a Direct first");
    return false;
}

CALL(direct_step) {
    wheel_direct *direct = OWNED(wheel_direct, self);
    wheel_host *robot;
    uint16_t ticks;
    int64_t now_ns;
    if (!TAKES("step", 3) || (robot = wheel_owned(given[0], NODE)) == NULL || !ticks_of(given[1], &ticks) ||
        !integer(given[2], &now_ns) || !is_ready(self, true)) {
        return NULL;
    }
    wheel_client *client = OWNED(wheel_client, HELD_BY(self)[SERVED]);
    /* Other threads must be able to end a plant that hangs. To let them run takes a thirtieth of a plain
     * tick. */
    PyThreadState *thread = direct->may_hang ? PyEval_SaveThread() : NULL;
    const bool is_whole = wheel_direct_step(direct, robot, client, ticks, now_ns);
    if (thread != NULL) {
        PyEval_RestoreThread(thread);
    }
    return PyBool_FromLong(is_whole);
}

CALL_OF_NONE(direct_line_bytes) {
    const wheel_direct *direct = OWNED(wheel_direct, self);
    const uint64_t waiting = direct->waiting == NULL ? 0u : direct->waiting->out_serial_bytes;
    const uint64_t sent = direct->sent_bytes + waiting + direct->held_line_bytes;
    (void)unused;
    return FLOATS((double)(sent - direct->sent_bytes_before),
                  (double)(direct->received_bytes - direct->received_bytes_before));
}

CALL(direct_hold) {
    wheel_direct *direct = OWNED(wheel_direct, self);
    wheel_host *robot;
    uint8_t *packed;
    size_t length;
    if (!TAKES("hold", 2) || (robot = wheel_owned(given[0], NODE)) == NULL ||
        !bytes_of(given[1], &packed, &length) || !is_ready(self, false)) {
        return NULL;
    }
    PyThreadState *thread = PyEval_SaveThread();
    wheel_direct_hold(direct, robot, packed, length);
    PyEval_RestoreThread(thread);
    return none();
}

CALL(direct_exchange) {
    wheel_direct *direct = OWNED(wheel_direct, self);
    wheel_host *robot;
    uint16_t ticks = 0;
    if (!TAKES("exchange", 2) || (robot = wheel_owned(given[0], NODE)) == NULL) {
        return NULL;
    }
    const bool is_step = given[1] != &_Py_NoneStruct;
    if (!is_ready(self, is_step) || (is_step && !ticks_of(given[1], &ticks))) {
        return NULL;
    }
    wheel_client *client = is_step ? OWNED(wheel_client, HELD_BY(self)[SERVED]) : NULL;
    if (is_step && !wheel_client_step(client, ticks)) {
        return none();
    }
    PyThreadState *thread = PyEval_SaveThread();
    wheel_direct_exchange(direct, robot, client);
    PyEval_RestoreThread(thread);
    return new_bytes(direct->answer, direct->answer_bytes);
}

CALL_OF_NONE(direct_crossed) {
    const wheel_direct *direct = OWNED(wheel_direct, self);
    (void)unused;
    return JOINED(
        NULL, new_bytes(direct->stepped, direct->stepped_bytes), PyLong_FromLongLong(direct->stepped_frames),
        new_bytes(direct->answer, direct->answer_bytes), PyLong_FromLongLong(direct->answer_frames));
}

static PyMethodDef direct_methods[] = {
    METHOD("listen", direct_listen, METH_O, "Set the client's end of the line, for what it receives."),
    METHOD("serve", direct_serve, METH_O, "Set the client whose frames step() and exchange() send."),
    METHOD(
        "step", direct_step, METH_FASTCALL,
        "Send what waits and a STEP of so many ticks to a Node at a time [ns]; the client takes the answer. "
        "Return whether that was all."),
    METHOD("line_bytes", direct_line_bytes, METH_NOARGS, "Return the bytes on the line, sent and received."),
    METHOD("hold", direct_hold, METH_FASTCALL, "Keep packed frames for the next exchange with a Node."),
    METHOD("exchange", direct_exchange, METH_FASTCALL,
           "Send what waits to a Node, and a STEP unless its ticks are None. Return the answer; None if the "
           "STEP "
           "cannot be sent."),
    METHOD("crossed", direct_crossed, METH_NOARGS,
           "Return what the newest exchange sent of the client's, and the answer, each with its frames' "
           "number."),
    END};
static PyType_Slot direct_slots[] = {
    SLOTS("Direct(line, may_hang): a line in memory to a Node in this thread (direct.h), and its end there.",
          direct_init, direct_methods),
    {0, NULL}};

PyType_Spec wheel_specs_of_session[] = {SPEC("Client", client_object, client_slots),
                                        SPEC("Line", line_object, line_slots),
                                        SPEC("Node", owner, node_slots), /* and wheel_host_size() more */
                                        SPEC("Direct", direct_object, direct_slots)};
