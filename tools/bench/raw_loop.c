#include "raw_loop.h"

#include <stdbool.h>
#include <stdint.h>

static int run2(const raw_loop *l, unsigned long steps) {
    int (*const set_real)(void *, const unsigned *, size_t, const double *) =
        (int (*)(void *, const unsigned *, size_t, const double *))l->set_real;
    int (*const get_real)(void *, const unsigned *, size_t, double *) =
        (int (*)(void *, const unsigned *, size_t, double *))l->get_real;
    int (*const get_integer)(void *, const unsigned *, size_t, int *) =
        (int (*)(void *, const unsigned *, size_t, int *))l->get_integer;
    int (*const do_step)(void *, double, double, int) = (int (*)(void *, double, double, int))l->do_step;
    double real[32];
    int integer[32];
    const double step_s = (double)l->step_ms / 1e3;
    int worst = 0;
    for (unsigned long n = 0; n < steps; n++) {
        worst |= set_real(l->component, l->input, l->inputs, l->value);
        worst |= do_step(l->component, (double)(n * l->step_ms) * 1e6 / 1e9, step_s, 1);
        worst |= get_real(l->component, l->real, l->reals, real);
        worst |= get_integer(l->component, l->integer, l->integers, integer);
    }
    return worst;
}

static int run3(const raw_loop *l, unsigned long steps) {
    int (*const set_real)(void *, const unsigned *, size_t, const double *, size_t) =
        (int (*)(void *, const unsigned *, size_t, const double *, size_t))l->set_real;
    int (*const get_real)(void *, const unsigned *, size_t, double *, size_t) =
        (int (*)(void *, const unsigned *, size_t, double *, size_t))l->get_real;
    int (*const get_integer)(void *, const unsigned *, size_t, int32_t *, size_t) =
        (int (*)(void *, const unsigned *, size_t, int32_t *, size_t))l->get_integer;
    int (*const do_step)(void *, double, double, bool, bool *, bool *, bool *, double *) =
        (int (*)(void *, double, double, bool, bool *, bool *, bool *, double *))l->do_step;
    double real[32], reached_s;
    int32_t integer[32];
    bool event, terminate, early;
    const double step_s = (double)l->step_ms / 1e3;
    int worst = 0;
    for (unsigned long n = 0; n < steps; n++) {
        worst |= set_real(l->component, l->input, l->inputs, l->value, l->inputs);
        worst |= do_step(l->component, (double)(n * l->step_ms) * 1e6 / 1e9, step_s, true, &event, &terminate,
                         &early, &reached_s);
        worst |= get_real(l->component, l->real, l->reals, real, l->reals);
        worst |= get_integer(l->component, l->integer, l->integers, integer, l->integers);
    }
    return worst;
}

int raw_run(const raw_loop *loop, unsigned long steps) {
    return loop->fmi_version == 2 ? run2(loop, steps) : run3(loop, steps);
}
