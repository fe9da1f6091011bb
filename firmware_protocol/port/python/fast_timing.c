/* The age of feedback, the latency of commands, the load of a line and the motion of wheels, of the tuples of
 * a tick. */
#include "../../client/wheel_load.h"
#include "../../client/wheel_motion.h"
#include "../../client/wheel_timing.h"

#include <math.h>

#include "internal.h"

/* Reads an int of a tuple; false with an exception. */
static bool int_at(void *tuple, ptrdiff_t place, int64_t *value) {
    void *item = python.PyTuple_GetItem(tuple, place);
    if (item == NULL) {
        return false;
    }
    *value = integer(item);
    return *value != -1 || !failed();
}

/* Reads whether a tuple of three is finite; false with an exception. */
static bool is_finite(void *three, bool *result) {
    double values[3];
    if (!numbers(three, 3, values)) {
        return false;
    }
    *result = isfinite(values[0]) && isfinite(values[1]) && isfinite(values[2]);
    return true;
}

void *wheel_python_finite(void *self, void *const *arguments, ptrdiff_t count) {
    (void)self, (void)count;
    bool is_all = true;
    for (ptrdiff_t i = 0; i < 2; i++) {
        void *three = python.PyTuple_GetItem(arguments[0], i);
        bool is_one;
        if (three == NULL || !is_finite(three, &is_one)) {
            return NULL;
        }
        is_all = is_all && is_one;
    }
    return python.PyBool_FromLong(is_all);
}

void *wheel_python_add_feedback(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_freshness *freshness = address(self);
    const int64_t age_ns = integer(arguments[2]);
    const int64_t now_ns = integer(arguments[3]);
    const bool is_driven = integer(arguments[4]) != 0;
    int64_t robot_ns;
    int64_t state;
    int64_t truth_ns = 0;
    bool has_truth = false;
    if (failed() || !int_at(arguments[0], 0, &robot_ns) || !int_at(arguments[0], 1, &state)) {
        return NULL;
    }
    if (arguments[1] != python._Py_NoneStruct) {
        void *pose = python.PyTuple_GetItem(arguments[1], 1);
        if (pose == NULL || !int_at(arguments[1], 0, &truth_ns) || !is_finite(pose, &has_truth)) {
            return NULL;
        }
    }
    const uint8_t result = wheel_freshness_add(freshness, robot_ns, (uint8_t)state, age_ns, now_ns, is_driven,
                                               has_truth ? &truth_ns : NULL);
    void *all = python.PyTuple_New(4);
    if (all != NULL) {
        python.PyTuple_SetItem(all, 0, python.PyLong_FromLongLong(result));
        python.PyTuple_SetItem(all, 1, python.PyLong_FromLongLong(freshness->silent_ns));
        python.PyTuple_SetItem(
            all, 2, freshness->has_truth ? python.PyLong_FromLongLong(freshness->truth_ns) : none());
        python.PyTuple_SetItem(all, 3, python.PyBool_FromLong(freshness->is_stale));
    }
    return all;
}

void *wheel_python_measure_latency(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_latency *latency = address(self);
    const long long sequence = integer(arguments[1]);
    const int64_t sampled_ns = integer(arguments[2]);
    int64_t robot_ns;
    int64_t in_force;
    int64_t age_ms;
    if (failed() || !int_at(arguments[0], 0, &robot_ns) || !int_at(arguments[0], 2, &in_force) ||
        !int_at(arguments[0], 3, &age_ms)) {
        return NULL;
    }
    wheel_latency_acted(latency, (uint8_t)in_force, robot_ns, (uint8_t)age_ms);
    wheel_latency_sent(latency, (uint8_t)sequence, sampled_ns);
    return python.PyFloat_FromDouble(latency->median_s);
}

void *wheel_python_add_motion(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_motion *motion = address(self);
    const int64_t time_ns = integer(arguments[1]);
    double speed_rad_s[4];
    double pose[3];
    double twist[3];
    double latency_s;
    double older_s;
    if (failed() || !numbers(arguments[0], 4, speed_rad_s) || !number(arguments[3], &latency_s) ||
        !number(arguments[4], &older_s)) {
        return NULL;
    }
    void *at = python.PyTuple_GetItem(arguments[2], 0);
    void *moves = at == NULL ? NULL : python.PyTuple_GetItem(arguments[2], 1);
    if (moves == NULL || !numbers(at, 3, pose) || !numbers(moves, 3, twist)) {
        return NULL;
    }
    motion->older_s = older_s;
    return python.PyBool_FromLong(wheel_motion_add(motion, speed_rad_s, time_ns, twist, pose[2], latency_s));
}

void *wheel_python_has_aged(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    const wheel_freshness *freshness = address(self);
    const int64_t now_ns = integer(arguments[0]);
    if (failed()) {
        return NULL;
    }
    return python.PyBool_FromLong(freshness->has_truth &&
                                  now_ns - freshness->truth_received_ns > freshness->stale_ns);
}

void *wheel_python_count_load(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    const int64_t now_ns = integer(arguments[0]);
    double total;
    if (failed() || !number(arguments[1], &total)) {
        return NULL;
    }
    return python.PyFloat_FromDouble(wheel_load_count(address(self), now_ns, total));
}

void *wheel_python_count_loads(void *self, void *const *arguments, ptrdiff_t count) {
    (void)count;
    wheel_load *loads = address(self);
    const int64_t now_ns = integer(arguments[0]);
    double totals[2];
    if (failed() || !numbers(arguments[1], 2, totals)) {
        return NULL;
    }
    const double first = wheel_load_count(&loads[0], now_ns, totals[0]);
    const double second = wheel_load_count(&loads[1], now_ns, totals[1]);
    return python.PyFloat_FromDouble(first > second ? first : second);
}
