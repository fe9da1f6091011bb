/* Named tuples, rows of numbers, and tables: Tuples, Row and Tables. */
#include "internal.h"

#include <math.h>
#include <string.h>

/* Tuples: what it makes them of, all held by the tuple of the arguments. */

enum {
    POSE,
    TWIST,
    ACCELERATION,
    REFERENCE,
    FIX,
    STATE,
    WHEELS,
    COMMAND,
    SIGNALS,
    SPEED,
    TORQUE,
    AT_REST,
    PARTS
};
typedef struct {
    PyObject *of[PARTS];
} parts;

INIT(tuples_init) {
    parts found;
    (void)unused;
    for (Py_ssize_t i = 0; i < PARTS; i++) {
        found.of[i] = item(arguments, i);
        if (found.of[i] == NULL || (i < SPEED && !wheel_is_kind(found.of[i]))) {
            return -1;
        }
    }
    *OWNED(parts, self) = found;
    hold(&HELD_BY(self)[0], again(arguments));
    return 0;
}

/* Returns a tuple of borrowed values. */
static PyObject *made(PyObject *self, int kind, PyObject *const *values, Py_ssize_t count) {
    return wheel_tuple_of(OWNED(parts, self)->of[kind], values, count);
}

/* Of one part and as many values. */
#define PLAIN(name, kind, number)                                                                            \
    CALL(tuples_##name) {                                                                                    \
        return TAKES(#name, number) ? made(self, kind, given, number) : NULL;                                \
    }
PLAIN(wheels, WHEELS, 4)
PLAIN(state, STATE, 2)
PLAIN(command, COMMAND, 3)
PLAIN(loop_signals, SIGNALS, 5)

CALL(tuples_reference) {
    return TAKES("reference", 9)
               ? JOINED(OWNED(parts, self)->of[REFERENCE], made(self, POSE, given, 3),
                        made(self, TWIST, given + 3, 3), made(self, ACCELERATION, given + 6, 3))
               : NULL;
}

CALL_OF_ONE(tuples_pose_fix) {
    Py_buffer memory;
    struct {
        int64_t time_ns;
        double six[6];
    } read;
    if (PyObject_GetBuffer(given, &memory, PyBUF_SIMPLE) != 0) {
        return NULL;
    }
    const bool is_whole = memory.len == sizeof read;
    memcpy(&read, memory.buf, is_whole ? sizeof read : 0u);
    PyBuffer_Release(&memory);
    PyObject *const *of = OWNED(parts, self)->of;
    return is_whole ? JOINED(of[FIX], PyLong_FromLongLong(read.time_ns), wheel_floats(of[POSE], read.six, 3),
                             wheel_floats(of[TWIST], read.six + 3, 3))
                    : PyErr_Format(PyExc_ValueError, "pose_fix() of %R, which has not 56 bytes", given);
}

CALL(tuples_speed_command) {
    PyObject *const *of = OWNED(parts, self)->of;
    return TAKES("speed_command", 8) ? JOINED(of[COMMAND], again(of[SPEED]), made(self, WHEELS, given, 4),
                                              made(self, WHEELS, given + 4, 4))
                                     : NULL;
}

CALL(tuples_torque_command) {
    PyObject *const *of = OWNED(parts, self)->of;
    return TAKES("torque_command", 4)
               ? JOINED(of[COMMAND], again(of[TORQUE]), again(of[AT_REST]), made(self, WHEELS, given, 4))
               : NULL;
}

static PyMethodDef tuples_methods[] = {
    METHOD("wheels", tuples_wheels, METH_FASTCALL, "Of the four wheels."),
    METHOD("state", tuples_state, METH_FASTCALL, "Of pose and twist."),
    METHOD("command", tuples_command, METH_FASTCALL, "Of mode, speeds and torques."),
    METHOD("loop_signals", tuples_loop_signals, METH_FASTCALL, "Of its five fields."),
    METHOD("reference", tuples_reference, METH_FASTCALL,
           "Of x, y, heading, their rates, their accelerations."),
    METHOD("pose_fix", tuples_pose_fix, METH_O, "Of memory: an int64 of the time [ns], and six doubles."),
    METHOD("speed_command", tuples_speed_command, METH_FASTCALL, "Of four speeds and four torques."),
    METHOD("torque_command", tuples_torque_command, METH_FASTCALL, "Of four torques."),
    END};
static PyType_Slot tuples_slots[] = {
    SLOTS("Tuples(Pose, Twist, Acceleration, Reference, PoseFix, State, Wheels, WheelCommand, LoopSignals, "
          "speed, torque, "
          "at_rest): makes tuples of these classes; of the modes and the wheels at rest too.",
          tuples_init, tuples_methods),
    {0, NULL}};

/* Row */

/* One member of the objects, in their order: the place of its number in the row, or one of these. */
typedef struct {
    Py_ssize_t place;
    Py_ssize_t length; /* of a tuple, whose members follow */
} member;
enum { LEFT_OUT = -1, NESTED = -2, MOST_MEMBERS = 512, MOST_ARGUMENTS = 32 };

/* `held` are the names of the arguments, the numbers, and the names of the newest call. */
typedef struct {
    double *row; /* its numbers, then the units by which they are multiplied */
    Py_ssize_t columns;
    Py_ssize_t first[3];                  /* of two poses, and of their difference, which has four numbers */
    member members[MOST_MEMBERS];         /* of all arguments, one after the other */
    Py_ssize_t begins[MOST_ARGUMENTS];    /* where those of each argument begin */
    const member *called[MOST_ARGUMENTS]; /* the same in the order of the newest call */
    Py_ssize_t count;
} row_layout;
enum { NAMES, NUMBERS, CALLED };

/* Adds the members that nested tuples of places describe; false with an exception. */
static bool add_members(row_layout *row, PyObject *places) {
    const Py_ssize_t length = PyTuple_Size(places);
    int64_t place = NESTED;
    PyErr_Clear();
    if (length < 0 && (!integer(places, &place) || place < LEFT_OUT || place >= row->columns)) {
        PyErr_Format(PyExc_ValueError, "a row of %zd columns has no place %R", row->columns, places);
        return false;
    }
    if (row->count == MOST_MEMBERS) {
        PyErr_Format(PyExc_ValueError, "a row of more than %d members", MOST_MEMBERS);
        return false;
    }
    row->members[row->count++] = (member){(Py_ssize_t)place, length};
    for (Py_ssize_t i = 0; i < length; i++) {
        if (!add_members(row, PyTuple_GetItem(places, i))) {
            return false;
        }
    }
    return true;
}

INIT(row_init) {
    row_layout *row = OWNED(row_layout, self);
    PyObject *names;
    PyObject *places;
    PyObject *units;
    uint8_t *bytes;
    size_t length;
    (void)unused;
    for (size_t i = 0; i < HELD; i++) {
        hold(&HELD_BY(self)[i], NULL);
    }
    if (!PyArg_ParseTuple(arguments, "OOO(nnn):Row", &names, &places, &units, &row->first[0], &row->first[1],
                          &row->first[2]) ||
        !bytes_of(units, &bytes, &length)) {
        return -1;
    }
    row->columns = (Py_ssize_t)(length / sizeof(double));
    row->count = 0;
    for (Py_ssize_t i = 0; i < 3; i++) {
        if (row->first[i] < 0 || row->first[i] > row->columns - (i < 2 ? 3 : 4)) {
            PyErr_Format(PyExc_ValueError, "a row of %zd columns has no pose at %zd", row->columns,
                         row->first[i]);
            return -1;
        }
    }
    for (Py_ssize_t i = 0; i < PyTuple_Size(names); i++) {
        PyObject *of_one = i < MOST_ARGUMENTS ? item(places, i) : wheel_no_item(names, MOST_ARGUMENTS);
        row->begins[i % MOST_ARGUMENTS] = row->count;
        if (of_one == NULL || !add_members(row, of_one)) {
            return -1;
        }
    }
    PyObject *memory = PyErr_Occurred() != NULL ? NULL : new_bytes(NULL, 2u * length);
    if (memory == NULL) {
        return -1;
    }
    uint8_t *start;
    (void)bytes_of(memory, &start, &length);
    row->row = (double *)(void *)start;
    for (Py_ssize_t i = 0; i < row->columns; i++) {
        row->row[i] = (double)NAN;
    }
    memcpy(row->row + row->columns, bytes, length / 2u);
    HELD_BY(self)[NAMES] = again(names);
    HELD_BY(self)[NUMBERS] = memory;
    return 0;
}

/* Puts the numbers of so many objects, or else of a tuple, in their places; returns the member behind theirs,
 * or NULL with an exception. */
static const member *put(const row_layout *row, const member *one, PyObject *const *objects, PyObject *tuple,
                         Py_ssize_t length) {
    for (Py_ssize_t i = 0; i < length && one != NULL; i++) {
        if (one->place == LEFT_OUT) {
            one++;
            continue;
        }
        PyObject *object = objects != NULL ? objects[i] : item(tuple, i);
        double value;
        if (object == NULL || (one->place >= 0 && !number(object, &value))) {
            return NULL;
        }
        if (one->place >= 0) {
            row->row[one->place] = value * row->row[row->columns + one->place];
            one++;
        } else {
            one = put(row, one + 1, NULL, object, one->length);
        }
    }
    return one;
}

/* Finds where the members of each named argument begin; false with TypeError for a name that the row has not.
 */
static bool find_called(PyObject *self, PyObject *called) {
    row_layout *row = OWNED(row_layout, self);
    PyObject *names = HELD_BY(self)[NAMES];
    const Py_ssize_t count = PyTuple_Size(called);
    for (Py_ssize_t i = 0; i < count; i++) {
        Py_ssize_t place = 0;
        while (place < PyTuple_Size(names) &&
               PyUnicode_Compare(PyTuple_GetItem(names, place), PyTuple_GetItem(called, i)) != 0) {
            place++;
        }
        if (place == PyTuple_Size(names)) {
            PyErr_Format(PyExc_TypeError, "a row has no %R; expected some of %R", PyTuple_GetItem(called, i),
                         names);
            return false;
        }
        row->called[i] = row->members + row->begins[place];
    }
    hold(&HELD_BY(self)[CALLED], again(called));
    return true;
}

static PyObject *row_make(PyObject *self, PyObject *const *given, Py_ssize_t count, PyObject *called) {
    const row_layout *row = OWNED(row_layout, self);
    PyObject *const *held = HELD_BY(self);
    if (held[NUMBERS] == NULL || count != 0 || called == NULL) {
        return PyErr_Format(PyExc_TypeError, "make() of a Row takes keyword arguments");
    }
    /* The names are the same object each time that a line of Python runs. */
    if (called != held[CALLED] && !find_called(self, called)) {
        return NULL;
    }
    const Py_ssize_t arguments = PyTuple_Size(called);
    for (Py_ssize_t i = 0; i < arguments; i++) {
        if (put(row, row->called[i], given + i, NULL, 1) == NULL) {
            return NULL;
        }
    }
    const double *pose = row->row + row->first[0];
    const double *other = row->row + row->first[1];
    double *difference = row->row + row->first[2];
    difference[0] = pose[0] - other[0];
    difference[1] = pose[1] - other[1];
    difference[2] = remainder(pose[2] - other[2], TURN_RAD);
    difference[3] = hypot(difference[0], difference[1]);
    return new_bytes((const uint8_t *)row->row, sizeof(double) * (size_t)row->columns);
}

static PyMethodDef row_methods[] = {METHOD("make", row_make, METH_FASTCALL | METH_KEYWORDS,
                                           "Put the numbers of named objects in their places; return all "
                                           "numbers as bytes. One that no object has "
                                           "keeps its value, NaN at first."),
                                    END};
static PyType_Slot row_slots[] = {
    SLOTS("Row(names, places, units, (pose, other, difference)): makes rows of doubles. `places` has for "
          "each name of "
          "make() the column of its number, or -1, or a tuple of these; `units` are doubles, a factor a "
          "column; the "
          "last are the first columns of two poses, and of x, y, heading and length of their difference.",
          row_init, row_methods),
    {0, NULL}};

/* Tables */

/* 4 by 4 cells, in which two numbers are looked up: two results, interpolated. */
typedef struct {
    double
        cells_a_unit[2]; /* of each input; zero is the middle of the table, and beyond its ends they hold */
    double cells[16][2][4]; /* row by row (second input); a result is a + b p + q (c + d p), p and q 0 to 4 */
} table;
enum { MOST_TABLES = MOST_FLOATS / 4 };
typedef struct {
    Py_ssize_t count;
    table one[MOST_TABLES];
    double nearest[4 * MOST_TABLES];
} tables;

INIT(tables_init) {
    tables *all = OWNED(tables, self);
    PyObject *packed;
    uint8_t *bytes;
    size_t length;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "O:Tables", &packed) || !bytes_of(packed, &bytes, &length)) {
        return -1;
    }
    if (length % sizeof(table) != 0u || length > sizeof all->one) {
        PyErr_Format(PyExc_ValueError, "%zd bytes of tables; expected %zd each, of %d at most", length,
                     sizeof(table), MOST_TABLES);
        return -1;
    }
    memcpy(all->one, bytes, length);
    all->count = (Py_ssize_t)(length / sizeof(table));
    for (size_t i = 0; i < 4u * MOST_TABLES; i++) {
        all->nearest[i] = (double)NAN;
    }
    return 0;
}

/* The place of an input along a table, 0 to 4. */
static double place_of(double input, double cells_a_unit) {
    const double place = cells_a_unit * input + 2.0;
    return place >= 4.0 ? 4.0 : place > 0.0 ? place : 0.0;
}

static int cell_at(double place) {
    return place >= 3.0 ? 3 : (int)place;
}

CALL_OF_ONE(tables_look_up) {
    tables *all = OWNED(tables, self);
    double inputs[2 * MOST_TABLES];
    double results[2 * MOST_TABLES];
    if (!numbers(given, 2 * all->count, inputs)) {
        return NULL;
    }
    for (Py_ssize_t i = 0; i < all->count; i++) {
        double *nearest = all->nearest + 4 * i;
        const double p = place_of(inputs[i], all->one[i].cells_a_unit[0]);
        const double q = place_of(inputs[all->count + i], all->one[i].cells_a_unit[1]);
        const double column = floor(p + 0.5);
        const double row = floor(q + 0.5);
        nearest[0] = p - 2.0;
        nearest[1] = q - 2.0;
        nearest[2] = 5.0 * row + column;
        nearest[3] = (1.0 - fabs(p - column)) * (1.0 - fabs(q - row));
        for (Py_ssize_t result = 0; result < 2; result++) {
            const double *c = all->one[i].cells[4 * cell_at(q) + cell_at(p)][result];
            results[result * all->count + i] = c[0] + c[1] * p + q * (c[2] + c[3] * p);
        }
    }
    return wheel_floats(NULL, results, 2 * all->count);
}

CALL_OF_NONE(tables_nearest) {
    (void)unused;
    return wheel_floats(NULL, OWNED(tables, self)->nearest, 4 * OWNED(tables, self)->count);
}

static PyMethodDef tables_methods[] = {
    METHOD("look_up", tables_look_up, METH_O,
           "Take the first input of each table, then the second of each; return the first results, then the "
           "second. "
           "NaN counts as the beginning of a table."),
    METHOD("nearest", tables_nearest, METH_NOARGS,
           "Return four numbers a table for the newest look-up, NaN before it: both places, from -2 to 2; "
           "the nearest "
           "corner, 5 times its row plus its column; and the product of its shares in both."),
    END};
static PyType_Slot tables_slots[] = {
    SLOTS("Tables(packed): tables of 4 by 4 cells. For each the cells in a unit of either input, and of 16 "
          "cells, row by "
          "row (second input), a, b, c and d of both results a + b p + q (c + d p), as doubles.",
          tables_init, tables_methods),
    {0, NULL}};

PyType_Spec wheel_specs_of_values[] = {SPEC("Tuples", OWNER(parts), tuples_slots),
                                       SPEC("Row", OWNER(row_layout), row_slots),
                                       SPEC("Tables", OWNER(tables), tables_slots)};
