/* The extension module firmware_protocol._wheel: the calls of a tick. cffi has the rest, of the same file. */
#include "../../client/packed.h"
#include "../../client/wheel_line.h"
#include "../host/host.h"
#include "internal.h"

#include <math.h>
#include <string.h>

PyTypeObject *wheel_types[TYPES];

bool wheel_refuse_count(const char *name, int expected, Py_ssize_t count) {
    PyErr_Format(PyExc_TypeError, "%s() takes %d arguments, but %zd were given", name, expected, count);
    return false;
}

PyObject *wheel_no_item(PyObject *tuple, Py_ssize_t place) {
    PyErr_Clear(); /* IndexError, or SystemError of what is no tuple */
    return PyErr_Format(PyExc_TypeError, "expected a tuple of %zd items or more, not %R", place + 1, tuple);
}

void *wheel_owned(PyObject *object, int type) {
    if (!PyType_IsSubtype(object->ob_type, wheel_types[type])) {
        return PyErr_Format(PyExc_TypeError, "expected a %R, not %R", wheel_types[type], object->ob_type);
    }
    if (HELD_BY(object)[0] == NULL) {
        return PyErr_Format(PyExc_RuntimeError, "%R was not initialised", object);
    }
    return owned_by(object);
}

bool wheel_is_kind(PyObject *object) {
    if (PyType_IsSubtype(object->ob_type, &PyType_Type) &&
        PyType_IsSubtype((PyTypeObject *)object, &PyTuple_Type)) {
        return true;
    }
    PyErr_Format(PyExc_TypeError, "expected a class of tuples, not %R", object);
    return false;
}

void wheel_dealloc(PyObject *self) {
    PyTypeObject *type = self->ob_type;
    for (size_t i = 0; i < HELD; i++) {
        hold(&HELD_BY(self)[i], NULL);
    }
    ((freefunc)(uintptr_t)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DecRef((PyObject *)type);
}

PyObject *wheel_address_of(PyObject *self, void *unused) {
    (void)unused;
    return PyLong_FromVoidPtr(owned_by(self));
}
PyGetSetDef wheel_address[] = {{"address", wheel_address_of, NULL, "address of the C struct, for cffi", NULL},
                               {NULL, NULL, NULL, NULL, NULL}};

int wheel_init_of_none(PyObject *self, PyObject *arguments, PyObject *named) {
    (void)self, (void)named;
    return PyArg_ParseTuple(arguments, "") ? 0 : -1;
}

static PyObject *new_tuple(PyObject *kind, Py_ssize_t count) {
    return kind == NULL ? PyTuple_New(count) : PyType_GenericAlloc((PyTypeObject *)kind, count);
}

PyObject *wheel_joined(PyObject *kind, PyObject *const *values, Py_ssize_t count) {
    PyObject *tuple = new_tuple(kind, count);
    for (Py_ssize_t i = 0; i < count; i++) {
        if (values[i] == NULL) {
            hold(&tuple, NULL);
        } else if (tuple != NULL) {
            PyTuple_SetItem(tuple, i, values[i]);
        } else {
            Py_DecRef(values[i]);
        }
    }
    return tuple;
}

PyObject *wheel_tuple_of(PyObject *kind, PyObject *const *values, Py_ssize_t count) {
    PyObject *tuple = new_tuple(kind, count);
    for (Py_ssize_t i = 0; tuple != NULL && i < count; i++) {
        PyTuple_SetItem(tuple, i, again(values[i]));
    }
    return tuple;
}

PyObject *wheel_floats(PyObject *kind, const double *values, Py_ssize_t count) {
    PyObject *tuple = new_tuple(kind, count);
    for (Py_ssize_t i = 0; tuple != NULL && i < count; i++) {
        PyTuple_SetItem(tuple, i, PyFloat_FromDouble(values[i]));
    }
    return tuple;
}

CALL(is_within) {
    double four[4];
    double limit;
    (void)self;
    if (!TAKES("is_within", 2) || !numbers(given[0], 4, four) || !number(given[1], &limit)) {
        return NULL;
    }
    bool is_all = true;
    for (size_t i = 0; i < 4u; i++) {
        is_all = is_all && four[i] >= -limit && four[i] <= limit;
    }
    return PyBool_FromLong(is_all);
}

/* Reads pose and twist, borrowed, of a tuple that begins with them, and their numbers; false with an
 * exception. */
static bool motion_of(PyObject *tuple, PyObject *parts[2], double six[6]) {
    return (parts[0] = item(tuple, 0)) != NULL && (parts[1] = item(tuple, 1)) != NULL &&
           numbers(parts[0], 3, six) && numbers(parts[1], 3, six + 3);
}

CALL_OF_ONE(is_finite) {
    PyObject *parts[2];
    double six[6];
    (void)self;
    if (!motion_of(given, parts, six)) {
        return NULL;
    }
    bool is_all = true;
    for (size_t i = 0; i < 6u; i++) {
        is_all = is_all && isfinite(six[i]);
    }
    return PyBool_FromLong(is_all);
}

CALL(difference) {
    PyObject *parts[2][2];
    double six[2][6];
    (void)self;
    if (!TAKES("difference", 2) || !motion_of(given[0], parts[0], six[0]) ||
        !motion_of(given[1], parts[1], six[1])) {
        return NULL;
    }
    double error[6];
    for (size_t i = 0; i < 6u; i++) {
        error[i] = six[0][i] - six[1][i];
    }
    error[2] = remainder(error[2], TURN_RAD);
    return JOINED(NULL, wheel_floats(NULL, error, 6), PyFloat_FromDouble(six[0][2]), again(parts[1][1]),
                  again(parts[0][1]));
}

/* Reads three numbers of a sequence of any kind, because a law may be a user's; false with an exception. */
static bool axes(PyObject *sequence, double values[3]) {
    if (PyTuple_Size(sequence) >= 3) {
        return numbers(sequence, 3, values);
    }
    PyErr_Clear();
    for (Py_ssize_t i = 0; i < 3; i++) {
        PyObject *found = PySequence_GetItem(sequence, i);
        const bool is_number = found != NULL && number(found, &values[i]);
        hold(&found, NULL);
        if (!is_number) {
            return false;
        }
    }
    return true;
}

CALL(wheel_torques) {
    double inertia[3];
    double geometry[2];
    double acceleration[3];
    double twist[3];
    double heading_rad;
    (void)self;
    if (!TAKES("wheel_torques", 5) || !numbers(given[0], 3, inertia) || !numbers(given[1], 2, geometry) ||
        !axes(given[2], acceleration) || !axes(given[3], twist) || !number(given[4], &heading_rad)) {
        return NULL;
    }
    const double coupling = inertia[1] * twist[2];
    const double force_x = inertia[0] * acceleration[0] + coupling * twist[1];
    const double force_y = inertia[0] * acceleration[1] - coupling * twist[0];
    /* B+ gives the torques of least norm: rotate into the body frame, then apply (r / 4) H diag(1, 1, 1/L2).
     */
    const double c = cos(heading_rad);
    const double s = sin(heading_rad);
    const double quarter_m = geometry[0] / 4.0;
    const double forward = quarter_m * (c * force_x + s * force_y);
    const double left = quarter_m * (c * force_y - s * force_x);
    const double turn = quarter_m * (inertia[2] * acceleration[2]) / geometry[1];
    return FLOATS(forward - left - turn, forward + left + turn, forward - left + turn, forward + left - turn);
}

CALL(frames) {
    uint8_t *packed;
    size_t end;
    wheel_packed frame;
    Py_ssize_t all = 0;
    (void)self;
    if (!TAKES("frames", 2) || !bytes_of(given[0], &packed, &end) || !wheel_is_kind(given[1])) {
        return NULL;
    }
    for (size_t at = 0; wheel_packed_take(packed, at, end, &frame); at = frame.next) {
        all++;
    }
    PyObject *tuple = PyTuple_New(all);
    frame.next = 0;
    for (Py_ssize_t i = 0; tuple != NULL && i < all; i++) {
        (void)wheel_packed_take(packed, frame.next, end, &frame);
        PyObject *made =
            JOINED(given[1], PyLong_FromLongLong(frame.id), new_bytes(frame.payload, frame.length));
        if (made == NULL || PyTuple_SetItem(tuple, i, made) != 0) {
            hold(&tuple, NULL);
        }
    }
    return tuple;
}

CALL(split) {
    int64_t limit;
    uint8_t *packed;
    uint8_t *sorted;
    size_t length;
    size_t used;
    (void)self;
    if (!TAKES("split", 2) || !bytes_of(given[0], &packed, &length) || !integer(given[1], &limit)) {
        return NULL;
    }
    PyObject *room = new_bytes(NULL, length);
    if (room == NULL || !bytes_of(room, &sorted, &used)) {
        return NULL;
    }
    const size_t below = wheel_packed_split(packed, length, (uint16_t)limit, sorted, &used);
    PyObject *groups = JOINED(NULL, new_bytes(sorted, below), new_bytes(sorted + below, used - below));
    Py_DecRef(room);
    return groups;
}

static PyMethodDef functions[] = {
    METHOD("is_within", is_within, METH_FASTCALL,
           "Return whether each of four numbers is from -limit to limit. NaN is not."),
    METHOD("is_finite", is_finite, METH_O,
           "Return whether pose and twist, with which a motion begins, are finite."),
    METHOD("difference", difference, METH_FASTCALL,
           "Return one motion minus another in six numbers, the heading from -pi to pi; the first's heading; "
           "the second's twist, and the first's."),
    METHOD(
        "wheel_torques", wheel_torques, METH_FASTCALL,
        "Return the torques of four wheels for a world acceleration at a twist and heading, without "
        "friction: B+ (M a + C). The first two are effective mass, the wheels' part of it [kg] and effective "
        "yaw inertia [kg m2]; wheel radius and lever [m] (hil/core/model.py)."),
    METHOD("frames", frames, METH_FASTCALL, "Return packed frames as a tuple of (id, payload) of a class."),
    METHOD("split", split, METH_FASTCALL,
           "Return the packed frames with an id below a limit, and the others."),
#ifndef _WIN32
    METHOD("terminal_read", wheel_terminal_read, METH_O,
           "Return what waits at a terminal; None where none can be read."),
    METHOD("terminal_write", wheel_terminal_write, METH_FASTCALL,
           "Return how many bytes a terminal that does not block has taken; 0 also where it cannot be "
           "written to."),
#endif
    END};
static PyModuleDef definition = {
    .m_base = {{1, NULL}, NULL, 0, NULL},
    .m_name = "_wheel",
    .m_doc = "The calls of a tick, in C. An object may be used by one thread at a time.",
    .m_size = -1,
    .m_methods = functions,
};

/* Without __declspec(dllexport): a linker of Windows exports all that cffi calls only if nothing has it. */
PyObject *PyInit__wheel(void);
PyObject *PyInit__wheel(void) {
    wheel_specs_of_session[NODE].basicsize = (int)(sizeof(owner) + wheel_host_size());
    PyObject *module = PyModule_Create2(&definition, PYTHON_ABI_VERSION);
    for (size_t i = 0; module != NULL && i < TYPES; i++) {
        PyType_Spec *spec = i < 4u   ? &wheel_specs_of_session[i]
                            : i < 8u ? &wheel_specs_of_timing[i - 4u]
                                     : &wheel_specs_of_values[i - 8u];
        PyObject *type = PyType_FromSpec(spec);
        if (type == NULL || PyModule_AddObjectRef(module, strrchr(spec->name, '.') + 1, type) != 0) {
            return NULL;
        }
        wheel_types[i] = (PyTypeObject *)type;
    }
    return module;
}
