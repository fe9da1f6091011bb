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
    void *(*PyLong_AsVoidPtr)(void *);
    void *(*PyErr_Occurred)(void);
    void *(*PyTuple_GetItem)(void *, ptrdiff_t); /* borrowed */
    void *(*PyTuple_New)(ptrdiff_t);
    int (*PyTuple_SetItem)(void *, ptrdiff_t, void *); /* steals the reference */
    void *(*PyFloat_FromDouble)(double);
    void *(*PyLong_FromLongLong)(long long);
    void *(*PyBool_FromLong)(long);
    void *(*PyEval_SaveThread)(void); /* lets other threads run, until PyEval_RestoreThread */
    void (*PyEval_RestoreThread)(void *);
    void *(*PyBytes_FromStringAndSize)(const char *, ptrdiff_t);
    int (*PyBytes_AsStringAndSize)(void *, char **, ptrdiff_t *);
    void (*Py_DecRef)(void *);
} wheel_python;

void wheel_python_begin(const wheel_python *python);

/* Functions for Python. They get borrowed references (void * is PyObject *), and return a new one, or NULL
 * with the exception that CPython has set. Addresses are ints. */

/* command(client, speeds, torques, now_ns): wheel_client_command with two tuples of four. */
void *wheel_python_command(void *self, void *const *arguments, ptrdiff_t count);

/* poll(client, now_ns): wheel_client_poll. */
void *wheel_python_poll(void *self, void *const *arguments, ptrdiff_t count);

/* step(direct, robot, client, ticks, now_ns): wheel_direct_step. */
void *wheel_python_step(void *self, void *const *arguments, ptrdiff_t count);

/* snapshot(client): snapshots, round_trips, slow, round_trip_ns, robot time [ns], state, command_sequence,
 * command_age_ms, encoder counts and speeds of the client's view. */
void *wheel_python_snapshot(void *self, void *const *arguments, ptrdiff_t count);

/* counts(client): messages sent and received, snapshots lost or incomplete. */
void *wheel_python_counts(void *self, void *const *arguments, ptrdiff_t count);

/* out(client): the packed frames that wait to be sent, as bytes. */
void *wheel_python_out(void *self, void *const *arguments, ptrdiff_t count);

/* sent(client): wheel_client_sent; returns False. */
void *wheel_python_sent(void *self, void *const *arguments, ptrdiff_t count);

/* ask(client, ticks): wheel_client_step; returns False. */
void *wheel_python_ask(void *self, void *const *arguments, ptrdiff_t count);

/* take(client, packed, begin, now_ns): wheel_client_take, to the end of the bytes. */
void *wheel_python_take(void *self, void *const *arguments, ptrdiff_t count);

/* exchange(direct, robot, client, packed): sends the packed frames, then what waits in the client, and
 * returns the answer as bytes. */
void *wheel_python_exchange(void *self, void *const *arguments, ptrdiff_t count);

/* split(packed, limit): wheel_packed_split; returns both groups as bytes. */
void *wheel_python_split(void *self, void *const *arguments, ptrdiff_t count);
/* cffi: end */

#endif
