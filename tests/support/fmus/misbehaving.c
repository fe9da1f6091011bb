/* The shipped plant with a flaw: linked in front of its own sources, whose functions of these names are
 * renamed on the compiler's command line. FLAW in the environment says what goes wrong, and how long after
 * the first torque: "hang 1.5"; before 0, as soon as it is instantiated. "start 24" crashes at the first
 * torque if some variable starts with 24; "forgetful 0" is another FMU after a reset. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifndef _WIN32
#include <unistd.h>
#endif

#ifdef _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

void *sound_fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                            const void *functions, int visible, int logging);
int sound_fmi2Reset(void *c);
int sound_fmi2SetReal(void *c, const unsigned references[], size_t count, const double values[]);
int sound_fmi2DoStep(void *c, double from_s, double step_s, int no_return);
int sound_fmi2GetReal(void *c, const unsigned references[], size_t count, double values[]);

/* One instance a process. */
static int initialised, driven, spoilt, doomed, resets;
static double first_torque_s;

static int has(const char *flaw, double after_s) {
    char name[32] = "";
    double due_s = 0.0;
    const char *const text = getenv("FLAW");
    return text != NULL && sscanf(text, "%31s %lf", name, &due_s) == 2 && strcmp(name, flaw) == 0 &&
           after_s >= due_s - 1e-9;
}

static void crash(double after_s) {
    if (has("segfault", after_s) || doomed) {
        printf("the last words of a crash\n");
        *(volatile int *)NULL = 1;
    }
#ifndef _WIN32
    if (has("fork", after_s) && fork() == 0) {
        pause(); /* it holds the pipes open */
    }
    for (int end = 3; has("write", after_s) && end < 64; end++) {
        char bytes[2048];
        memset(bytes, '\033', sizeof bytes);
        (void)!write(end, bytes, sizeof bytes);
    }
#endif
    if (has("abort", after_s) || has("fork", after_s)) {
        abort();
    }
    if (has("exit", after_s)) {
        exit(0);
    }
    while (has("hang", after_s)) {
    }
}

#undef fmi2Instantiate
#undef fmi2Reset
#undef fmi2SetReal
#undef fmi2DoStep
#undef fmi2GetReal

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const void *functions, int visible, int logging);
EXPORT int fmi2Reset(void *c);
EXPORT int fmi2SetReal(void *c, const unsigned references[], size_t count, const double values[]);
EXPORT int fmi2DoStep(void *c, double from_s, double step_s, int no_return);
EXPORT int fmi2GetReal(void *c, const unsigned references[], size_t count, double values[]);

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                      const void *functions, int visible, int logging) {
    crash(-1.0);
    if (has("no_instance", -1.0)) {
        return NULL;
    }
    return sound_fmi2Instantiate(name, type, guid, resources, functions, visible, logging);
}

int fmi2Reset(void *c) {
    initialised = driven = spoilt = doomed = 0;
    resets++;
    return sound_fmi2Reset(c);
}

int fmi2SetReal(void *c, const unsigned references[], size_t count, const double values[]) {
    for (size_t i = 0; initialised && i < count; i++) {
        driven = driven || values[i] != 0.0;
    }
    for (size_t i = 0; !initialised && i < count; i++) {
        doomed = doomed || (has("start", values[i]) && !has("start", values[i] - 0.01));
    }
    return sound_fmi2SetReal(c, references, count, values);
}

int fmi2DoStep(void *c, double from_s, double step_s, int no_return) {
    if (!driven) {
        first_torque_s = from_s;
        return sound_fmi2DoStep(c, from_s, step_s, no_return);
    }
    const double after_s = from_s - first_torque_s;
    crash(after_s);
    if (has("error", after_s)) {
        /* The sound FMU's own words: it refuses a step that goes back in time. */
        return sound_fmi2DoStep(c, from_s, -step_s, no_return);
    }
    if (has("print", after_s)) {
        for (int i = 0; i < 100; i++) {
            printf("%f s: all is well, and this line is there to fill the pipe of whoever reads it\n",
                   from_s);
        }
    }
    if (has("hog", after_s)) {
        char *const taken = malloc(50000000);
        for (size_t i = 0; taken != NULL && i < 50000000; i += 1000) {
            ((volatile char *)taken)[i] = 1;
        }
    }
    spoilt = has("nan", after_s);
    return sound_fmi2DoStep(c, from_s, step_s, no_return);
}

int fmi2GetReal(void *c, const unsigned references[], size_t count, double values[]) {
    const int status = sound_fmi2GetReal(c, references, count, values);
    initialised = 1; /* what is set before is the start */
    if (spoilt && count > 0) {
        values[0] = NAN;
    }
    for (size_t i = 0; resets > 0 && has("forgetful", 0.0) && i < count; i++) {
        values[i] *= 1.01;
    }
    return status;
}
