/* The calls of a tick, as CPython calls its own functions (METH_FASTCALL): in a fifth of the time that a
 * foreign function interface takes.
 *
 * There is no Python.h in this: the functions that it needs of CPython's stable ABI (PEP 384) are given to
 * `wheel_python_begin` once, so that the library is the same for every Python and links against none.
 * firmware_protocol/fast_calls.py makes the Python functions.
 */
#ifndef WHEEL_FAST_CALLS_H
#define WHEEL_FAST_CALLS_H

#include <stddef.h>
#include <stdint.h>

/* cffi: begin */
/* Functions of the stable ABI, by their names there. */
typedef struct {
    double (*PyFloat_AsDouble)(void *);
    long long (*PyLong_AsLongLong)(void *);
    long long (*PyLong_AsLongLongAndOverflow)(void *, int *);
    unsigned long long (*PyLong_AsUnsignedLongLongMask)(void *); /* modulo 2^64 */
    void *(*PyErr_Occurred)(void);
    void (*PyErr_Clear)(void);
    void *(*PyTuple_GetItem)(void *, ptrdiff_t);    /* borrowed */
    void *(*PySequence_GetItem)(void *, ptrdiff_t); /* a new reference */
    void *(*PyTuple_New)(ptrdiff_t);
    ptrdiff_t (*PyTuple_Size)(void *);
    int (*PyTuple_SetItem)(void *, ptrdiff_t, void *); /* steals the reference */
    int (*PyList_SetItem)(void *, ptrdiff_t, void *);  /* steals the reference */
    void *(*PyFloat_FromDouble)(double);
    void *(*PyLong_FromLongLong)(long long);
    void *(*PyBool_FromLong)(long);
    void *(*PyEval_SaveThread)(void); /* lets other threads run, until PyEval_RestoreThread */
    void (*PyEval_RestoreThread)(void *);
    void *(*PyBytes_FromStringAndSize)(const char *, ptrdiff_t);
    int (*PyBytes_AsStringAndSize)(void *, char **, ptrdiff_t *);
    void (*Py_DecRef)(void *);
    void (*Py_IncRef)(void *);
    void *(*PyType_GenericAlloc)(void *, ptrdiff_t);
    int (*PyErr_BadArgument)(void); /* raises TypeError */
    void *_Py_NoneStruct;           /* None itself */
} wheel_python;

void wheel_python_begin(const wheel_python *python);

/* Functions for Python. They get borrowed references (void * is PyObject *), and return a new one, or NULL
 * with the exception that CPython has set. `self` is an int, the address of what stands before the dot below;
 * other addresses are ints too. */

/* client.command(speeds, torques, now_ns): wheel_client_command with two tuples of four. */
void *wheel_python_command(void *self, void *const *arguments, ptrdiff_t count);

/* client.poll(now_ns): wheel_client_poll. */
void *wheel_python_poll(void *self, void *const *arguments, ptrdiff_t count);

/* client.link_figures(): messages sent and received, snapshots lost or incomplete, the newest round trip [ms]
 * or NaN. */
void *wheel_python_link_figures(void *self, void *const *arguments, ptrdiff_t count);

/* client.out(): the packed frames that wait to be sent, as bytes. */
void *wheel_python_out(void *self, void *const *arguments, ptrdiff_t count);

/* client.sent(): wheel_client_sent; returns the number of frames. */
void *wheel_python_sent(void *self, void *const *arguments, ptrdiff_t count);

/* client.ask(ticks): wheel_client_step; returns False. */
void *wheel_python_ask(void *self, void *const *arguments, ptrdiff_t count);

/* client.take(packed, begin, now_ns): wheel_client_take, to the end of the bytes. */
void *wheel_python_take(void *self, void *const *arguments, ptrdiff_t count);

/* line.receive(client, bytes, now_ns): the client takes the frames of received bytes, and adds what is due
 * (wheel_client_poll). Returns the number of frames; or, if the client needs attention, the packed frames and
 * how far it took them. */
void *wheel_python_receive(void *self, void *const *arguments, ptrdiff_t count);

/* line.encode(client): what waits in the client as bytes of the line. */
void *wheel_python_encode(void *self, void *const *arguments, ptrdiff_t count);

/* direct.step(robot, client, ticks, now_ns): wheel_direct_step. */
void *wheel_python_step(void *self, void *const *arguments, ptrdiff_t count);

/* direct.line_bytes(): bytes on the line, sent and received, since the count began; those that wait count as
 * sent. */
void *wheel_python_line_bytes(void *self, void *const *arguments, ptrdiff_t count);

/* direct.hold(robot, packed): wheel_direct_hold; returns how many frames are held. */
void *wheel_python_hold(void *self, void *const *arguments, ptrdiff_t count);

/* direct.exchange(robot, client, ticks): wheel_client_step and wheel_direct_exchange; returns the answer as
 * bytes, None if the STEP cannot be sent. The client may be 0. */
void *wheel_python_exchange(void *self, void *const *arguments, ptrdiff_t count);

/* direct.crossed(): what the newest exchange sent of the client's, and the answer, each as bytes with its
 * number of frames. */
void *wheel_python_crossed(void *self, void *const *arguments, ptrdiff_t count);

/* freshness.add_feedback(feedback, truth, age_ns, now_ns, is_driven): wheel_freshness_add with the tuples of
 * hil: feedback (robot_time_ns, state, ...), and a truth (time_ns, pose, ...) or None, which does not count
 * if its pose is not finite. Returns the result, `silent_ns`, `truth_ns` or None, and `is_stale`. */
void *wheel_python_add_feedback(void *self, void *const *arguments, ptrdiff_t count);

/* latency.measure_latency(feedback, sequence, sampled_ns): wheel_latency_acted by feedback (robot_time_ns,
 * state, command_sequence, command_age_ms, ...), then wheel_latency_sent; returns `median_s`. */
void *wheel_python_measure_latency(void *self, void *const *arguments, ptrdiff_t count);

/* motion.add_motion(speeds, time_ns, state, latency_s, older_s): sets `older_s`, then wheel_motion_add with a
 * tuple of four and a motion, a tuple that begins with pose and twist, tuples of three. */
void *wheel_python_add_motion(void *self, void *const *arguments, ptrdiff_t count);

/* load.count_load(now_ns, total): wheel_load_count. */
void *wheel_python_count_load(void *self, void *const *arguments, ptrdiff_t count);

/* loads.count_loads(now_ns, totals): wheel_load_count of two in a row with a tuple of two; returns the
 * greater load. */
void *wheel_python_count_loads(void *self, void *const *arguments, ptrdiff_t count);

/* freshness.has_aged(now_ns): whether a truth has become too old since `add_feedback`. */
void *wheel_python_has_aged(void *self, void *const *arguments, ptrdiff_t count);

/* finite(motion): whether pose and twist, the two tuples of three that a motion begins with, are finite. */
void *wheel_python_finite(void *self, void *const *arguments, ptrdiff_t count);

/* split(packed, limit): wheel_packed_split; returns both groups as bytes. */
void *wheel_python_split(void *self, void *const *arguments, ptrdiff_t count);

/* within(four, limit): whether each of four numbers is from -limit to limit; NaN is not. */
void *wheel_python_within(void *self, void *const *arguments, ptrdiff_t count);

/* pack(frames): a tuple of frames, packed, as bytes. */
void *wheel_python_pack(void *self, void *const *arguments, ptrdiff_t count);

/* line.noise(): how many pieces of what was received were no frame. */
void *wheel_python_noise(void *self, void *const *arguments, ptrdiff_t count);

/* frames(packed, Frame): the packed frames as a tuple of named tuples of a class: id, payload. */
void *wheel_python_frames(void *self, void *const *arguments, ptrdiff_t count);

/* A value, and where it comes from. A tuple's values follow it. */
typedef struct {
    int32_t kind;
    int32_t length;
    int64_t factor; /* by which a WHEEL_PYTHON_UINT64 is multiplied; of the outermost tuple the arguments */
    const void *at; /* where the number is in memory */
    void *object;   /* the class of a named tuple, NULL for a plain one; the objects of a choice; the object;
                       the wheel_python_kept */
} wheel_python_value;
enum {
    WHEEL_PYTHON_TUPLE,
    WHEEL_PYTHON_ARGUMENT, /* the next one */
    WHEEL_PYTHON_OBJECT,
    WHEEL_PYTHON_CHOICE, /* of a tuple's objects, by a uint8_t */
    WHEEL_PYTHON_FLOAT,
    WHEEL_PYTHON_DOUBLE,
    WHEEL_PYTHON_UINT8,
    WHEEL_PYTHON_UINT16,
    WHEEL_PYTHON_UINT64,
    WHEEL_PYTHON_KEPT, /* the tuple that follows, made anew only when the `length` bytes at `at` have changed;
                          `factor` values describe it */
};

/* A tuple that is used again. */
typedef struct {
    void *holder; /* a list, whose first item it is */
    void *made;   /* NULL before the first */
    uint8_t numbers[16];
} wheel_python_kept;

/* tuple.make(arguments...): the tuple, of arguments and of what is in memory now; None while the bool that
 * its `at` points to is false. */
void *wheel_python_make(void *self, void *const *arguments, ptrdiff_t count);

/* One member of a tuple, in the order of the members. */
typedef struct {
    int16_t place;  /* of its number in the row; or one of these */
    int16_t length; /* of a tuple */
    double unit;    /* by which the number is multiplied */
} wheel_python_member;
#define WHEEL_PYTHON_LEFT_OUT -1
#define WHEEL_PYTHON_NESTED -2 /* a tuple; its members follow */

typedef struct {
    double *numbers;
    uint32_t count;
    /* Places of x, y and heading of two poses, and of the first one minus the second: x, y, heading from -pi
     * to pi, and the distance. */
    uint32_t pose;
    uint32_t other_pose;
    uint32_t difference;
    const wheel_python_member *members; /* of the tuple of the objects */
} wheel_python_layout;

/* difference(state, reference): of two motions, each a tuple that begins with pose and twist, tuples of
 * three: the first minus the second, a tuple of pose (heading from -pi to pi) and twist in six numbers; the
 * first's heading; the second's twist, and the first's. */
void *wheel_python_difference(void *self, void *const *arguments, ptrdiff_t count);

/* wheel_torques(inertia, geometry, acceleration, twist, heading): the torques of four wheels, FL, FR, RR, RL,
 * for a world acceleration without friction, as a tuple: B+ (M a + C). Inertia is a tuple of effective mass
 * [kg], the wheels' part of it [kg] and effective yaw inertia [kg m2], geometry one of wheel radius and lever
 * [m]; hil/core/model.py explains them. Acceleration and twist are sequences of three. */
void *wheel_python_wheel_torques(void *self, void *const *arguments, ptrdiff_t count);

/* layout.row(objects...): puts the numbers of nested tuples in their places, and returns a copy of all
 * numbers as bytes. Those that have no member keep their value. */
void *wheel_python_row(void *self, void *const *arguments, ptrdiff_t count);
/* A table of 4 by 4 cells, in which two numbers are looked up: two results, interpolated. */
typedef struct {
    double
        cells_a_unit[2]; /* of each input; zero is the middle of the table, and beyond its ends they hold */
    double cells[16][2][4]; /* row by row (second input); a result is a + b p + q (c + d p), p and q 0 to 4 */
} wheel_python_table;

typedef struct {
    const wheel_python_table *tables;
    ptrdiff_t count;
    double *nearest; /* four numbers a table: both places in it, from -2 to 2, the nearest corner, 5 * row +
                        column, and how near it is: the product of both shares, 0.25 to 1 */
} wheel_python_tables;

/* tables.look_up(inputs): a tuple of the first input of each table, then of the second; returns a tuple of
 * the first results, then of the second, and sets `nearest`. NaN is the beginning of a table. */
void *wheel_python_look_up(void *self, void *const *arguments, ptrdiff_t count);

/* terminal_read(descriptor), POSIX: what waits at a terminal, as bytes; empty if nothing does, None where it
 * cannot be read. A number below 0 or above INT_MAX raises TypeError. A read that finds nothing may wait for
 * a thread of the kernel, so this asks first whether there is something. */
void *wheel_python_terminal_read(void *self, void *const *arguments, ptrdiff_t count);
enum { WHEEL_PYTHON_TERMINAL = 4096 }; /* bytes at once: as many as Linux keeps for a reader of a terminal */

/* terminal_write(descriptor, bytes), POSIX: how many of them a terminal that does not block has taken; 0 also
 * where it cannot be written to. It raises as terminal_read. */
void *wheel_python_terminal_write(void *self, void *const *arguments, ptrdiff_t count);
/* cffi: end */

#endif
