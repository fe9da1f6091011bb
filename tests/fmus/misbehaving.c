/* The shipped plant with a flaw: linked in front of its own sources, whose functions of these names are
 * renamed on the compiler's command line. FLAW in the environment says what goes wrong, and how long after
 * the first torque: "hang 1.5"; before 0, as soon as it is instantiated. */
#include "fmi2.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

fmi2Component sound_fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                    const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                    fmi2Boolean logging);
fmi2Status sound_fmi2Reset(fmi2Component c);
fmi2Status sound_fmi2DoStep(fmi2Component c, fmi2Real from_s, fmi2Real step_s, fmi2Boolean no_return);
fmi2Status sound_fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count,
                             fmi2Real values[]);
fmi2Status sound_fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t count,
                             const fmi2Real values[]);

/* One instance a process. */
static int initialised, driven, spoilt;
static double first_torque_s;

static int has(const char *flaw, double after_s) {
    char name[32] = "";
    double due_s = 0.0;
    const char *const text = getenv("FLAW");
    return text != NULL && sscanf(text, "%31s %lf", name, &due_s) == 2 && strcmp(name, flaw) == 0 &&
           after_s >= due_s - 1e-9;
}

static void crash(double after_s) {
    if (has("segfault", after_s)) {
        printf("the last words of a crash\n");
        *(volatile int *)NULL = 1;
    }
    if (has("abort", after_s)) {
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
#undef fmi2DoStep
#undef fmi2GetReal
#undef fmi2SetReal

FMI2(fmi2Component, fmi2Instantiate, fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
     const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    crash(-1.0);
    return sound_fmi2Instantiate(name, type, guid, resources, functions, visible, logging);
}

FMI2(fmi2Status, fmi2Reset, fmi2Component c) {
    initialised = driven = spoilt = 0;
    return sound_fmi2Reset(c);
}

FMI2(fmi2Status, fmi2SetReal, fmi2Component c, const fmi2ValueReference references[], size_t count,
     const fmi2Real values[]) {
    for (size_t i = 0; initialised && i < count; i++) {
        driven = driven || values[i] != 0.0;
    }
    return sound_fmi2SetReal(c, references, count, values);
}

FMI2(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real from_s, fmi2Real step_s, fmi2Boolean no_return) {
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
    spoilt = has("nan", after_s);
    return sound_fmi2DoStep(c, from_s, step_s, no_return);
}

FMI2(fmi2Status, fmi2GetReal, fmi2Component c, const fmi2ValueReference references[], size_t count,
     fmi2Real values[]) {
    const fmi2Status status = sound_fmi2GetReal(c, references, count, values);
    initialised = 1; /* what is set before is the start */
    if (spoilt && count > 0) {
        values[0] = NAN;
    }
    return status;
}
