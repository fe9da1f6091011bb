#include "cosim.h"

#include "derive.h"

#include <math.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

enum { FMI2_TERMINATED = 3 }; /* fmi2StatusKind */

static const double TIME_TOLERANCE = 1e-9; /* relative, at least to 1 s: an FMU may accumulate its time */
static const double INPUT_ROUNDING = 1e-6; /* relative, of single precision */
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

/* Of a whole number of nanoseconds, never accumulated: the division rounds once. */
static double seconds(uint64_t ns) {
    return (double)ns / 1e9;
}

/* Calls a setter or getter of the FMU as what it is. FMI 3.0 says the number of values too. */
#define CALL(c, g, TYPE)                                                                                     \
    ((c)->fmi_version == 2 ? ((int (*)(void *, const unsigned *, size_t, TYPE *))(g)->call)(                 \
                                 (c)->component, (g)->reference, (g)->references, (g)->value)                \
                           : ((int (*)(void *, const unsigned *, size_t, TYPE *, size_t))(g)->call)(         \
                                 (c)->component, (g)->reference, (g)->references, (g)->value, (g)->values))

/* An FMU need not refuse what its model was not made for. */
static int check_inputs(cosim *c) {
    for (size_t i = 0; c->is_bounded && i < COSIM_INPUTS; i++) {
        const double value = c->input_value[i], low = c->low[i], high = c->high[i];
        if (value < low - INPUT_ROUNDING * fabs(low) || value > high + INPUT_ROUNDING * fabs(high)) {
            return fail(c, "%s is %.7g; the range that the FMU declares for it is %.7g to %.7g",
                        c->input_name[i], value, low, high);
        }
    }
    return 0;
}

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

static int step2(cosim *c, uint64_t from_ns) {
    int (*const do_step)(void *, double, double, int) = (int (*)(void *, double, double, int))c->do_step;
    const int status = do_step(c->component, seconds(from_ns), seconds(c->step_ns), 1);
    if (status == COSIM_DISCARD) {
        int (*const get)(void *, int, int *) = (int (*)(void *, int, int *))c->get_boolean_status;
        int terminated = 0;
        if (get(c->component, FMI2_TERMINATED, &terminated) <= COSIM_WARNING && terminated) {
            return fail(c, "the FMU asked to end the simulation");
        }
    }
    return status > COSIM_WARNING ? refused(c, status, "failed to step") : 0;
}

/* Neither event mode nor early return was agreed on, so the FMU has to reach the end of the step. */
static int step3(cosim *c, uint64_t from_ns) {
    int (*const do_step)(void *, double, double, bool, bool *, bool *, bool *, double *) =
        (int (*)(void *, double, double, bool, bool *, bool *, bool *, double *))c->do_step;
    const double from_s = seconds(from_ns), to_s = seconds(from_ns + c->step_ns);
    bool needs_event_mode = false, terminate = false, early = false;
    double reached_s = to_s; /* where the FMU leaves it alone */
    const int status = do_step(c->component, from_s, seconds(c->step_ns), true, &needs_event_mode, &terminate,
                               &early, &reached_s);
    if (status > COSIM_WARNING) {
        return refused(c, status, "failed to step");
    }
    if (terminate) {
        return fail(c, "the FMU asked to end the simulation");
    }
    if (!(fabs(reached_s - to_s) <= TIME_TOLERANCE * (to_s > 1.0 ? to_s : 1.0))) {
        return fail(c, "the FMU was stepped from %.10g to %.10g s and %s %.10g s", from_s, to_s,
                    early ? "returned early at" : "says that it reached", reached_s);
    }
    return needs_event_mode ? fail(c, "the FMU asked for event mode, which was not agreed on") : 0;
}

/* Steps until the drive that is held may change. */
static int step(cosim *c) {
    const uint64_t held_ns = c->step_ns > c->tick_ns ? c->step_ns : c->tick_ns;
    const uint64_t begin_ns = c->ticks * c->tick_ns, end_ns = begin_ns + held_ns;
    for (uint64_t at_ns = begin_ns; at_ns < end_ns; at_ns += c->step_ns) {
        if ((c->fmi_version == 2 ? step2(c, at_ns) : step3(c, at_ns)) != 0) {
            return 1;
        }
    }
    return 0;
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
    return 0;
}

static void show(cosim *c) {
    memcpy(c->signal, c->fresh, sizeof c->signal);
}

/* Takes the drive, and goes to the end of the step that begins in this tick. */
static int begin_step(cosim *c, const wheel_drive *drive) {
    for (int i = 0; i < 4; i++) {
        const int wheel = c->wheel_of_channel[i];
        const int sign = c->sign_of_channel[i];
        c->input_value[COSIM_TORQUE + wheel] = sign * (double)drive->torque_n_m[i];
        c->input_value[COSIM_DUTY + wheel] = sign * (double)drive->duty[i];
    }
    c->input_value[COSIM_ENABLED] = drive->enabled != 0 ? 1.0 : 0.0;
    return check_inputs(c) != 0 || write_inputs(c) != 0 || step(c) != 0 || sample(c, true) != 0;
}

static bool is_between_steps(const cosim *c) {
    return c->ticks * c->tick_ns % c->step_ns == 0;
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
    c->ticks = 0;
    c->time_ns = 0;
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
    if (sample(c, false) != 0) {
        return 1;
    }
    show(c);
    return 0;
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
        if (is_between_steps(c) && begin_step(c, drive) != 0) {
            return 1;
        }
        c->time_ns = ++c->ticks * c->tick_ns;
        if (is_between_steps(c)) {
            show(c);
        }
    }
    /* What holds after tick n is what tick n + 1 samples at its beginning. */
    sense->tick = drive != NULL ? drive->tick + 1 : (uint32_t)c->ticks;
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
        wheel_drive drive = {.tick = (uint32_t)c->ticks, .enabled = 1};
        memcpy(drive.torque_n_m, torque_n_m, sizeof drive.torque_n_m);
        if (cosim_exchange(c, &drive, &sense) != 0) {
            return 1;
        }
    }
    return 0;
}
