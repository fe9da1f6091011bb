/* The model of the robot that laws use. */
#include "internal.h"

#include <math.h>

/* Reads three numbers of a sequence of any kind, because a law may be a user's; false with an exception. */
static bool axes(void *sequence, double values[3]) {
    if (python.PyTuple_Size(sequence) >= 3) {
        return numbers(sequence, 3, values);
    }
    python.PyErr_Clear();
    for (ptrdiff_t i = 0; i < 3; i++) {
        void *item = python.PySequence_GetItem(sequence, i);
        if (item == NULL) {
            return false;
        }
        const bool is_number = number(item, &values[i]);
        python.Py_DecRef(item);
        if (!is_number) {
            return false;
        }
    }
    return true;
}

void *wheel_python_wheel_torques(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    double inertia[3];
    double geometry[2];
    double acceleration[3];
    double twist[3];
    double heading_rad;
    if (!numbers(arguments[0], 3, inertia) || !numbers(arguments[1], 2, geometry) ||
        !axes(arguments[2], acceleration) || !axes(arguments[3], twist) ||
        !number(arguments[4], &heading_rad)) {
        return NULL;
    }
    const double mass_kg = inertia[0];
    const double coupling = inertia[1] * twist[2];
    const double force_x = mass_kg * acceleration[0] + coupling * twist[1];
    const double force_y = mass_kg * acceleration[1] - coupling * twist[0];
    /* B+ gives the torques of least norm: rotate into the body frame, then apply (r / 4) H diag(1, 1, 1/L2).
     */
    const double c = cos(heading_rad);
    const double s = sin(heading_rad);
    const double quarter_m = geometry[0] / 4.0;
    const double forward = quarter_m * (c * force_x + s * force_y);
    const double left = quarter_m * (c * force_y - s * force_x);
    const double turn = quarter_m * (inertia[2] * acceleration[2]) / geometry[1];
    const double minus = forward - left;
    const double plus = forward + left;
    return floats((double[]){minus - turn, plus + turn, minus + turn, plus - turn}, 4);
}
