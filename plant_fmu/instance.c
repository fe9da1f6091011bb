#include "instance.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "physics.h"

/* Past this many internal steps a communication step would look like a hang. */
static const double MOST_INTERNAL_STEPS = 2e5;
/* A value that is so many times its start value, or that part of it, is worth a word where numbers fail. */
static const double EXTREME_FACTOR = 100.0;
/* The same of a value that starts at 0, without a range: in SI units. */
static const double EXTREME_SIZE = 1e4;
enum { MOST_NAMED = 4 };

/* A tunable parameter may also be set between steps. */
typedef enum { INPUT, OUTPUT, PARAMETER, TUNABLE, INDEPENDENT } causality;

typedef struct {
    const char *name;
    plant_type type;
    causality causality;
    size_t offset; /* into plant_snapshot */
    double start;
    double min;
    double max;
} variable;

#define ROW(reference, type_, causality_, member, start_, min_, max_, name_)                                 \
    [reference] = {name_, PLANT_##type_, causality_, offsetof(plant_snapshot, member), start_, min_, max_},
static const variable VARIABLES[MECANUM_VARIABLE_COUNT] = {MECANUM_VARIABLES(ROW)};

static void store(plant_snapshot *snapshot, const variable *v, double value) {
    char *const place = (char *)snapshot + v->offset;
    if (v->type == PLANT_REAL) {
        memcpy(place, &value, sizeof value);
    } else {
        const int32_t integer = (int32_t)value;
        memcpy(place, &integer, sizeof integer);
    }
}

void plant_init(plant_instance *plant, plant_report report, void *owner) {
    /* memset, not an initialiser: padding too, so that equal states are equal bytes. */
    memset(plant, 0, sizeof *plant);
    plant->report = report;
    plant->owner = owner;
    plant->now.mode = PLANT_INSTANTIATED;
    plant->now.outputs_stale = true;
    for (size_t i = 0; i < MECANUM_VARIABLE_COUNT; i++) {
        store(&plant->now, &VARIABLES[i], VARIABLES[i].start);
    }
}

bool plant_fail(plant_instance *plant, const char *format, ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    plant->now.mode = PLANT_ERROR;
    plant->report(plant->owner, false, text);
    return false;
}

bool plant_discard(plant_instance *plant, const char *format, ...) {
    char text[256];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    plant->report(plant->owner, true, text);
    return false;
}

bool plant_has_discarded(const plant_instance *plant) {
    return plant->now.mode != PLANT_ERROR;
}

static double value_of(const plant_snapshot *snapshot, const variable *v) {
    const char *const place = (const char *)snapshot + v->offset;
    double value;
    int32_t integer;
    if (v->type == PLANT_REAL) {
        memcpy(&value, place, sizeof value);
        return value;
    }
    memcpy(&integer, place, sizeof integer);
    return (double)integer;
}

/* Tells how far a value is from usual: 1 and more is worth a word. */
static double extremeness(const plant_snapshot *snapshot, const variable *v) {
    if (v->type != PLANT_REAL || v->causality == OUTPUT || v->causality == INDEPENDENT) {
        return 0.0;
    }
    const double size = fabs(value_of(snapshot, v));
    const double usual = fabs(v->start);
    if (usual > 0.0) {
        return size == usual ? 0.0 : fmax(size / usual, usual / size) / EXTREME_FACTOR;
    }
    const double limit = fmin(fmax(fabs(v->min), fabs(v->max)), 2.0 * EXTREME_SIZE);
    return size / (0.5 * limit);
}

bool plant_discard_extreme(plant_instance *plant, const char *format, ...) {
    char text[512];
    va_list arguments;
    va_start(arguments, format);
    size_t length = (size_t)vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    bool is_named[MECANUM_VARIABLE_COUNT] = {false};
    for (int named = 0; named < MOST_NAMED && length < sizeof text; named++) {
        const variable *most = NULL;
        double most_extreme = 1.0;
        for (const variable *v = VARIABLES; v < VARIABLES + MECANUM_VARIABLE_COUNT; v++) {
            const double extreme = is_named[v - VARIABLES] ? 0.0 : extremeness(&plant->now, v);
            if (extreme >= most_extreme) {
                most = v;
                most_extreme = extreme;
            }
        }
        if (most == NULL) {
            break;
        }
        is_named[most - VARIABLES] = true;
        length +=
            (size_t)snprintf(text + length, sizeof text - length, "%s %s = %.10g",
                             named == 0 ? "; far from usual:" : ",", most->name, value_of(&plant->now, most));
    }
    plant->report(plant->owner, true, text);
    return false;
}

bool plant_allows(plant_instance *plant, unsigned modes, const char *call) {
    const plant_mode mode = plant->now.mode;
    if (((unsigned)mode & modes) != 0) {
        return true;
    }
    const char *const name = mode == PLANT_INSTANTIATED     ? "instantiated"
                             : mode == PLANT_INITIALIZATION ? "initialization mode"
                             : mode == PLANT_STEP_COMPLETE  ? "step complete"
                             : mode == PLANT_TERMINATED     ? "terminated"
                                                            : "error";
    return plant_fail(plant, "%s is not allowed in the state \"%s\"", call, name);
}

bool plant_setup(plant_instance *plant, double start_s, bool stop_defined, double stop_s) {
    if (!isfinite(start_s)) {
        return plant_fail(plant, "start time %g s; expected a finite number", start_s);
    }
    if (stop_defined && !(isfinite(stop_s) && stop_s >= start_s)) {
        return plant_fail(plant, "stop time %g s; expected the start time %g s or later", stop_s, start_s);
    }
    plant->now.experiment_defined = true;
    plant->now.time_s = start_s;
    plant->now.stop_defined = stop_defined;
    plant->now.stop_s = stop_defined ? stop_s : 0.0;
    return true;
}

bool plant_enter_initialization(plant_instance *plant) {
    if (!plant->now.experiment_defined) {
        return plant_fail(plant, "enterInitializationMode: setupExperiment must come first");
    }
    plant->now.mode = PLANT_INITIALIZATION;
    return true;
}

bool plant_exit_initialization(plant_instance *plant) {
    if (!physics_start(plant)) {
        return false;
    }
    plant->now.outputs_stale = true;
    plant->now.mode = PLANT_STEP_COMPLETE;
    return true;
}

bool plant_terminate(plant_instance *plant) {
    plant->now.mode = PLANT_TERMINATED;
    return true;
}

static const variable *find(plant_instance *plant, unsigned types, unsigned reference, const char *call) {
    if (reference >= MECANUM_VARIABLE_COUNT || ((unsigned)VARIABLES[reference].type & types) == 0) {
        plant_fail(plant, "%s: no variable of this type has the value reference %u", call, reference);
        return NULL;
    }
    return &VARIABLES[reference];
}

static bool refresh_outputs(plant_instance *plant) {
    if (!plant->now.outputs_stale) {
        return true;
    }
    /* Until initialization ends the parameters may change, and the start with them. */
    if (plant->now.mode == PLANT_INITIALIZATION && !physics_start(plant)) {
        return false;
    }
    plant->now.outputs_stale = false;
    return physics_output(plant);
}

bool plant_get(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               void *values) {
    const size_t size = types == PLANT_REAL ? sizeof(double) : sizeof(int32_t);
    const bool initialized = plant->now.mode != PLANT_INSTANTIATED;
    if (initialized && !refresh_outputs(plant)) {
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        const variable *const v = find(plant, types, references[i], "get");
        if (v == NULL) {
            return false;
        }
        if (!initialized && (v->causality == OUTPUT || v->causality == INDEPENDENT)) {
            return plant_fail(plant, "get: %s has no value before initialization", v->name);
        }
        memcpy((char *)values + i * size, (const char *)&plant->now + v->offset, size);
    }
    return true;
}

/* Tells why a variable cannot be set now; NULL when it can. */
static const char *obstacle(const variable *v, plant_mode mode) {
    return v->causality == OUTPUT        ? "because it is an output"
           : v->causality == INDEPENDENT ? "because it is the independent variable"
           : v->causality == PARAMETER && mode == PLANT_STEP_COMPLETE ? "after initialization"
                                                                      : NULL;
}

static double given(unsigned types, const void *values, size_t i) {
    return types == PLANT_REAL ? ((const double *)values)[i] : (double)((const int32_t *)values)[i];
}

bool plant_may_set(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
                   const void *values) {
    for (size_t i = 0; i < count; i++) {
        const variable *const v = find(plant, types, references[i], "set");
        if (v == NULL) {
            return false;
        }
        const char *const why_not = obstacle(v, plant->now.mode);
        if (why_not != NULL) {
            return plant_fail(plant, "set: %s cannot be set %s", v->name, why_not);
        }
        const double value = given(types, values, i);
        if (!isfinite(value)) {
            return plant_discard(plant, "%s = %g; expected a finite number", v->name, value);
        }
        if (value < v->min || value > v->max) {
            return plant_discard(plant, "%s = %.10g; expected a number from %.10g to %.10g", v->name, value,
                                 v->min, v->max);
        }
    }
    return true;
}

bool plant_set(plant_instance *plant, unsigned types, const unsigned references[], size_t count,
               const void *values) {
    if (!plant_may_set(plant, types, references, count, values)) {
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        store(&plant->now, &VARIABLES[references[i]], given(types, values, i));
        plant->now.outputs_stale = true;
    }
    return true;
}

bool plant_step(plant_instance *plant, double from_s, double step_s) {
    plant_snapshot *const now = &plant->now;
    /* Room for rounding on both sides of the interface, far below any step. */
    const double tolerance_s = 1e-9 * fmax(1.0, fabs(now->time_s));
    if (!(fabs(from_s - now->time_s) <= tolerance_s)) {
        return plant_fail(plant, "doStep: from %.10g s; the instance is at %.10g s", from_s, now->time_s);
    }
    if (!(step_s > 0.0 && isfinite(step_s))) {
        return plant_fail(plant, "doStep: communication step %g s; expected a positive number", step_s);
    }
    if (now->stop_defined && from_s + step_s > now->stop_s + tolerance_s) {
        return plant_fail(plant, "doStep: to %.10g s, past the stop time %.10g s", from_s + step_s,
                          now->stop_s);
    }
    const double steps = physics_internal_steps(plant, step_s);
    if (steps > MOST_INTERNAL_STEPS) {
        return plant_discard_extreme(
            plant,
            "doStep: a communication step of %g s needs %.0f internal steps; expected at most "
            "%.0f, take shorter ones, or look at the inertias, stiffness and inductance",
            step_s, steps, MOST_INTERNAL_STEPS);
    }
    if (!physics_advance(plant, step_s, steps)) {
        return false;
    }
    now->time_s = from_s + step_s; /* the importer's time, which it does not accumulate */
    now->outputs_stale = true;
    return true;
}
