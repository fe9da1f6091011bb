/* Rows of numbers, of the tuples of a tick, and differences of motions. */
#include "internal.h"

#include <math.h>

#define TURN_RAD 6.283185307179586

/* Puts the numbers of a tuple in their places; returns the member behind its own, or NULL with an exception.
 */
static const wheel_python_member *put(const wheel_python_member *member, void *const *objects, void *tuple,
                                      ptrdiff_t length, double *row) {
    for (ptrdiff_t i = 0; i < length; i++) {
        if (member->place == WHEEL_PYTHON_LEFT_OUT) {
            member++;
            continue;
        }
        void *object = objects != NULL ? objects[i] : python.PyTuple_GetItem(tuple, i);
        if (object == NULL) {
            return NULL;
        }
        if (member->place == WHEEL_PYTHON_NESTED) {
            member = put(member + 1, NULL, object, member->length, row);
            if (member == NULL) {
                return NULL;
            }
            continue;
        }
        double value;
        if (!number(object, &value)) {
            return NULL;
        }
        row[member->place] = value * member->unit;
        member++;
    }
    return member;
}

/* Sets an item of a new tuple to an object that it borrows. */
static void set_again(void *tuple, ptrdiff_t place, void *object) {
    python.Py_IncRef(object);
    python.PyTuple_SetItem(tuple, place, object);
}

void *wheel_python_difference(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    void *twists[2];
    double motions[2][6];
    for (size_t i = 0; i < 2u; i++) {
        void *pose = python.PyTuple_GetItem(arguments[i], 0);
        twists[i] = pose == NULL ? NULL : python.PyTuple_GetItem(arguments[i], 1);
        if (twists[i] == NULL || !numbers(pose, 3, motions[i]) || !numbers(twists[i], 3, motions[i] + 3)) {
            return NULL;
        }
    }
    double error[6];
    for (size_t i = 0; i < 6u; i++) {
        error[i] = motions[0][i] - motions[1][i];
    }
    error[2] = remainder(error[2], TURN_RAD);
    void *all = python.PyTuple_New(4);
    if (all != NULL) {
        python.PyTuple_SetItem(all, 0, floats(error, 6));
        python.PyTuple_SetItem(all, 1, python.PyFloat_FromDouble(motions[0][2]));
        set_again(all, 2, twists[1]);
        set_again(all, 3, twists[0]);
    }
    return all;
}

void *wheel_python_row(void *self, void *const *arguments, ptrdiff_t count) {
    const wheel_python_layout *layout = address(self);
    if (put(layout->members, arguments, NULL, count, layout->numbers) == NULL) {
        return NULL;
    }
    const double *pose = layout->numbers + layout->pose;
    const double *other = layout->numbers + layout->other_pose;
    double *difference = layout->numbers + layout->difference;
    difference[0] = pose[0] - other[0];
    difference[1] = pose[1] - other[1];
    difference[2] = remainder(pose[2] - other[2], TURN_RAD);
    difference[3] = hypot(difference[0], difference[1]);
    return new_bytes((const uint8_t *)layout->numbers, sizeof(double) * layout->count);
}
