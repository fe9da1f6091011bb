/* A non-blocking terminal of this machine, read and written by few system calls. POSIX only. */
#include "internal.h"

#ifndef _WIN32

#include <limits.h>
#include <sys/ioctl.h>
#include <unistd.h>

/* Reads a descriptor; false with an exception. A number cut to an int might be another one's descriptor. */
static bool descriptor_of(void *object, int *descriptor) {
    const int64_t value = integer(object);
    if (failed()) {
        return false;
    }
    if (value < 0 || value > INT_MAX) {
        python.PyErr_BadArgument();
        return false;
    }
    *descriptor = (int)value;
    return true;
}

void *wheel_python_terminal_read(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    uint8_t bytes[WHEEL_PYTHON_TERMINAL];
    int waiting = 0;
    int descriptor;
    if (!descriptor_of(arguments[0], &descriptor)) {
        return NULL;
    }
    if (ioctl(descriptor, FIONREAD, &waiting) != 0) {
        return none();
    }
    if (waiting <= 0) {
        return new_bytes(bytes, 0);
    }
    const ssize_t length = read(descriptor, bytes, sizeof bytes);
    return length < 0 ? none() : new_bytes(bytes, (size_t)length);
}

void *wheel_python_terminal_write(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    uint8_t *bytes;
    size_t length;
    int descriptor;
    if (!descriptor_of(arguments[0], &descriptor) || !bytes_of(arguments[1], &bytes, &length)) {
        return NULL;
    }
    const ssize_t written = write(descriptor, bytes, length);
    return python.PyLong_FromLongLong(written < 0 ? 0 : (long long)written);
}

#endif
