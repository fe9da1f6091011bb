/* A non-blocking terminal of this machine, read and written by few system calls. POSIX only. */
#include "internal.h"

#ifndef _WIN32

#include <limits.h>
#include <sys/ioctl.h>
#include <unistd.h>

enum { AT_ONCE = 4096 }; /* bytes: as many as Linux keeps for a reader of a terminal */

/* Reads a descriptor; false with an exception. A number cut to an int might be another one's descriptor. */
static bool descriptor_of(PyObject *object, int *descriptor) {
    int64_t value;
    if (!integer(object, &value)) {
        return false;
    }
    if (value < 0 || value > INT_MAX) {
        PyErr_Format(PyExc_ValueError, "%lld is no descriptor", (long long)value);
        return false;
    }
    *descriptor = (int)value;
    return true;
}

PyObject *wheel_terminal_read(PyObject *self, PyObject *given) {
    (void)self;
    uint8_t bytes[AT_ONCE];
    int waiting = 0;
    int descriptor;
    if (!descriptor_of(given, &descriptor)) {
        return NULL;
    }
    /* A read that finds nothing may wait for a thread of the kernel. */
    if (ioctl(descriptor, FIONREAD, &waiting) != 0) {
        return none();
    }
    const ssize_t length = waiting <= 0 ? 0 : read(descriptor, bytes, sizeof bytes);
    return length < 0 ? none() : new_bytes(bytes, (size_t)length);
}

PyObject *wheel_terminal_write(PyObject *self, PyObject *const *given, Py_ssize_t count) {
    (void)self;
    uint8_t *bytes;
    size_t length;
    int descriptor;
    if (!TAKES("terminal_write", 2) || !descriptor_of(given[0], &descriptor) ||
        !bytes_of(given[1], &bytes, &length)) {
        return NULL;
    }
    const ssize_t written = write(descriptor, bytes, length);
    return PyLong_FromLongLong(written < 0 ? 0 : (long long)written);
}

#endif
