/* The age of feedback, the latency of commands, the motion of wheels, and the load of a line. */
#include "../../client/wheel_load.h"
#include "../../client/wheel_motion.h"
#include "../../client/wheel_timing.h"
#include "internal.h"

#include <math.h>
#include <stddef.h>

/* Freshness */

typedef OWNER(wheel_freshness) freshness_object;

/* Sets the attributes, which are held: of objects Python reads an attribute in a tenth of the time. */
static void tell_ages(PyObject *self) {
    const wheel_freshness *it = OWNED(wheel_freshness, self);
    hold(&HELD_BY(self)[0], PyLong_FromLongLong(it->silent_ns));
    hold(&HELD_BY(self)[1], it->has_truth ? PyLong_FromLongLong(it->truth_ns) : none());
    hold(&HELD_BY(self)[2], PyBool_FromLong(it->is_stale));
}

INIT(freshness_init) {
    long long stale_ns;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "L:Freshness", &stale_ns)) {
        return -1;
    }
    *OWNED(wheel_freshness, self) = (wheel_freshness){.stale_ns = stale_ns};
    tell_ages(self);
    return 0;
}

CALL(freshness_add) {
    int64_t robot_ns;
    int64_t state;
    int64_t age_ns;
    int64_t now_ns;
    int64_t is_driven;
    if (!TAKES("add", 5) || !integer_at(given[0], 0, &robot_ns) || !integer_at(given[0], 1, &state) ||
        !integer(given[2], &age_ns) || !integer(given[3], &now_ns) || !integer(given[4], &is_driven)) {
        return NULL;
    }
    int64_t truth_ns = 0;
    double pose[3] = {(double)NAN};
    if (given[1] != &_Py_NoneStruct) {
        PyObject *three = item(given[1], 1);
        if (three == NULL || !integer_at(given[1], 0, &truth_ns) || !numbers(three, 3, pose)) {
            return NULL;
        }
    }
    const bool has_truth = isfinite(pose[0]) && isfinite(pose[1]) && isfinite(pose[2]);
    const uint8_t result = wheel_freshness_add(OWNED(wheel_freshness, self), robot_ns, (uint8_t)state, age_ns,
                                               now_ns, is_driven != 0, has_truth ? &truth_ns : NULL);
    tell_ages(self);
    return PyLong_FromLongLong(result);
}

CALL_OF_ONE(freshness_has_aged) {
    const wheel_freshness *it = OWNED(wheel_freshness, self);
    int64_t now_ns;
    return integer(given, &now_ns)
               ? PyBool_FromLong(it->has_truth && now_ns - it->truth_received_ns > it->stale_ns)
               : NULL;
}

CALL_OF_ONE(freshness_restart) {
    int64_t was_reset;
    if (!integer(given, &was_reset)) {
        return NULL;
    }
    wheel_freshness_restart(OWNED(wheel_freshness, self), was_reset != 0);
    tell_ages(self);
    return none();
}

static PyMemberDef freshness_members[] = {
    {"silent_ns", T_OBJECT_EX, offsetof(owner, held[0]), READONLY, "time since new feedback came [ns]"},
    {"truth_ns", T_OBJECT_EX, offsetof(owner, held[1]), READONLY,
     "the robot's time of the newest truth, or None"},
    {"is_stale", T_OBJECT_EX, offsetof(owner, held[2]), READONLY, "whether they are too old to drive by"},
    {NULL, 0, 0, 0, NULL}};
static PyMethodDef freshness_methods[] = {
    METHOD("add", freshness_add, METH_FASTCALL,
           "Add feedback (robot time [ns], state, ...), a truth (time [ns], pose, ...) or None, the "
           "feedback's age and "
           "the time [ns], and whether the robot is driven. Return 0, or what is wrong: WHEEL_FRESHNESS_..."),
    METHOD("has_aged", freshness_has_aged, METH_O, "Return whether a truth has become too old since add()."),
    METHOD("begin_again", freshness_restart, METH_O,
           "Begin again with a robot that came back; was it reset?"),
    END};
static PyType_Slot freshness_slots[] = {
    SLOTS("Freshness(stale_ns): whether feedback is fresh enough to drive by (wheel_timing.h).",
          freshness_init, freshness_methods),
    {Py_tp_members, freshness_members},
    {0, NULL}};

/* Latency */

typedef OWNER(wheel_latency) latency_object;

INIT(latency_init) {
    double configured_s;
    long long longest_ns;
    PyObject *applied;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "dLO:Latency", &configured_s, &longest_ns, &applied) ||
        !wheel_is_kind(applied)) {
        return -1;
    }
    wheel_latency_init(OWNED(wheel_latency, self), configured_s, longest_ns);
    hold(&HELD_BY(self)[0], again(applied));
    return 0;
}

CALL(latency_applied) {
    wheel_latency *latency = OWNED(wheel_latency, self);
    int64_t sequence;
    int64_t sampled_ns;
    int64_t robot_ns;
    int64_t in_force;
    int64_t age_ms;
    if (!TAKES("applied", 5) || !integer_at(given[0], 0, &robot_ns) || !integer_at(given[0], 2, &in_force) ||
        !integer_at(given[0], 3, &age_ms) || !integer(given[1], &sequence) ||
        !integer(given[2], &sampled_ns)) {
        return NULL;
    }
    wheel_latency_acted(latency, (uint8_t)in_force, robot_ns, (uint8_t)age_ms);
    wheel_latency_sent(latency, (uint8_t)sequence, sampled_ns);
    return JOINED(HELD_BY(self)[0], again(given[3]), again(given[4]), PyFloat_FromDouble(latency->median_s));
}

static PyMemberDef latency_members[] = {
    {"s", T_DOUBLE, offsetof(latency_object, owned.median_s), READONLY, "the latency [s]"},
    {NULL, 0, 0, 0, NULL}};
static PyMethodDef latency_methods[] = {
    METHOD("applied", latency_applied, METH_FASTCALL,
           "Note feedback (robot time [ns], state, sequence in force, its age [ms], ...), and a command's "
           "sequence and "
           "robot time [ns] of what it is based on. Return Applied(command, saturated, latency [s])."),
    END};
static PyType_Slot latency_slots[] = {
    SLOTS("Latency(configured_s, longest_ns, Applied): the latency of commands (wheel_timing.h).",
          latency_init, latency_methods),
    {Py_tp_members, latency_members},
    {0, NULL}};

/* Motion */

CALL(motion_add) {
    wheel_motion *motion = OWNED(wheel_motion, self);
    double speed_rad_s[4];
    double pose[3];
    double twist[3];
    double latency_s;
    double older_s;
    int64_t time_ns;
    PyObject *at;
    PyObject *moves;
    if (!TAKES("add", 5) || !numbers(given[0], 4, speed_rad_s) || !integer(given[1], &time_ns) ||
        (at = item(given[2], 0)) == NULL || (moves = item(given[2], 1)) == NULL || !numbers(at, 3, pose) ||
        !numbers(moves, 3, twist) || !number(given[3], &latency_s) || !number(given[4], &older_s)) {
        return NULL;
    }
    motion->older_s = older_s;
    return PyBool_FromLong(wheel_motion_add(motion, speed_rad_s, time_ns, twist, pose[2], latency_s));
}

static PyMethodDef motion_methods[] = {METHOD("add", motion_add, METH_FASTCALL,
                                              "Add four speeds [rad/s] at a robot time [ns], the state "
                                              "(pose, twist, ...), the latency [s], and by how "
                                              "much the state is newer [s]. Return whether a limit is near."),
                                       END};
static PyType_Slot motion_slots[] = {
    SLOTS("Motion(): motion and slip of the wheels (wheel_motion.h), of zeros; cffi sets its fields.",
          wheel_init_of_none, motion_methods),
    {0, NULL}};

/* Load */

typedef OWNER(wheel_load) load_object;

INIT(load_init) {
    double unit_percent;
    (void)unused;
    if (!PyArg_ParseTuple(arguments, "d:Load", &unit_percent)) {
        return -1;
    }
    *OWNED(wheel_load, self) = (wheel_load){.unit_percent = unit_percent};
    hold(&HELD_BY(self)[0], again(arguments));
    return 0;
}

CALL(load_count) {
    int64_t now_ns;
    double total;
    if (!TAKES("count", 2) || !integer(given[0], &now_ns) || !number(given[1], &total)) {
        return NULL;
    }
    return PyFloat_FromDouble(wheel_load_count(OWNED(wheel_load, self), now_ns, total));
}

CALL(load_count_both) {
    wheel_load *other;
    int64_t now_ns;
    double totals[2];
    if (!TAKES("count_both", 3) || (other = wheel_owned(given[0], LOAD)) == NULL ||
        !integer(given[1], &now_ns) || !numbers(given[2], 2, totals)) {
        return NULL;
    }
    const double first = wheel_load_count(OWNED(wheel_load, self), now_ns, totals[0]);
    const double second = wheel_load_count(other, now_ns, totals[1]);
    return PyFloat_FromDouble(first > second ? first : second);
}

static PyMemberDef load_members[] = {
    {"total", T_DOUBLE, offsetof(load_object, owned.total), 0, "how much there was so far"},
    {"most", T_DOUBLE, offsetof(load_object, owned.most), READONLY, "how much there was in the worst window"},
    {NULL, 0, 0, 0, NULL}};
static PyMethodDef load_methods[] = {
    METHOD("count", load_count, METH_FASTCALL,
           "Set at a time [ns] how much there was so far; return the load of the window that ends now [%]."),
    METHOD("count_both", load_count_both, METH_FASTCALL,
           "Do so for this load and another one, with a tuple of two; return the greater load [%]."),
    END};
static PyType_Slot load_slots[] = {
    SLOTS("Load(unit_percent): the load of a line (wheel_load.h).", load_init, load_methods),
    {Py_tp_members, load_members},
    {0, NULL}};

PyType_Spec wheel_specs_of_timing[] = {
    SPEC("Freshness", freshness_object, freshness_slots), SPEC("Latency", latency_object, latency_slots),
    SPEC("Motion", OWNER(wheel_motion), motion_slots), SPEC("Load", load_object, load_slots)};
