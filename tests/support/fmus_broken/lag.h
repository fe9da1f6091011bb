/* A first-order lag as a co-simulation slave of FMI 2.0 and FMI 3.0 that can be broken in one way at a time.
 *
 * x' = gain u - x, y = x + gain u. It has the fault whose number is in `lag_breaks`, and no other; see lag.c.
 */
#ifndef LAG_H
#define LAG_H

#include <stdbool.h>
#include <stddef.h>

enum {
    NO_FAULT,
    SLOW_STEP,
    ROUNDED_START,
    CRASH_WHEN_LOADED,
    CRASH_IN_GET_VERSION,
    WRONG_VERSION,
    NO_INSTANCE,
    CRASH_IN_STEP,
    CHATTY_CRASH,
    RUDE_CRASH,
    REAL_TIME_SIGNAL,
    EXIT_IN_STEP,
    HANG_IN_STEP,
    FORKED_CRASH,
    ERROR_IN_STEP,
    FATAL_IN_STEP,
    BYTES_IN_PIPES,
    NO_DEBUG_LOGGING,
    WRONG_START,
    LOST_INPUT,
    NOT_A_NUMBER,
    STALE_OUTPUT,
    LATE_CLOCK,
    WRONG_LAST_TIME,
    ENDS_SIMULATION,
    RETURNS_EARLY,
    ASKS_FOR_EVENT_MODE,
    FIXED_STEP,
    REFUSED_STEP,
    DISCARDED_STEP,
    DISCARDED_STEPS,
    STATE_REFUSED,
    STATE_LOST,
    STATE_NOT_REUSED,
    BYTES_TOO_LONG,
    BYTES_LOST,
    SILENT_AFTER_TERMINATE,
    RESET_KEEPS_STATE,
    RESET_KEEPS_INPUT,
    SHARED_STATE,
    CRASH_AT_THE_END,
};
/* tests/support/broken_fmu.py writes the number of a fault behind the mark in the compiled library: one is
 * compiled for all. */
typedef struct {
    char mark[12];
    int fault;
} lag_break;
extern const volatile lag_break lag_breaks;
#define BROKEN(number) (lag_breaks.fault == (number))

#define LAG_TOKEN "{c0ffee00-1a90-4000-8000-000000000001}"
#define LAG_STEP_S 0.01 /* the step of the default experiment */

/* Value references, the same in both versions; the vector is in FMI 3.0 alone. */
enum { TIME, INPUT, GAIN, SHAPE, OUTPUT, COUNT, VECTOR };
enum { LINEAR = 1, SQUARED = 2 };

typedef enum { INSTANTIATED = 1, INITIALIZATION = 2, STEP_MODE = 4, TERMINATED = 8, FAILED = 16 } lag_mode;

typedef struct {
    lag_mode mode;
    bool stale;
    int shape;
    double time_s, input, gain, x, output;
} lag_state;

typedef struct {
    lag_state now;
    void *environment;
    void *logger;
} lag;

const char *lag_version(const char *right);
bool lag_logs(size_t categories);
lag *lag_new(void *environment, void *logger);
void lag_free(lag *m);
void lag_reset(lag *m);

/* Tells whether a call is legal in this mode; `modes` is a mask. An error puts the instance into FAILED. */
bool lag_legal(lag *m, unsigned modes);
bool lag_fail(lag *m);

bool lag_enter(lag *m, double start_s);
bool lag_exit(lag *m);
bool lag_terminate(lag *m);

/* Reads into, or sets from, one double or one int. */
bool lag_get_float(lag *m, unsigned reference, double *value);
bool lag_set_float(lag *m, unsigned reference, double value);
bool lag_get_integer(lag *m, unsigned reference, int *value);
bool lag_set_integer(lag *m, unsigned reference, int value);

/* Tells whether a fault has this step discarded, which leaves the instance as it is. */
bool lag_discards(const lag *m, double size_s);

bool lag_step(lag *m, double size_s);

/* A saved state, and its bytes. */
bool lag_save(lag *m, void **state);
bool lag_restore(lag *m, const void *state);
size_t lag_size(void);
void lag_to_bytes(const void *state, char *bytes);
bool lag_from_bytes(lag *m, const char *bytes, size_t size, void **state);

#endif
