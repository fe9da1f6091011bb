#include "windows.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

/* Keeps the FMU's own words, or says which call failed and how; returns whether the call ended the run. */
static int ends(cosim *c, int status, const char *call) {
    if (status <= COSIM_WARNING) {
        return 0;
    }
    c->failed = 1;
    c->fatal = status == COSIM_FATAL;
    if (c->text[0] == '\0') {
        snprintf(c->text, sizeof c->text, "the FMU failed to %s (status %d, %s) and did not say why", call,
                 status, cosim_status_name(status));
    }
    return 1;
}

static int reset(cosim *c, const cosim_windows *w) {
    c->failed = 0;
    c->text[0] = '\0';
    c->text_status = 0;
    if (ends(c, ((int (*)(void *))w->reset)(c->component), "reset")) {
        return 1;
    }
    if (w->setup_experiment == NULL) {
        return 0;
    }
    int (*const setup)(void *, int, double, double, int, double) =
        (int (*)(void *, int, double, double, int, double))w->setup_experiment;
    return ends(c, setup(c->component, 0, 0.0, 0.0, 0, 0.0), "set up the experiment");
}

static int set_start(cosim *c, const cosim_windows *w, const double *start) {
    for (const cosim_setting *s = w->setting; s < w->setting + w->settings; s++) {
        const int status = c->fmi_version == 2
                               ? ((int (*)(void *, const unsigned *, size_t, const void *))s->call)(
                                     c->component, s->reference, s->references, s->value)
                               : ((int (*)(void *, const unsigned *, size_t, const void *, size_t))s->call)(
                                     c->component, s->reference, s->references, s->value, s->references);
        if (ends(c, status, "take its start values")) {
            return 1;
        }
    }
    for (size_t i = 0; i < w->varieds; i++) {
        if (ends(c, cosim_put(c, &w->varied[i], start[i]), "take a start value of this case")) {
            return 1;
        }
    }
    return 0;
}

static int initialise(cosim *c, const cosim_windows *w) {
    const int entered = c->fmi_version == 2
                            ? ((int (*)(void *))w->enter_initialization)(c->component)
                            : ((int (*)(void *, bool, double, double, bool, double))w->enter_initialization)(
                                  c->component, false, 0.0, 0.0, false, 0.0);
    if (ends(c, entered, "enter its initialization mode")) {
        return 1;
    }
    return ends(c, ((int (*)(void *))w->exit_initialization)(c->component),
                "leave its initialization mode") ||
           cosim_start(c) != 0;
}

static double *keep(const cosim *c, const cosim_windows *w, double *place) {
    for (size_t i = 0; i < w->outputs; i++) {
        *place++ = c->signal[w->output[i]];
    }
    return place;
}

static int run_case(cosim *c, const cosim_windows *w, size_t number) {
    const float *torque_n_m = w->torque_n_m + w->window[number] * w->rows * 4;
    double *place = w->result + number * (w->rows + 1) * w->outputs;
    if (reset(c, w) != 0 || set_start(c, w, w->start + number * w->varieds) != 0 || initialise(c, w) != 0) {
        return 1;
    }
    place = keep(c, w, place);
    for (size_t row = 0; row < w->rows; row++, torque_n_m += 4) {
        if (cosim_run(c, torque_n_m, 1) != 0) {
            return 1;
        }
        place = keep(c, w, place);
    }
    return 0;
}

int cosim_run_windows(cosim *c, cosim_windows *w) {
    for (size_t i = 0; i < w->cases; i++) {
        if (run_case(c, w, i) != 0) {
            w->failed_case = i;
            return 1;
        }
    }
    return 0;
}
