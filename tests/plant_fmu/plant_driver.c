/* Runs the FMU's sources and the shim under the sanitizers; exits with 0 when all went as it should. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cosim.h"
#include "fmi2.h"
#include "mecanum_variables.h"

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition);                                          \
            return 1;                                                                                        \
        }                                                                                                    \
    } while (0)

void *fmi2Instantiate(const char *, fmi2Type, const char *, const char *, const fmi2CallbackFunctions *, int,
                      int);
void fmi2FreeInstance(void *);
fmi2Status fmi2SetupExperiment(void *, int, double, double, int, double);
fmi2Status fmi2EnterInitializationMode(void *);
fmi2Status fmi2ExitInitializationMode(void *);
fmi2Status fmi2Reset(void *);
fmi2Status fmi2GetFMUstate(void *, void **);
fmi2Status fmi2SetFMUstate(void *, void *);
fmi2Status fmi2FreeFMUstate(void *, void **);
fmi2Status fmi2SerializedFMUstateSize(void *, void *, size_t *);
fmi2Status fmi2SerializeFMUstate(void *, void *, char *, size_t);
fmi2Status fmi2DeSerializeFMUstate(void *, const char *, size_t, void **);
int fmi2SetReal(void *, const unsigned *, size_t, const double *);
int fmi2GetReal(void *, const unsigned *, size_t, double *);
int fmi2GetInteger(void *, const unsigned *, size_t, int *);
int fmi2DoStep(void *, double, double, int);
int fmi2GetBooleanStatus(void *, int, int *);

static void log_message(void *environment, const char *name, fmi2Status status, const char *category,
                        const char *message, ...) {
    (void)name, (void)status, (void)category, (void)message;
    ++*(int *)environment;
}

static int initialise(void *component) {
    return fmi2SetupExperiment(component, 0, 0.0, 0.0, 0, 0.0) == fmi2OK &&
           fmi2EnterInitializationMode(component) == fmi2OK &&
           fmi2ExitInitializationMode(component) == fmi2OK;
}

/* Looks a value reference up in the generated table. */
static unsigned reference(const char *wanted) {
#define ROW(number, type, causality, member, start, min, max, name)                                          \
    if (strcmp(wanted, name) == 0) {                                                                         \
        return number;                                                                                       \
    }
    MECANUM_VARIABLES(ROW)
#undef ROW
    fprintf(stderr, "no variable %s\n", wanted);
    exit(1);
}

int main(void) {
    int messages = 0;
    const fmi2CallbackFunctions callbacks = {.logger = log_message, .componentEnvironment = &messages};
    CHECK(fmi2Instantiate("x", fmi2CoSimulation, "wrong", "", &callbacks, 0, 0) == NULL);
    CHECK(messages == 1);
    void *const component = fmi2Instantiate("x", fmi2CoSimulation, MECANUM_GUID, "", &callbacks, 0, 0);
    CHECK(component != NULL);
    CHECK(initialise(component));

    /* The torques and outputs of the shim by their own names: the groups that the importer would lay out. */
    const char *const reals[] = {
        "pose.x_m",
        "pose.y_m",
        "pose.heading_rad",
        "twist.vx_m_s",
        "twist.vy_m_s",
        "twist.yaw_rate_rad_s",
        "wheel.fl.speed_rad_s",
        "wheel.fr.speed_rad_s",
        "wheel.rr.speed_rad_s",
        "wheel.rl.speed_rad_s",
        "wheel.fl.current_a",
        "wheel.fr.current_a",
        "wheel.rr.current_a",
        "wheel.rl.current_a",
        "gyro.x_rad_s",
        "gyro.y_rad_s",
        "gyro.z_rad_s",
    };
    enum { REALS = sizeof reals / sizeof *reals };
    const char *const wheels[4] = {"fl", "fr", "rr", "rl"};
    unsigned real_reference[REALS], torque_reference[4], count_reference[4];
    cosim_row real_row[REALS], torque_row[4], count_row[4];
    double real[REALS], torque[4];
    int32_t counts[4];
    for (size_t i = 0; i < REALS; i++) {
        real_reference[i] = reference(reals[i]);
        real_row[i] = (cosim_row){i, i, 1.0, 0.0};
    }
    for (size_t i = 0; i < 4; i++) {
        char name[32];
        snprintf(name, sizeof name, "wheel.%s.torque_n_m", wheels[i]);
        torque_reference[i] = reference(name);
        torque_row[i] = (cosim_row){i, i, 1.0, 0.0};
        snprintf(name, sizeof name, "wheel.%s.count", wheels[i]);
        count_reference[i] = reference(name);
        count_row[i] = (cosim_row){COSIM_COUNT + i, i, 1.0, 0.0};
    }
    cosim shim = {
        .component = component,
        .fmi_version = 2,
        .do_step = (cosim_function)fmi2DoStep,
        .get_boolean_status = (cosim_function)fmi2GetBooleanStatus,
        .input = {{COSIM_FLOAT64, (cosim_function)fmi2SetReal, torque_reference, 4, torque, 4, torque_row, 4,
                   1}},
        .inputs = 1,
        .output = {{COSIM_FLOAT64, (cosim_function)fmi2GetReal, real_reference, REALS, real, REALS, real_row,
                    REALS, 1},
                   {COSIM_INT32, (cosim_function)fmi2GetInteger, count_reference, 4, counts, 4, count_row, 4,
                    1}},
        .outputs = 2,
        .wheel_of_channel = {3, 2, 1, 0},
        .sign_of_channel = {1, -1, 1, -1},
        .tick_ns = 1000000,
        .step_ns = 1000000,
    };
    CHECK(cosim_start(&shim) == 0);

    const float torque_n_m[4] = {1.0F, -1.0F, 0.5F, 0.25F};
    CHECK(cosim_run(&shim, torque_n_m, 500) == 0);
    CHECK(shim.ticks == 500);

    void *state = NULL;
    size_t size = 0;
    CHECK(fmi2GetFMUstate(component, &state) == fmi2OK);
    CHECK(fmi2SerializedFMUstateSize(component, state, &size) == fmi2OK);
    char *const bytes = malloc(size);
    CHECK(bytes != NULL && fmi2SerializeFMUstate(component, state, bytes, size) == fmi2OK);
    CHECK(fmi2DeSerializeFMUstate(component, bytes, size, &state) == fmi2OK);
    CHECK(fmi2SetFMUstate(component, state) == fmi2OK);
    messages = 0;
    CHECK(fmi2DeSerializeFMUstate(component, bytes, size - 1, &state) == fmi2Error);
    bytes[size / 2] ^= 1;
    CHECK(fmi2DeSerializeFMUstate(component, bytes, size, &state) == fmi2Error);
    CHECK(messages == 2);
    CHECK(fmi2SetFMUstate(component, state) == fmi2OK);
    CHECK(cosim_run(&shim, torque_n_m, 10) == 0);
    CHECK(fmi2FreeFMUstate(component, &state) == fmi2OK && state == NULL);
    free(bytes);

    const float huge_n_m[4] = {3e38F, -3e38F, 3e38F, -1e38F};
    CHECK(cosim_run(&shim, huge_n_m, 100000) != 0); /* overflows on the way */
    CHECK(isfinite(shim.signal[0]));
    const double nan = NAN;
    CHECK(fmi2Reset(component) == fmi2OK && initialise(component));
    CHECK(fmi2SetReal(component, torque_reference, 1, &nan) == fmi2Discard);
    CHECK(fmi2Reset(component) == fmi2OK && initialise(component) && cosim_start(&shim) == 0);
    cosim_log2(&shim, "x", 3, "logStatusError", "%s %d", "a message", 1);
    CHECK(strcmp(shim.text, "a message 1") == 0);
    cosim_log2(&shim, "x", 1, "logStatusWarning", "less");
    CHECK(strcmp(shim.text, "a message 1") == 0);
    cosim_log3(&shim, 3, "logStatusError", "a newer one %s");
    CHECK(strcmp(shim.text, "a newer one %s") == 0);
    fmi2FreeInstance(component);
    return 0;
}
