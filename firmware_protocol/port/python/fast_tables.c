/* Tables in which numbers are looked up, two at a time. */
#include "internal.h"

#include <math.h>

/* The place of an input along a table, 0 to 4. */
static double place_of(double input, double cells_a_unit) {
    const double place = cells_a_unit * input + 2.0;
    return place >= 4.0 ? 4.0 : place > 0.0 ? place : 0.0;
}

static int cell_at(double place) {
    return place >= 3.0 ? 3 : (int)place;
}

/* Reads an input of a table; false with an exception. */
static bool input_of(void *inputs, ptrdiff_t at, double *value) {
    void *item = python.PyTuple_GetItem(inputs, at);
    return item != NULL && number(item, value);
}

void *wheel_python_look_up(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    const wheel_python_tables *all = address(self);
    void *results = python.PyTuple_New(2 * all->count);
    for (ptrdiff_t i = 0; results != NULL && i < all->count; i++) {
        const wheel_python_table *table = &all->tables[i];
        double *nearest = all->nearest + 4 * i;
        double first;
        double second;
        if (!input_of(arguments[0], i, &first) || !input_of(arguments[0], all->count + i, &second)) {
            python.Py_DecRef(results);
            return NULL;
        }
        const double p = place_of(first, table->cells_a_unit[0]);
        const double q = place_of(second, table->cells_a_unit[1]);
        const double column = floor(p + 0.5);
        const double row = floor(q + 0.5);
        nearest[0] = p - 2.0;
        nearest[1] = q - 2.0;
        nearest[2] = 5.0 * row + column;
        nearest[3] = (1.0 - fabs(p - column)) * (1.0 - fabs(q - row));
        for (ptrdiff_t result = 0; result < 2; result++) {
            const double *c = table->cells[4 * cell_at(q) + cell_at(p)][result];
            const double value = c[0] + c[1] * p + q * (c[2] + c[3] * p);
            python.PyTuple_SetItem(results, result * all->count + i, python.PyFloat_FromDouble(value));
        }
    }
    return results;
}
