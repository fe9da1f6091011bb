/* Lives the life of an FMI 3.0 instance under the sanitizers, as an importer that has the standard's own
 * headers; exits with 0 when all went as it should. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi3Functions.h"
#include "mecanum_variables.h"

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition);                                          \
            exit(1);                                                                                         \
        }                                                                                                    \
    } while (0)

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                 fmi3String message) {
    CHECK(status == fmi3Error && strcmp(category, "logStatusError") == 0 && message[0] != '\0');
    ++*(int *)environment;
}

static fmi3Instance instantiate(const char *token, int *errors) {
    return fmi3InstantiateCoSimulation("x", token, NULL, false, true, false, false, NULL, 0, errors, hear,
                                       NULL);
}

static fmi3Status step(fmi3Instance instance, double from_s, double step_s) {
    bool event, terminate, early;
    double reached_s;
    const fmi3Status status =
        fmi3DoStep(instance, from_s, step_s, true, &event, &terminate, &early, &reached_s);
    CHECK(status != fmi3OK || (!event && !terminate && !early && reached_s == from_s + step_s));
    return status;
}

/* Sets every number that can be set and reads every variable, whatever the state allows. */
static void touch(fmi3Instance instance) {
#define ROW(number, type, causality, member, start, min, max, name)                                          \
    {                                                                                                        \
        const fmi3ValueReference reference = number;                                                         \
        double real = start;                                                                                 \
        fmi3Int32 integer = 1;                                                                               \
        fmi3Int64 item = 1;                                                                                  \
        fmi3SetFloat64(instance, &reference, 1, &real, 1);                                                   \
        fmi3SetInt32(instance, &reference, 1, &integer, 1);                                                  \
        fmi3SetInt64(instance, &reference, 1, &item, 1);                                                     \
        fmi3GetFloat64(instance, &reference, 1, &real, 1);                                                   \
        fmi3GetInt32(instance, &reference, 1, &integer, 1);                                                  \
        fmi3GetInt64(instance, &reference, 1, &item, 1);                                                     \
        fmi3Reset(instance);                                                                                 \
    }
    MECANUM_VARIABLES(ROW)
#undef ROW
}

static void start(fmi3Instance instance) {
    CHECK(fmi3EnterInitializationMode(instance, false, 0.0, 0.0, true, 1.0) == fmi3OK);
    CHECK(fmi3ExitInitializationMode(instance) == fmi3OK);
}

int main(void) {
    int errors = 0;
    CHECK(instantiate("wrong", &errors) == NULL && errors == 1);
    fmi3FreeInstance(NULL);
    CHECK(fmi3Reset(NULL) == fmi3Error);

    fmi3Instance const instance = instantiate(MECANUM_GUID, &errors);
    CHECK(instance != NULL);
    touch(instance);
    start(instance);
    CHECK(step(instance, 0.0, 0.01) == fmi3OK);

    fmi3FMUState state = NULL;
    fmi3FMUState copy = NULL;
    size_t size = 0;
    CHECK(fmi3GetFMUState(instance, &state) == fmi3OK && fmi3GetFMUState(instance, &state) == fmi3OK);
    CHECK(fmi3SerializedFMUStateSize(instance, state, &size) == fmi3OK);
    fmi3Byte *const bytes = malloc(size);
    CHECK(bytes != NULL && fmi3SerializeFMUState(instance, state, bytes, size) == fmi3OK);
    CHECK(step(instance, 0.01, 0.01) == fmi3OK);
    CHECK(fmi3DeserializeFMUState(instance, bytes, size, &copy) == fmi3OK);
    CHECK(fmi3SetFMUState(instance, copy) == fmi3OK && step(instance, 0.01, 0.01) == fmi3OK);
    for (size_t i = 0; i < size; i++) {
        CHECK(fmi3DeserializeFMUState(instance, bytes, i, &copy) == fmi3Error);
    }
    CHECK(fmi3SetFMUState(instance, state) == fmi3OK && step(instance, 0.01, NAN) == fmi3Error);
    CHECK(fmi3FreeFMUState(instance, &state) == fmi3OK && state == NULL);
    CHECK(fmi3FreeFMUState(instance, &copy) == fmi3OK && fmi3FreeFMUState(instance, NULL) == fmi3OK);
    free(bytes);
    CHECK(fmi3Reset(instance) == fmi3OK);
    start(instance);
    CHECK(step(instance, 0.0, 2.0) == fmi3Error &&
          fmi3UpdateDiscreteStates(instance, NULL, NULL, NULL, NULL, NULL, NULL) == fmi3Error);
    fmi3FreeInstance(instance);
    return 0;
}
