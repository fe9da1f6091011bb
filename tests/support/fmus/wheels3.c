/* The robot of wheels.h for FMI 3.0, co-simulation.
 *
 * Value references: 0 torques (Float32[wheels]), 4 angles in degrees (Float64[2,2]), 8 x (Float64), 9 y
 * (Float32), 10 heading (Float64), 11-14 speeds (Float64), 20 inertia, 23 fault time, 25 grain
 * (Float64); 30-33 counts of the wheels in whatever integer type they are asked for, 34 fault (Int32), 35
 * gear (Int64); 36 wheels (UInt32, structural); 40 reversed (Boolean); 50 label (String). */
#include "wheels.h"

typedef void (*log_message)(void *, int, const char *, const char *);

typedef struct {
    wheels now;
    log_message log;
    void *environment;
    bool configuring;
    uint32_t wheels;
} instance;

static int say(const instance *s, int status) {
    s->log(s->environment, status, "logStatusError", "wheel 1 fell off");
    return status;
}

static void *instantiate(const char *token, void *environment, log_message log) {
    if (strcmp(token, GUID) != 0) {
        log(environment, ERROR, "logStatusError", "wrong token");
        return NULL;
    }
    instance *const s = calloc(1, sizeof *s);
    wheels_init(&s->now);
    s->log = log;
    s->environment = environment;
    s->wheels = 4;
    return s;
}

EXPORT void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources,
                                         bool visible, bool logging_on, bool event_mode, bool early_return,
                                         const unsigned intermediate[], size_t n, void *environment,
                                         log_message log, void (*update)(void)) {
    (void)name, (void)visible, (void)logging_on, (void)intermediate, (void)update;
    if (resources != NULL || event_mode || early_return || n != 0) {
        log(environment, ERROR, "logStatusError", "asked for what this FMU has not");
        return NULL;
    }
    return instantiate(token, environment, log);
}

EXPORT void fmi3FreeInstance(void *c) {
    if (is_faulty(&((instance *)c)->now, SAY_FATAL)) {
        abort(); /* nothing may be called any more */
    }
    free(c);
}

EXPORT int fmi3EnterConfigurationMode(void *c) {
    instance *const s = c;
    s->configuring = true;
    return s->now.fault == REFUSE_TO_BEGIN ? say(s, ERROR) : OK;
}

EXPORT int fmi3ExitConfigurationMode(void *c) {
    instance *const s = c;
    s->configuring = false;
    return s->now.fault == STAY_IN_CONFIGURATION ? say(s, ERROR) : OK;
}

EXPORT int fmi3EnterInitializationMode(void *c, bool tolerance_defined, double tolerance, double start_s,
                                       bool stop_defined, double stop_s) {
    instance *const s = c;
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop_s;
    s->now.time_s = start_s;
    return s->now.fault == FAIL_AT_INITIALIZATION || s->configuring ? say(s, ERROR) : OK;
}

EXPORT int fmi3ExitInitializationMode(void *c) {
    ((instance *)c)->now.initialised = true;
    return OK;
}

EXPORT int fmi3Terminate(void *c) {
    (void)c;
    return OK;
}

EXPORT int fmi3Reset(void *c) {
    instance *const s = c;
    if (s->now.fault == FAIL_TO_RESET) {
        return say(s, ERROR);
    }
    wheels_reset(&s->now);
    return OK;
}

EXPORT int fmi3SetFloat32(void *c, const unsigned reference[], size_t n, const float value[], size_t values) {
    instance *const s = c;
    if (n != 1 || reference[0] != 0 || values != s->wheels) {
        return say(s, ERROR);
    }
    for (size_t i = 0; i < 4; i++) {
        s->now.torque_n_cm[i] = (double)value[i];
    }
    return OK;
}

EXPORT int fmi3GetFloat32(void *c, const unsigned reference[], size_t n, float value[], size_t values) {
    instance *const s = c;
    if (n != 1 || reference[0] != 9 || values != 1) {
        return say(s, ERROR);
    }
    value[0] = (float)y_m(&s->now);
    return OK;
}

EXPORT int fmi3SetFloat64(void *c, const unsigned reference[], size_t n, const double value[],
                          size_t values) {
    instance *const s = c;
    wheels *const w = &s->now;
    double *const parameter[] = {&w->inertia_kg_m2, NULL, NULL, &w->fault_time_s, NULL, &w->grain_s};
    for (size_t i = 0; i < n; i++) {
        if (reference[i] < 20 || reference[i] > 25 || n != values || w->initialised) {
            return say(s, ERROR);
        }
        *parameter[reference[i] - 20] = value[i];
    }
    return OK;
}

EXPORT int fmi3GetFloat64(void *c, const unsigned reference[], size_t n, double value[], size_t values) {
    instance *const s = c;
    const wheels *const w = &s->now;
    size_t at = 0;
    for (size_t i = 0; i < n; i++) {
        const unsigned r = reference[i];
        const size_t size = r == 4 ? 4 : 1;
        if (at + size > values || is_faulty(w, FAIL_TO_READ)) {
            return ERROR;
        }
        for (size_t k = 0; k < size; k++) {
            value[at++] = r == 4    ? w->angle_rad[k] * 180.0 / PI
                          : r == 8  ? x_m(w)
                          : r == 10 ? heading_deg(w)
                                    : w->speed_rad_s[r - 11];
        }
    }
    return at == values ? OK : say(s, ERROR);
}

/* A counter of any width: it wraps. */
#define COUNTER(name, type)                                                                                  \
    EXPORT int name(void *c, const unsigned reference[], size_t n, type value[], size_t values);             \
    EXPORT int name(void *c, const unsigned reference[], size_t n, type value[], size_t values) {            \
        const wheels *const w = &((instance *)c)->now;                                                       \
        for (size_t i = 0; i < n; i++) {                                                                     \
            value[i] = (type)count(w, (int)reference[i] - 30);                                               \
        }                                                                                                    \
        return n == values ? OK : ERROR;                                                                     \
    }

COUNTER(fmi3GetInt8, int8_t)
COUNTER(fmi3GetUInt8, uint8_t)
COUNTER(fmi3GetInt16, int16_t)
COUNTER(fmi3GetUInt16, uint16_t)
COUNTER(fmi3GetInt32, int32_t)
COUNTER(fmi3GetUInt32, uint32_t)
COUNTER(fmi3GetInt64, int64_t)
COUNTER(fmi3GetUInt64, uint64_t)

EXPORT int fmi3SetInt32(void *c, const unsigned reference[], size_t n, const int32_t value[], size_t values) {
    (void)n, (void)values;
    instance *const s = c;
    s->now.fault = value[0];
    return reference[0] == 34 ? OK : say(s, ERROR);
}

EXPORT int fmi3SetInt64(void *c, const unsigned reference[], size_t n, const int64_t value[], size_t values) {
    (void)n, (void)values;
    instance *const s = c;
    s->now.gear = (int)value[0];
    return reference[0] == 35 ? OK : say(s, ERROR);
}

EXPORT int fmi3SetUInt32(void *c, const unsigned reference[], size_t n, const uint32_t value[],
                         size_t values) {
    (void)n, (void)values;
    instance *const s = c;
    s->wheels = value[0];
    return reference[0] == 36 && s->configuring ? OK : say(s, ERROR);
}

EXPORT int fmi3SetBoolean(void *c, const unsigned reference[], size_t n, const bool value[], size_t values) {
    (void)reference, (void)n, (void)values;
    ((instance *)c)->now.reversed = value[0];
    return OK;
}

EXPORT int fmi3SetString(void *c, const unsigned reference[], size_t n, const char *const value[],
                         size_t values) {
    (void)reference, (void)n, (void)values;
    instance *const s = c;
    if (strlen(value[0]) >= sizeof s->now.label) {
        return say(s, ERROR);
    }
    strcpy(s->now.label, value[0]);
    return OK;
}

EXPORT int fmi3GetString(void *c, const unsigned reference[], size_t n, const char *value[], size_t values) {
    (void)reference, (void)n, (void)values;
    value[0] = ((instance *)c)->now.label;
    return OK;
}

EXPORT int fmi3DoStep(void *c, double from_s, double step_s, bool no_set_state, bool *event_handling_needed,
                      bool *terminate, bool *early_return, double *last_successful_time_s) {
    (void)no_set_state;
    instance *const s = c;
    wheels *const w = &s->now;
    *event_handling_needed = *terminate = *early_return = false;
    if (fabs(from_s - w->time_s) > 1e-9 || !takes(w, step_s)) {
        return say(s, ERROR);
    }
    *early_return = is_faulty(w, RETURN_EARLY);
    wheels_step(w, *early_return || is_faulty(w, REACH_ELSEWHERE) ? step_s / 2.0 : step_s);
    *last_successful_time_s = w->time_s;
    *event_handling_needed = is_faulty(w, ASK_FOR_EVENT_MODE);
    static const int FAULTS[][2] = {
        {SAY_ERROR, ERROR}, {SAY_DISCARD, DISCARD}, {SAY_FATAL, FATAL}, {SAY_WARNING, WARNING}};
    for (size_t i = 0; i < sizeof FAULTS / sizeof *FAULTS; i++) {
        if (is_faulty(w, FAULTS[i][0])) {
            return say(s, FAULTS[i][1]);
        }
    }
    *terminate = is_faulty(w, END);
    return is_faulty(w, SILENT_ERROR) ? ERROR : OK;
}

STUB(fmi3GetVersion)
STUB(fmi3SetDebugLogging)
STUB(fmi3InstantiateModelExchange)
STUB(fmi3InstantiateScheduledExecution)
STUB(fmi3GetBoolean)
STUB(fmi3GetBinary)
STUB(fmi3GetClock)
STUB(fmi3SetInt8)
STUB(fmi3SetUInt8)
STUB(fmi3SetInt16)
STUB(fmi3SetUInt16)
STUB(fmi3SetUInt64)
STUB(fmi3SetBinary)
STUB(fmi3SetClock)
STUB(fmi3GetNumberOfVariableDependencies)
STUB(fmi3GetVariableDependencies)
STUB(fmi3GetFMUState)
STUB(fmi3SetFMUState)
STUB(fmi3FreeFMUState)
STUB(fmi3SerializedFMUStateSize)
STUB(fmi3SerializeFMUState)
STUB(fmi3DeserializeFMUState)
STUB(fmi3GetDirectionalDerivative)
STUB(fmi3GetAdjointDerivative)
STUB(fmi3GetIntervalDecimal)
STUB(fmi3GetIntervalFraction)
STUB(fmi3GetShiftDecimal)
STUB(fmi3GetShiftFraction)
STUB(fmi3SetIntervalDecimal)
STUB(fmi3SetIntervalFraction)
STUB(fmi3SetShiftDecimal)
STUB(fmi3SetShiftFraction)
STUB(fmi3EvaluateDiscreteStates)
STUB(fmi3EnterStepMode)
STUB(fmi3EnterEventMode)
STUB(fmi3EnterContinuousTimeMode)
STUB(fmi3CompletedIntegratorStep)
STUB(fmi3SetTime)
STUB(fmi3SetContinuousStates)
STUB(fmi3GetContinuousStates)
STUB(fmi3GetContinuousStateDerivatives)
STUB(fmi3GetEventIndicators)
STUB(fmi3GetNominalsOfContinuousStates)
STUB(fmi3GetNumberOfContinuousStates)
STUB(fmi3GetNumberOfEventIndicators)
STUB(fmi3UpdateDiscreteStates)
STUB(fmi3GetOutputDerivatives)
STUB(fmi3ActivateModelPartition)
