#include "cosim.h"

#include "derive.h"

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

enum { FMI2_TERMINATED = 3 };       /* fmi2StatusKind */
enum { MOST_EARLY_RETURNS = 1000 }; /* within one tick */

static const double LARGEST_COUNT = 9007199254740992.0; /* 2^53: a double tells no further counts apart */

/* Keeps our own reason, and the FMU's words with it. */
static int fail(cosim *c, const char *format, ...) {
    char words[sizeof c->text];
    memcpy(words, c->text, sizeof words);
    va_list arguments;
    va_start(arguments, format);
    int length = vsnprintf(c->text, sizeof c->text, format, arguments);
    va_end(arguments);
    if (words[0] != '\0' && length >= 0 && (size_t)length < sizeof c->text) {
        snprintf(c->text + length, sizeof c->text - (size_t)length, "; the FMU said: %.200s", words);
    }
    c->failed = 1;
    return 1;
}

/* A call returned a status that ends the run. The FMU's own words, when it gave some, are the reason. */
static int refused(cosim *c, int status, const char *what) {
    c->failed = 1;
    c->fatal = status == COSIM_FATAL;
    if (c->text[0] == '\0') {
        snprintf(c->text, sizeof c->text, "the FMU %s (status %d, %s) and did not say why", what, status,
                 cosim_status_name(status));
    }
    return 1;
}

static double step_s(const cosim *c) {
    return (double)c->step_ns / 1e9;
}

/* start + n step, never accumulated; the division rounds once, the product not at all. */
static double time_s(const cosim *c, uint64_t steps) {
    return (double)(steps * c->step_ns) / 1e9;
}

/* Calls a setter or getter of the FMU as what it is. FMI 3.0 says the number of values too. */
#define CALL(c, g, TYPE)                                                                                     \
    ((c)->fmi_version == 2 ? ((int (*)(void *, const unsigned *, size_t, TYPE *))(g)->call)(                 \
                                 (c)->component, (g)->reference, (g)->references, (g)->value)                \
                           : ((int (*)(void *, const unsigned *, size_t, TYPE *, size_t))(g)->call)(         \
                                 (c)->component, (g)->reference, (g)->references, (g)->value, (g)->values))

/* An input is given to the FMU so that factor * FMU value + offset is the bridge's value. */
static int write_inputs(cosim *c) {
    for (const cosim_group *g = c->input; g < c->input + c->inputs; g++) {
        const cosim_row *const end = g->is_in_place ? g->row : g->row + g->rows;
        int status;
        if (g->type == COSIM_FLOAT64) {
            double *const value = g->value;
            for (const cosim_row *row = g->row; row < end; row++) {
                value[row->place] = (c->input_value[row->signal] - row->offset) / row->factor;
            }
            status = CALL(c, g, const double);
        } else {
            float *const value = g->value;
            for (const cosim_row *row = g->row; row < end; row++) {
                value[row->place] = (float)((c->input_value[row->signal] - row->offset) / row->factor);
            }
            status = CALL(c, g, const float);
        }
        if (status > COSIM_WARNING) {
            return refused(c, status, "refused what drives the wheels");
        }
    }
    return 0;
}

#define READ(KIND, TYPE)                                                                                     \
    case KIND: {                                                                                             \
        const TYPE *const value = g->value;                                                                  \
        const int status = CALL(c, g, TYPE);                                                                 \
        for (const cosim_row *row = g->row; row < g->row + g->rows; row++) {                                 \
            c->fresh[row->signal] = (double)value[row->place];                                               \
        }                                                                                                    \
        return status;                                                                                       \
    }

/* Gets the values of a group into `fresh` and returns the status. */
static int read_group(cosim *c, const cosim_group *g) {
    if (g->is_in_place) {
        return CALL(c, g, double);
    }
    switch (g->type) {
        READ(COSIM_FLOAT64, double)
        READ(COSIM_FLOAT32, float)
        READ(COSIM_INT8, int8_t)
        READ(COSIM_UINT8, uint8_t)
        READ(COSIM_INT16, int16_t)
        READ(COSIM_UINT16, uint16_t)
        READ(COSIM_INT32, int32_t)
        READ(COSIM_UINT32, uint32_t)
        READ(COSIM_INT64, int64_t)
        READ(COSIM_UINT64, uint64_t)
    }
    return COSIM_FATAL; /* there is no further type */
}

static int read_outputs(cosim *c) {
    double *const fresh = c->fresh;
    for (const cosim_group *g = c->output; g < c->output + c->outputs; g++) {
        const int status = read_group(c, g);
        if (status > COSIM_WARNING) {
            return refused(c, status, "refused to give its outputs");
        }
        if (!g->is_identity) {
            for (const cosim_row *row = g->row; row < g->row + g->rows; row++) {
                fresh[row->signal] = row->factor * fresh[row->signal] + row->offset;
            }
        }
    }
    return 0;
}

static int step2(cosim *c, double from_s) {
    int (*const do_step)(void *, double, double, int) = (int (*)(void *, double, double, int))c->do_step;
    const int status = do_step(c->component, from_s, step_s(c), 1);
    if (status == COSIM_DISCARD) {
        int (*const get)(void *, int, int *) = (int (*)(void *, int, int *))c->get_boolean_status;
        int terminated = 0;
        if (get(c->component, FMI2_TERMINATED, &terminated) <= COSIM_WARNING && terminated) {
            return fail(c, "the FMU asked to end the simulation");
        }
    }
    return status > COSIM_WARNING ? refused(c, status, "failed to step") : 0;
}

/* An FMU that returns early is stepped on from where it got to: the tick ends where all ticks end. */
static int step3(cosim *c, double from_s) {
    int (*const do_step)(void *, double, double, bool, bool *, bool *, bool *, double *) =
        (int (*)(void *, double, double, bool, bool *, bool *, bool *, double *))c->do_step;
    const double to_s = time_s(c, c->steps + 1);
    double at_s = from_s, length_s = step_s(c);
    for (int i = 0; i < MOST_EARLY_RETURNS; i++) {
        bool event_handling_needed = false, terminate = false, early = false;
        double reached_s = at_s;
        const int status = do_step(c->component, at_s, length_s, true, &event_handling_needed, &terminate,
                                   &early, &reached_s);
        if (status > COSIM_WARNING) {
            return refused(c, status, "failed to step");
        }
        if (terminate) {
            return fail(c, "the FMU asked to end the simulation");
        }
        if (!early || reached_s >= to_s) {
            return 0;
        }
        if (!(reached_s > at_s)) {
            return fail(c, "the FMU returned early from a step at %.10g s and got no further", at_s);
        }
        at_s = reached_s;
        length_s = to_s - at_s;
    }
    return fail(c, "the FMU returned early from a step %d times within one tick", MOST_EARLY_RETURNS);
}

static int step(cosim *c) {
    const double from_s = time_s(c, c->steps);
    if (c->solve != NULL) {
        c->failed = c->solve(from_s, time_s(c, c->steps + 1));
        return c->failed;
    }
    return c->fmi_version == 2 ? step2(c, from_s) : step3(c, from_s);
}

static int sample(cosim *c, bool passed) {
    if (read_outputs(c) != 0) {
        return 1;
    }
    cosim_unwind(c);
    if (c->derives) {
        cosim_derive(c, passed);
    }
    for (size_t i = 0; i < COSIM_SIGNALS; i++) {
        const double value = c->fresh[i];
        if (!isfinite(value)) {
            const char *const kind = isnan(value) ? "not a number" : "infinite";
            return fail(c, "%s is %s; expected a finite number", c->name[i], kind);
        }
    }
    memcpy(c->signal, c->fresh, sizeof c->signal);
    return 0;
}

/* Rounds down; past the largest count the counter stands still. */
static int64_t whole(double count) {
    if (fabs(count) > LARGEST_COUNT) {
        count = count < 0.0 ? -LARGEST_COUNT : LARGEST_COUNT;
    }
    const int64_t towards_zero = (int64_t)count;
    return towards_zero - ((double)towards_zero > count);
}

int cosim_start(cosim *c) {
    c->steps = 0;
    c->failed = 0;
    c->text[0] = '\0';
    c->text_status = 0;
    memset(c->input_value, 0, sizeof c->input_value);
    memset(c->signal, 0, sizeof c->signal);
    memset(c->fresh, 0, sizeof c->fresh);
    if (read_outputs(c) != 0) {
        return 1;
    }
    cosim_start_winding(c);
    return sample(c, false);
}

int cosim_exchange(void *context, const wheel_drive *drive, wheel_sense *sense) {
    cosim *const c = context;
    if (c->failed) {
        return 1;
    }
    c->text[0] = '\0';
    c->text_status = 0;
    if (c->component == NULL) {
        return fail(c, "the FMU is closed");
    }
    if (drive != NULL) {
        for (int i = 0; i < 4; i++) {
            const int wheel = c->wheel_of_channel[i];
            const int sign = c->sign_of_channel[i];
            c->input_value[COSIM_TORQUE + wheel] = sign * (double)drive->torque_n_m[i];
            c->input_value[COSIM_DUTY + wheel] = sign * (double)drive->duty[i];
        }
        c->input_value[COSIM_ENABLED] = drive->enabled != 0 ? 1.0 : 0.0;
        if (write_inputs(c) != 0 || step(c) != 0) {
            return 1;
        }
    }
    if (sample(c, drive != NULL) != 0) {
        return 1;
    }
    c->steps += drive != NULL;
    /* What holds after tick n is what tick n + 1 samples at its beginning. */
    sense->tick = drive != NULL ? drive->tick + 1 : (uint32_t)c->steps;
    for (int i = 0; i < 4; i++) {
        const int wheel = c->wheel_of_channel[i];
        const int sign = c->sign_of_channel[i];
        sense->count[i] = (uint16_t)(sign * whole(c->signal[COSIM_COUNT + wheel])); /* modulo 2^16 */
        sense->current_a[i] = (float)(sign * c->signal[COSIM_CURRENT + wheel]);
        sense->temperature_degc[i] = (float)c->signal[COSIM_TEMPERATURE + wheel];
    }
    for (int i = 0; i < 3; i++) {
        sense->gyro_rad_s[i] = (float)c->signal[COSIM_GYRO + i];
        sense->acceleration_m_s2[i] = (float)c->signal[COSIM_ACCELERATION + i];
    }
    sense->battery_v = (float)c->signal[COSIM_BATTERY];
    sense->battery_a = (float)c->signal[COSIM_BATTERY + 1];
    return 0;
}

int cosim_put(cosim *c, const cosim_variable *v, double value) {
    float single = (float)value;
    cosim_group one = {.call = v->call,
                       .reference = &v->reference,
                       .references = 1,
                       .value = v->type == COSIM_FLOAT64 ? (void *)&value : (void *)&single,
                       .values = 1};
    return v->type == COSIM_FLOAT64 ? CALL(c, &one, const double) : CALL(c, &one, const float);
}

int cosim_set(void *context, size_t place, double value) {
    cosim *const c = context;
    if (c->failed) {
        return 1;
    }
    if (place >= c->settables) {
        return fail(c, "there is no settable variable %zu", place);
    }
    const int status = cosim_put(c, &c->settable[place], value);
    return status > COSIM_WARNING ? refused(c, status, "refused a new value of a variable") : 0;
}

int cosim_run(void *context, const float *torque_n_m, uint32_t ticks) {
    cosim *const c = context;
    wheel_sense sense;
    for (uint32_t i = 0; i < ticks; i++) {
        wheel_drive drive = {.tick = (uint32_t)c->steps, .enabled = 1};
        memcpy(drive.torque_n_m, torque_n_m, sizeof drive.torque_n_m);
        if (cosim_exchange(c, &drive, &sense) != 0) {
            return 1;
        }
    }
    return 0;
}
