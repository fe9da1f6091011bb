/* What the files of the extension module share. */
#ifndef WHEEL_PYTHON_INTERNAL_H
#define WHEEL_PYTHON_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>

#include "stable_abi.h"

/* An object that owns a C struct behind its references. */
enum { HELD = 3 };
typedef struct {
    PyObject head;
    PyObject *held[HELD];
} owner;
#define OWNER(type)                                                                                          \
    struct {                                                                                                 \
        owner base;                                                                                          \
        type owned;                                                                                          \
    }
static inline void *owned_by(PyObject *object) {
    return (owner *)object + 1;
}
#define OWNED(type, object) ((type *)owned_by(object))
#define HELD_BY(object) (((owner *)(object))->held)

/* Functions for Python: a new reference, or NULL with an exception. `given` are `count` arguments. */
#define CALL(name) static PyObject *name(PyObject *self, PyObject *const *given, Py_ssize_t count)
#define CALL_OF_NONE(name) static PyObject *name(PyObject *self, PyObject *unused)
#define CALL_OF_ONE(name) static PyObject *name(PyObject *self, PyObject *given)
#define INIT(name) static int name(PyObject *self, PyObject *arguments, PyObject *unused)
#define TURN_RAD 6.283185307179586
#define METHOD(name, function, flags, doc) {name, (PyCFunction)(void (*)(void))(function), flags, doc}
#define END {NULL, NULL, 0, NULL}
/* Checks the number of arguments; false with TypeError. */
#define TAKES(name, expected) (count == (expected) || wheel_refuse_count(name, expected, count))
bool wheel_refuse_count(const char *name, int expected, Py_ssize_t count);

/* The slots that every type has, and its spec. */
#define SLOTS(doc, init, methods)                                                                            \
    {Py_tp_doc, doc}, {Py_tp_new, (void *)PyType_GenericNew}, {Py_tp_init, (void *)(init)},                  \
        {Py_tp_methods, methods}, {Py_tp_getset, wheel_address}, {                                           \
        Py_tp_dealloc, (void *)wheel_dealloc                                                                 \
    }
#define SPEC(name, object, slots)                                                                            \
    {"firmware_protocol._wheel." name, sizeof(object), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE, slots}
extern PyGetSetDef wheel_address[];
PyObject *wheel_address_of(PyObject *self, void *unused);
int wheel_init_of_none(PyObject *self, PyObject *arguments, PyObject *unused);
void wheel_dealloc(PyObject *self);

extern PyType_Spec wheel_specs_of_session[4]; /* Client, Line, Node, Direct */
extern PyType_Spec wheel_specs_of_timing[4];  /* Freshness, Latency, Motion, Load */
extern PyType_Spec wheel_specs_of_values[3];  /* Tuples, Row, Tables */
enum { CLIENT, LINE, NODE, LOAD = 7, TYPES = 11 };
extern PyTypeObject *wheel_types[TYPES]; /* in this order */

PyObject *wheel_terminal_read(PyObject *self, PyObject *descriptor);
PyObject *wheel_terminal_write(PyObject *self, PyObject *const *given, Py_ssize_t count);

/* Returns the struct in an object of a type or a subclass; NULL with TypeError for another one, and with
 * RuntimeError for one that was not initialised. */
void *wheel_owned(PyObject *object, int type);

/* Whether an object is a class of tuples; if not, TypeError. */
bool wheel_is_kind(PyObject *object);

static inline PyObject *again(PyObject *object) {
    Py_IncRef(object);
    return object;
}

static inline PyObject *none(void) {
    return again(&_Py_NoneStruct);
}

/* Holds another object, or none, in place of one that was held. */
static inline void hold(PyObject **held, PyObject *object) {
    PyObject *before = *held;
    *held = object;
    if (before != NULL) {
        Py_DecRef(before);
    }
}

/* Reads an int; false with an exception. PyLong_AsLongLong takes four times as long for a time [ns]. */
static inline bool integer(PyObject *object, int64_t *value) {
    int overflow;
    const long long found = PyLong_AsLongLongAndOverflow(object, &overflow);
    *value = overflow == 0 ? found : PyLong_AsLongLong(object); /* raises OverflowError */
    return *value != -1 || PyErr_Occurred() == NULL;
}

/* Reads a number; false with an exception. */
static inline bool number(PyObject *object, double *value) {
    *value = PyFloat_AsDouble(object);
    return *value != -1.0 || PyErr_Occurred() == NULL;
}

/* Returns an item of a tuple, borrowed; NULL with TypeError. */
PyObject *wheel_no_item(PyObject *tuple, Py_ssize_t place);
static inline PyObject *item(PyObject *tuple, Py_ssize_t place) {
    PyObject *found = PyTuple_GetItem(tuple, place);
    return found != NULL ? found : wheel_no_item(tuple, place);
}

static inline bool integer_at(PyObject *tuple, Py_ssize_t place, int64_t *value) {
    PyObject *found = item(tuple, place);
    return found != NULL && integer(found, value);
}

/* Reads the first numbers of a tuple; false with an exception. */
static inline bool numbers(PyObject *tuple, Py_ssize_t count, double *values) {
    for (Py_ssize_t i = 0; i < count; i++) {
        PyObject *found = item(tuple, i);
        if (found == NULL || !number(found, &values[i])) {
            return false;
        }
    }
    return true;
}

/* Reads bytes; false with an exception. */
static inline bool bytes_of(PyObject *object, uint8_t **bytes, size_t *length) {
    return PyBytes_AsStringAndSize(object, (char **)bytes, (Py_ssize_t *)length) == 0;
}

static inline PyObject *new_bytes(const uint8_t *bytes, size_t length) {
    return PyBytes_FromStringAndSize((const char *)bytes, (Py_ssize_t)length);
}

/* Returns a tuple, of a class of named tuples unless that is NULL. It takes over the references; if one is
 * NULL, it returns NULL. */
PyObject *wheel_joined(PyObject *kind, PyObject *const *values, Py_ssize_t count);
#define JOINED(kind, ...)                                                                                    \
    wheel_joined(kind, (PyObject *[]){__VA_ARGS__}, sizeof((PyObject *[]){__VA_ARGS__}) / sizeof(PyObject *))
#define MOST_FLOATS 16
PyObject *wheel_tuple_of(PyObject *kind, PyObject *const *values, Py_ssize_t count); /* borrowed */
PyObject *wheel_floats(PyObject *kind, const double *values, Py_ssize_t count);
#define FLOATS(...)                                                                                          \
    wheel_floats(NULL, (double[]){__VA_ARGS__}, sizeof((double[]){__VA_ARGS__}) / sizeof(double))

#endif
