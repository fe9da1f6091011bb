/* Named tuples, made of arguments, of numbers in memory and of packed frames. */
#include "../../client/packed.h"
#include "internal.h"

/* Returns a new reference to an object; NULL stays NULL. */
static void *again(void *object) {
    if (object != NULL) {
        python.Py_IncRef(object);
    }
    return object;
}

/* Returns the value that `*next` describes, and moves on behind all that belongs to it, and behind the
 * arguments that it takes; NULL with an exception. */
static void *value_of(const wheel_python_value **next, void *const **arguments) {
    const wheel_python_value *value = (*next)++;
    const void *at = value->at;
    switch (value->kind) {
    case WHEEL_PYTHON_ARGUMENT:
        return again(*(*arguments)++);
    case WHEEL_PYTHON_OBJECT:
        return again(value->object);
    case WHEEL_PYTHON_CHOICE:
        return again(python.PyTuple_GetItem(value->object, *(const uint8_t *)at));
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
    default: /* a tuple */
        break;
    }
    void *tuple = value->object == NULL ? python.PyTuple_New(value->length)
                                        : python.PyType_GenericAlloc(value->object, value->length);
    for (ptrdiff_t i = 0; tuple != NULL && i < value->length; i++) {
        void *item = value_of(next, arguments);
        if (item == NULL) {
            python.Py_DecRef(tuple);
            return NULL;
        }
        python.PyTuple_SetItem(tuple, i, item);
    }
    return tuple;
}

void *wheel_python_make(void *self, void *const *arguments, ptrdiff_t count) {
    const wheel_python_value *next = python.PyLong_AsVoidPtr(self);
    const bool *is_given = next->at;
    if (count != next->factor) {
        python.PyErr_BadArgument();
        return NULL;
    }
    return is_given != NULL && !*is_given ? python.Py_BuildValue("") : value_of(&next, &arguments);
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
