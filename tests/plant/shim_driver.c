/* Runs the shim over the foreign FMI 3.0 FMU under the sanitizers: types, arrays, what is derived, early
 * returns. */
#include <stdio.h>

#include "cosim.h"
#include "wheels.h"

#define CHECK(condition)                                                                                     \
    do {                                                                                                     \
        if (!(condition)) {                                                                                  \
            fprintf(stderr, "line %d: %s\n", __LINE__, #condition);                                          \
            return 1;                                                                                        \
        }                                                                                                    \
    } while (0)

void *fmi3InstantiateCoSimulation(const char *, const char *, const char *, bool, bool, bool, bool,
                                  const unsigned[], size_t, void *,
                                  void (*)(void *, int, const char *, const char *), void (*)(void));
void fmi3FreeInstance(void *);
int fmi3Reset(void *);
int fmi3SetInt32(void *, const unsigned[], size_t, const int32_t[], size_t);
int fmi3SetFloat64(void *, const unsigned[], size_t, const double[], size_t);
int fmi3SetFloat32(void *, const unsigned[], size_t, const float[], size_t);
int fmi3GetFloat64(void *, const unsigned[], size_t, double[], size_t);
int fmi3GetFloat32(void *, const unsigned[], size_t, float[], size_t);
int fmi3GetInt8(void *, const unsigned[], size_t, int8_t[], size_t);
int fmi3GetUInt64(void *, const unsigned[], size_t, uint64_t[], size_t);
int fmi3DoStep(void *, double, double, bool, bool *, bool *, bool *, double *);

static int run_with(cosim *c, int32_t fault, uint32_t ticks) {
    static const unsigned fault_reference = 34, time_reference = 23;
    static const double time_s = 0.01;
    static const float torque_n_m[4] = {0.5F, -0.25F, 0.125F, 1.0F};
    return fmi3Reset(c->component) + fmi3SetInt32(c->component, &fault_reference, 1, &fault, 1) +
           fmi3SetFloat64(c->component, &time_reference, 1, &time_s, 1) + cosim_start(c) +
           cosim_run(c, torque_n_m, ticks);
}

int main(void) {
    const unsigned tau = 0, y = 9, doubles[] = {4, 8, 10}, small[] = {30, 31}, large[] = {32, 33};
    float torque[4], y_m;
    double values[6];
    int8_t count8[2];
    uint64_t count64[2];
    cosim_row torque_row[4], double_row[6], small_row[2], large_row[2];
    for (size_t i = 0; i < 4; i++) {
        torque_row[i] = (cosim_row){i, i, 0.01, 0.0};
        double_row[i] = (cosim_row){COSIM_WHEEL_ANGLE + i, i, PI / 180.0, 0.0};
        *(i < 2 ? &small_row[i] : &large_row[i - 2]) = (cosim_row){COSIM_COUNT + i, i % 2, 1.0, 0.0};
    }
    double_row[4] = (cosim_row){COSIM_POSE, 4, 1.0, 0.0};
    double_row[5] = (cosim_row){COSIM_POSE + 2, 5, PI / 180.0, 0.0};
    const cosim_row y_row = {COSIM_POSE + 1, 0, 1.0, 2.0};
    cosim c = {
        .fmi_version = 3,
        .do_step = (cosim_function)fmi3DoStep,
        .input = {{COSIM_FLOAT32, (cosim_function)fmi3SetFloat32, &tau, 1, torque, 4, torque_row, 4, 0, 0}},
        .inputs = 1,
        .output = {{COSIM_FLOAT64, (cosim_function)fmi3GetFloat64, doubles, 3, values, 6, double_row, 6, 0,
                    0},
                   {COSIM_FLOAT32, (cosim_function)fmi3GetFloat32, &y, 1, &y_m, 1, &y_row, 1, 0, 0},
                   {COSIM_INT8, (cosim_function)fmi3GetInt8, small, 2, count8, 2, small_row, 2, 1, 0},
                   {COSIM_UINT64, (cosim_function)fmi3GetUInt64, large, 2, count64, 2, large_row, 2, 1, 0}},
        .outputs = 4,
        .derives = 1,
        .counts_per_revolution = 1000.0,
        .torque_constant_n_m_a = 0.5,
        .wheel_of_channel = {0, 1, 2, 3},
        .sign_of_channel = {1, 1, 1, 1},
        .tick_ns = 1000000,
        .step_ns = 1000000,
    };
    for (size_t i = 0; i < COSIM_SIGNALS; i++) {
        c.name[i] = "a signal";
        c.derived[i] = i >= COSIM_TWIST && i < COSIM_COUNT;
    }
    c.component = fmi3InstantiateCoSimulation("x", GUID, NULL, false, true, false, false, NULL, 0, &c,
                                              cosim_log3, NULL);
    CHECK(c.component != NULL);

    CHECK(run_with(&c, NO_FAULT, 1000) == 0);
    CHECK(c.ticks == 1000);
    CHECK(fabs(c.signal[COSIM_WHEEL_ANGLE + 3] - 25.0) < 1e-4);   /* 1 N m / 0.02 kg m2, for a second */
    CHECK(fabs(c.signal[COSIM_WHEEL_SPEED + 3] - 49.975) < 1e-4); /* in the middle of the last tick */
    CHECK(fabs(c.signal[COSIM_CURRENT + 3] - 2.0) < 1e-9);
    CHECK(fabs(c.signal[COSIM_POSE + 1] - c.output[1].row->offset - (double)y_m) < 1e-12);
    CHECK(c.signal[COSIM_COUNT] == -59.0); /* 1989 of 12.5 rad, in 8 bits */

    CHECK(run_with(&c, RETURN_EARLY, 20) != 0 && strstr(c.text, "returned early at") != NULL);
    CHECK(run_with(&c, REACH_ELSEWHERE, 20) != 0 && strstr(c.text, "says that it reached") != NULL);
    CHECK(run_with(&c, END, 20) != 0 && strstr(c.text, "asked to end") != NULL && c.ticks == 9);
    CHECK(run_with(&c, GIVE_NAN, 20) != 0 && strstr(c.text, "a signal is not a number") != NULL);
    CHECK(run_with(&c, SAY_DISCARD, 20) != 0 && strcmp(c.text, "wheel 1 fell off") == 0);
    CHECK(run_with(&c, SAY_WARNING, 20) == 0 && c.text_status == WARNING);
    fmi3FreeInstance(c.component);
    return 0;
}
