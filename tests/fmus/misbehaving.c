/* The shipped plant with a flaw: linked in front of its own sources, whose fmi2Instantiate and fmi2DoStep are
 * renamed on the compiler's command line. FLAW in the environment says what goes wrong and when: "hang 1.5".
 */
#include "fmi2.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

fmi2Component sound_fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                    const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                                    fmi2Boolean logging);
fmi2Status sound_fmi2DoStep(fmi2Component c, fmi2Real from_s, fmi2Real step_s, fmi2Boolean no_return);
fmi2Status sound_fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t count,
                             fmi2Real values[]);

static int spoilt; /* one instance a process */

static int has(const char *flaw, double at_s) {
    char name[32] = "";
    double from_s = 0.0;
    const char *const text = getenv("FLAW");
    return text != NULL && sscanf(text, "%31s %lf", name, &from_s) == 2 && strcmp(name, flaw) == 0 &&
           at_s >= from_s;
}

static void hang(void) {
    for (volatile unsigned i = 0;; i++) {
    }
}

static void crash(double at_s) {
    if (has("segfault", at_s)) {
        printf("the last words of a crash\n");
        *(volatile int *)NULL = 1;
    }
    if (has("abort", at_s)) {
        abort();
    }
    if (has("exit", at_s)) {
        exit(0);
    }
    if (has("hang", at_s)) {
        hang();
    }
}

#undef fmi2Instantiate
#undef fmi2DoStep
#undef fmi2GetReal

FMI2(fmi2Component, fmi2Instantiate, fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
     const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    crash(-1.0);
    return sound_fmi2Instantiate(name, type, guid, resources, functions, visible, logging);
}

FMI2(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real from_s, fmi2Real step_s, fmi2Boolean no_return) {
    crash(from_s);
    if (has("error", from_s)) {
        /* The sound FMU's own words: it refuses a step that goes back in time. */
        return sound_fmi2DoStep(c, from_s, -step_s, no_return);
    }
    if (has("print", from_s)) {
        for (int i = 0; i < 100; i++) {
            printf("%f s: all is well, and this line is there to fill the pipe of whoever reads it\n",
                   from_s);
        }
    }
    spoilt = has("nan", from_s);
    return sound_fmi2DoStep(c, from_s, step_s, no_return);
}

FMI2(fmi2Status, fmi2GetReal, fmi2Component c, const fmi2ValueReference references[], size_t count,
     fmi2Real values[]) {
    const fmi2Status status = sound_fmi2GetReal(c, references, count, values);
    if (spoilt && count > 0) {
        values[0] = NAN;
    }
    return status;
}
