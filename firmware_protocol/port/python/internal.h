/* What the files of the fast calls share. */
#ifndef WHEEL_PYTHON_INTERNAL_H
#define WHEEL_PYTHON_INTERNAL_H

#include <stdbool.h>

#include "fast_calls.h"

/* CPython's functions, as wheel_python_begin got them; short, because it is in every other line. */
#define python wheel_python_given
extern wheel_python wheel_python_given;

/* Returns a new reference to None. */
static inline void *none(void) {
    python.Py_IncRef(python._Py_NoneStruct);
    return python._Py_NoneStruct;
}

static inline bool failed(void) {
    return python.PyErr_Occurred() != NULL;
}

/* Returns the address that an int of fast_calls.py is. */
static inline void *address(void *object) {
    return (void *)(uintptr_t)python.PyLong_AsUnsignedLongLongMask(object);
}

/* Returns an int as a number; -1 with an exception. PyLong_AsLongLong takes four times as long for a time
 * [ns]. */
static inline int64_t integer(void *object) {
    int overflow;
    const long long value = python.PyLong_AsLongLongAndOverflow(object, &overflow);
    return overflow == 0 ? value : python.PyLong_AsLongLong(object); /* raises OverflowError */
}

/* Reads a number; false with an exception. */
static inline bool number(void *object, double *value) {
    *value = python.PyFloat_AsDouble(object);
    return *value != -1.0 || !failed();
}

/* Reads the first numbers of a tuple; false with an exception. */
static inline bool numbers(void *tuple, ptrdiff_t count, double *values) {
    for (ptrdiff_t i = 0; i < count; i++) {
        void *item = python.PyTuple_GetItem(tuple, i);
        if (item == NULL || !number(item, &values[i])) {
            return false;
        }
    }
    return true;
}

/* Returns a new tuple of floats. */
static inline void *floats(const double *values, ptrdiff_t count) {
    void *tuple = python.PyTuple_New(count);
    for (ptrdiff_t i = 0; tuple != NULL && i < count; i++) {
        python.PyTuple_SetItem(tuple, i, python.PyFloat_FromDouble(values[i]));
    }
    return tuple;
}

static inline void *new_bytes(const uint8_t *bytes, size_t length) {
    return python.PyBytes_FromStringAndSize((const char *)bytes, (ptrdiff_t)length);
}

/* Reads bytes; false with an exception. */
static inline bool bytes_of(void *object, uint8_t **bytes, size_t *length) {
    char *start;
    ptrdiff_t size;
    if (python.PyBytes_AsStringAndSize(object, &start, &size) < 0) {
        return false;
    }
    *bytes = (uint8_t *)start;
    *length = (size_t)size;
    return true;
}

#endif
