/* Named tuples, made of arguments, of numbers in memory and of packed frames. */
#include "../../client/packed.h"
#include "internal.h"

#include <string.h>

/* Returns a new reference to an object; NULL stays NULL. */
static void *again(void *object) {
    if (object != NULL) {
        python.Py_IncRef(object);
    }
    return object;
}

/* Where in the description of a tuple the next value is, and the next argument. */
typedef struct {
    const wheel_python_value *value;
    void *const *argument;
} cursor;

static void *tuple_at(cursor *at);

/* Returns the tuple that was made the last time, if its numbers are the same, or else a new one. */
static void *kept_at(cursor *at) {
    const wheel_python_value *value = at->value++;
    wheel_python_kept *kept = value->object;
    const size_t bytes = (size_t)value->length;
    if (kept->made != NULL && memcmp(kept->numbers, value->at, bytes) == 0) {
        at->value += value->factor;
        return again(kept->made);
    }
    void *made = tuple_at(at);
    if (made != NULL) {
        python.PyList_SetItem(kept->holder, 0, again(made));
        memcpy(kept->numbers, value->at, bytes);
        kept->made = made;
    }
    return made;
}

/* Returns what a value that is no tuple and no argument describes; NULL with an exception. */
static inline void *object_of(const wheel_python_value *value) {
    const void *at = value->at;
    switch (value->kind) {
    case WHEEL_PYTHON_FLOAT:
        return python.PyFloat_FromDouble((double)*(const float *)at);
    case WHEEL_PYTHON_DOUBLE:
        return python.PyFloat_FromDouble(*(const double *)at);
    case WHEEL_PYTHON_UINT8:
        return python.PyLong_FromLongLong(*(const uint8_t *)at);
    case WHEEL_PYTHON_UINT16:
        return python.PyLong_FromLongLong(*(const uint16_t *)at);
    case WHEEL_PYTHON_UINT64:
        return python.PyLong_FromLongLong((long long)*(const uint64_t *)at * value->factor);
    case WHEEL_PYTHON_CHOICE:
        return again(python.PyTuple_GetItem(value->object, *(const uint8_t *)at));
    default: /* WHEEL_PYTHON_OBJECT */
        return again(value->object);
    }
}

/* Returns the tuple that is described at a cursor, and moves it on behind all that belongs to it; NULL with
 * an exception. */
static void *tuple_at(cursor *at) {
    const wheel_python_value *value = at->value++;
    void *tuple = value->object == NULL ? python.PyTuple_New(value->length)
                                        : python.PyType_GenericAlloc(value->object, value->length);
    for (ptrdiff_t i = 0; tuple != NULL && i < value->length; i++) {
        const int32_t kind = at->value->kind;
        void *item = kind == WHEEL_PYTHON_ARGUMENT ? (at->value++, again(*at->argument++))
                     : kind == WHEEL_PYTHON_TUPLE  ? tuple_at(at)
                     : kind == WHEEL_PYTHON_KEPT   ? kept_at(at)
                                                   : object_of(at->value++);
        if (item == NULL) {
            python.Py_DecRef(tuple);
            return NULL;
        }
        python.PyTuple_SetItem(tuple, i, item);
    }
    return tuple;
}

void *wheel_python_make(void *self, void *const *arguments, ptrdiff_t count) {
    cursor at = {address(self), arguments};
    const bool *is_given = at.value->at;
    if (count != at.value->factor) {
        python.PyErr_BadArgument();
        return NULL;
    }
    return is_given != NULL && !*is_given ? none() : tuple_at(&at);
}

void *wheel_python_frames(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    uint8_t *packed;
    size_t end;
    if (!bytes_of(arguments[0], &packed, &end)) {
        return NULL;
    }
    wheel_packed frame;
    ptrdiff_t frames = 0;
    for (size_t at = 0; wheel_packed_take(packed, at, end, &frame); at = frame.next) {
        frames++;
    }
    void *tuple = python.PyTuple_New(frames);
    size_t at = 0;
    for (ptrdiff_t i = 0; tuple != NULL && i < frames; i++) {
        (void)wheel_packed_take(packed, at, end, &frame);
        void *made = python.PyType_GenericAlloc(arguments[1], 2);
        if (made == NULL) {
            python.Py_DecRef(tuple);
            return NULL;
        }
        python.PyTuple_SetItem(made, 0, python.PyLong_FromLongLong(frame.id));
        python.PyTuple_SetItem(made, 1, new_bytes(frame.payload, frame.length));
        python.PyTuple_SetItem(tuple, i, made);
        at = frame.next;
    }
    return tuple;
}

/* Reads a frame of a tuple of frames; false with an exception. */
static bool frame_at(void *frames, ptrdiff_t place, long long *id, uint8_t **payload, size_t *length) {
    void *frame = python.PyTuple_GetItem(frames, place);
    void *number = frame == NULL ? NULL : python.PyTuple_GetItem(frame, 0);
    void *content = number == NULL ? NULL : python.PyTuple_GetItem(frame, 1);
    if (content == NULL || !bytes_of(content, payload, length)) {
        return false;
    }
    *id = integer(number);
    if (*id < 0 || *id > UINT16_MAX || *length > UINT8_MAX) {
        python.PyErr_BadArgument();
        return false;
    }
    return true;
}

void *wheel_python_pack(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    const ptrdiff_t frames = python.PyTuple_Size(arguments[0]);
    long long id;
    uint8_t *payload;
    size_t length;
    size_t size = 0;
    for (ptrdiff_t i = 0; i < frames; i++) {
        if (!frame_at(arguments[0], i, &id, &payload, &length)) {
            return NULL;
        }
        size += WHEEL_PACKED_HEADER + length;
    }
    void *packed = frames < 0 ? NULL : new_bytes(NULL, size);
    uint8_t *at;
    if (packed == NULL || !bytes_of(packed, &at, &size)) {
        return NULL;
    }
    for (ptrdiff_t i = 0; i < frames && frame_at(arguments[0], i, &id, &payload, &length); i++) {
        at[0] = (uint8_t)((unsigned long long)id & 0xFFu);
        at[1] = (uint8_t)((unsigned long long)id >> 8);
        at[2] = (uint8_t)length;
        memcpy(at + WHEEL_PACKED_HEADER, payload, length);
        at += WHEEL_PACKED_HEADER + length;
    }
    return packed;
}
