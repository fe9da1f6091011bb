#include "lag.h"

#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#ifndef _WIN32
#include <unistd.h>
#endif

const volatile lag_break lag_breaks = {"lag breaks:", NO_FAULT};

static double shared_x; /* for SHARED_STATE */

#ifndef _WIN32
__attribute__((constructor)) static void load(void) {
    if (BROKEN(CRASH_WHEN_LOADED)) {
        abort();
    }
}
#endif

const char *lag_version(const char *right) {
    if (BROKEN(CRASH_IN_GET_VERSION)) {
        abort();
    }
    return BROKEN(WRONG_VERSION) ? "1.9" : right;
}

static double *x_of(lag *m) {
    return BROKEN(SHARED_STATE) ? &shared_x : &m->now.x;
}

static void start(lag *m) {
    const lag_state old = m->now;
    m->now = (lag_state){
        .mode = INSTANTIATED, .stale = true, .shape = LINEAR, .gain = BROKEN(WRONG_START) ? 3.0 : 2.0};
    m->now.gain += BROKEN(ROUNDED_START) ? 4.4e-16 : 0.0;
    *x_of(m) = 0.0;
    if (old.mode != 0 && BROKEN(RESET_KEEPS_STATE)) {
        m->now.x = old.x;
    }
    if (old.mode != 0 && BROKEN(RESET_KEEPS_INPUT)) {
        m->now.input = old.input;
    }
}

lag *lag_new(void *environment, void *logger) {
    static bool is_registered;
    if (BROKEN(CRASH_AT_THE_END) && !is_registered) {
        is_registered = atexit(abort) == 0;
    }
    lag *const m = BROKEN(NO_INSTANCE) ? NULL : calloc(1, sizeof *m);
    if (m != NULL) {
        m->environment = environment;
        m->logger = logger;
        start(m);
    }
    return m;
}

bool lag_logs(size_t categories) {
    return categories <= 1 && !BROKEN(NO_DEBUG_LOGGING);
}

void lag_free(lag *m) {
    if (BROKEN(FATAL_IN_STEP)) {
        abort();
    }
    free(m);
}

void lag_reset(lag *m) {
    start(m);
}

bool lag_fail(lag *m) {
    m->now.mode = FAILED;
    return false;
}

bool lag_legal(lag *m, unsigned modes) {
    return ((unsigned)m->now.mode & modes) != 0 || lag_fail(m);
}

bool lag_enter(lag *m, double start_s) {
    if (!lag_legal(m, INSTANTIATED)) {
        return false;
    }
    m->now.time_s = start_s;
    m->now.mode = INITIALIZATION;
    return true;
}

bool lag_exit(lag *m) {
    if (!lag_legal(m, INITIALIZATION)) {
        return false;
    }
    m->now.mode = STEP_MODE;
    m->now.stale = true;
    return true;
}

bool lag_terminate(lag *m) {
    if (!lag_legal(m, STEP_MODE)) {
        return false;
    }
    m->now.mode = TERMINATED;
    return true;
}

static double shaped(const lag *m) {
    const double u = m->now.input;
    return m->now.shape == LINEAR ? u : u * fabs(u);
}

static void refresh(lag *m) {
    if (m->now.stale) {
        m->now.output = *x_of(m) + m->now.gain * shaped(m);
        m->now.stale = false;
    }
}

static bool readable(lag *m) {
    const unsigned modes = INITIALIZATION | STEP_MODE | FAILED;
    return lag_legal(m, BROKEN(SILENT_AFTER_TERMINATE) ? modes : modes | TERMINATED);
}

bool lag_get_float(lag *m, unsigned reference, double *value) {
    if (!readable(m)) {
        return false;
    }
    refresh(m);
    switch (reference) {
    case TIME:
        *value = m->now.time_s - (BROKEN(LATE_CLOCK) ? LAG_STEP_S : 0.0);
        return true;
    case INPUT:
        *value = m->now.input;
        return true;
    case GAIN:
        *value = m->now.gain;
        return true;
    case OUTPUT:
        *value = BROKEN(NOT_A_NUMBER) && m->now.time_s > 0.5 + 10.5 * LAG_STEP_S ? NAN : m->now.output;
        return true;
    default:
        *value = 0.0;
        return lag_fail(m);
    }
}

bool lag_set_float(lag *m, unsigned reference, double value) {
    if (!lag_legal(m, INSTANTIATED | INITIALIZATION | STEP_MODE)) {
        return false;
    }
    if (reference == INPUT) {
        m->now.input = BROKEN(LOST_INPUT) ? 0.5 * value : value;
        m->now.stale = !(BROKEN(STALE_OUTPUT) && m->now.mode == INITIALIZATION && !m->now.stale);
        return true;
    }
    if (reference == GAIN && m->now.mode != STEP_MODE) {
        m->now.gain = value;
        m->now.stale = true;
        return value >= 0.5 && value <= 5.0 ? true : lag_fail(m);
    }
    return lag_fail(m);
}

bool lag_get_integer(lag *m, unsigned reference, int *value) {
    if (!readable(m)) {
        return false;
    }
    *value = reference == SHAPE ? m->now.shape : (int)floor(1000.0 * *x_of(m));
    return reference == SHAPE || reference == COUNT || lag_fail(m);
}

bool lag_set_integer(lag *m, unsigned reference, int value) {
    if (!lag_legal(m, INSTANTIATED | INITIALIZATION) || reference != SHAPE) {
        return lag_fail(m);
    }
    if (value != LINEAR && value != SQUARED) {
        return lag_fail(m);
    }
    m->now.shape = value;
    m->now.stale = true;
    return true;
}

bool lag_discards(const lag *m, double size_s) {
    return m->now.mode == STEP_MODE &&
           (BROKEN(DISCARDED_STEPS) || (BROKEN(DISCARDED_STEP) && fabs(size_s - 3.0 * LAG_STEP_S) < 1e-9));
}

bool lag_step(lag *m, double size_s) {
    if (!lag_legal(m, STEP_MODE) || BROKEN(ERROR_IN_STEP) || BROKEN(FATAL_IN_STEP)) {
        return lag_fail(m);
    }
    if (BROKEN(CHATTY_CRASH)) {
        for (int i = 0; i < 100000; i++) {
            puts("an FMU that prints more than a pipe holds");
        }
        puts("the last word");
        fflush(stdout);
    }
    if (BROKEN(RUDE_CRASH)) {
        puts("\033[31mred\a \302\2332J");
    }
#ifndef _WIN32
    if (BROKEN(FORKED_CRASH)) {
        if (fork() == 0) {
            pause(); /* it holds the pipes open */
        }
        abort();
    }
    for (int pipe_end = 3; BROKEN(BYTES_IN_PIPES) && pipe_end < 64; pipe_end++) {
        const char bytes[] = "\033[31mno record\n";
        (void)!write(pipe_end, bytes, sizeof bytes - 1);
    }
#endif
    if (BROKEN(CRASH_IN_STEP) || BROKEN(CHATTY_CRASH) || BROKEN(RUDE_CRASH)) {
        abort();
    }
    if (BROKEN(REAL_TIME_SIGNAL)) {
        raise(40);
    }
    if (BROKEN(SLOW_STEP)) {
        for (const clock_t end = clock() + CLOCKS_PER_SEC / 128; clock() < end;) {
        }
    }
    if (BROKEN(EXIT_IN_STEP)) {
        exit(0);
    }
    if (BROKEN(HANG_IN_STEP)) {
        FILE *const hanging = fopen("hanging", "w"); /* a test waits for it */
        if (hanging != NULL) {
            fclose(hanging);
        }
    }
    for (volatile bool wait = BROKEN(HANG_IN_STEP); wait;) {
    }
    if (!(size_s > 0.0)) {
        return lag_fail(m);
    }
    if (BROKEN(REFUSED_STEP) && fabs(size_s - LAG_STEP_S) > 1e-9 && size_s > 0.0) {
        return lag_fail(m);
    }
    const double inner_s = BROKEN(FIXED_STEP) ? LAG_STEP_S : size_s;
    *x_of(m) += inner_s * (m->now.gain * shaped(m) - *x_of(m));
    m->now.time_s += size_s;
    m->now.stale = true;
    return true;
}

bool lag_save(lag *m, void **state) {
    if (BROKEN(STATE_REFUSED)) {
        return lag_fail(m);
    }
    const bool reuse = *state != NULL;
    if (!reuse) {
        *state = malloc(sizeof m->now);
    }
    if (*state == NULL) {
        return lag_fail(m);
    }
    m->now.x = *x_of(m);
    memcpy(*state, &m->now, sizeof m->now);
    if (reuse && BROKEN(STATE_NOT_REUSED)) {
        ((lag_state *)*state)->x = 0.0;
    }
    return true;
}

bool lag_restore(lag *m, const void *state) {
    const double x = m->now.x;
    memcpy(&m->now, state, sizeof m->now);
    *x_of(m) = BROKEN(STATE_LOST) ? x : m->now.x;
    m->now.stale = true;
    return true;
}

size_t lag_size(void) {
    return sizeof(lag_state);
}

void lag_to_bytes(const void *state, char *bytes) {
    memcpy(bytes, state, sizeof(lag_state));
    if (BROKEN(BYTES_TOO_LONG)) {
        bytes[sizeof(lag_state)] = 0;
    }
}

bool lag_from_bytes(lag *m, const char *bytes, size_t size, void **state) {
    lag_state read;
    if (size != sizeof read || !lag_save(m, state)) {
        return lag_fail(m);
    }
    memcpy(&read, bytes, sizeof read);
    if (BROKEN(BYTES_LOST)) {
        read.x = 0.0;
    }
    memcpy(*state, &read, sizeof read);
    return true;
}
