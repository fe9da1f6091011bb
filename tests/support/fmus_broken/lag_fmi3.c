/* The lag behind FMI 3.0. Types are those of the standard's headers, which FMPy ships. */
#include "fmi3FunctionTypes.h"
#include "lag.h"

#include <stdlib.h>
#include <string.h>

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

/* Not part of what the lag claims. The caller's arguments are not looked at, so that they need no names here.
 */
#define UNSUPPORTED(name)                                                                                    \
    EXPORT fmi3Status name(void);                                                                            \
    EXPORT fmi3Status name(void) {                                                                           \
        return fmi3Error;                                                                                    \
    }
#define UNSUPPORTED_INSTANCE(name)                                                                           \
    EXPORT fmi3Instance name(void);                                                                          \
    EXPORT fmi3Instance name(void) {                                                                         \
        return NULL;                                                                                         \
    }
#define FUNCTION(type, name, ...)                                                                            \
    EXPORT type name(__VA_ARGS__);                                                                           \
    EXPORT type name(__VA_ARGS__)

static fmi3Status status(lag *m, bool done) {
    if (!done) {
        const fmi3LogMessageCallback log = (fmi3LogMessageCallback)m->logger;
        log(m->environment, fmi3Error, "error", "the lag says no, for once");
    }
    return done ? fmi3OK : BROKEN(FATAL_IN_STEP) ? fmi3Fatal : fmi3Error;
}

FUNCTION(const char *, fmi3GetVersion, void) {
    return lag_version("3.0");
}

FUNCTION(fmi3Instance, fmi3InstantiateCoSimulation, fmi3String name, fmi3String token, fmi3String resources,
         fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
         const fmi3ValueReference required[], size_t count, fmi3InstanceEnvironment environment,
         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required;
    (void)count, (void)update;
    if (strcmp(token, LAG_TOKEN) != 0) {
        log(environment, fmi3Error, "error", "another token");
        return NULL;
    }
    return lag_new(environment, (void *)log);
}

FUNCTION(void, fmi3FreeInstance, fmi3Instance c) {
    const lag *const m = c;
    ((fmi3LogMessageCallback)m->logger)(m->environment, fmi3OK, "error", "the lag is freed");
    lag_free(c);
}

FUNCTION(fmi3Status, fmi3SetDebugLogging, fmi3Instance c, fmi3Boolean on, size_t count,
         const fmi3String names[]) {
    (void)on, (void)names;
    return status(c, lag_logs(count));
}

FUNCTION(fmi3Status, fmi3EnterInitializationMode, fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance,
         fmi3Float64 start_s, fmi3Boolean stops, fmi3Float64 stop_s) {
    (void)tolerant, (void)tolerance, (void)stops, (void)stop_s;
    return status(c, lag_enter(c, start_s));
}

FUNCTION(fmi3Status, fmi3ExitInitializationMode, fmi3Instance c) {
    return status(c, lag_exit(c));
}

FUNCTION(fmi3Status, fmi3Terminate, fmi3Instance c) {
    return status(c, lag_terminate(c));
}

FUNCTION(fmi3Status, fmi3Reset, fmi3Instance c) {
    lag_reset(c);
    return fmi3OK;
}

FUNCTION(fmi3Status, fmi3GetFloat64, fmi3Instance c, const fmi3ValueReference vr[], size_t n,
         fmi3Float64 values[], size_t room) {
    size_t used = 0;
    for (size_t i = 0; i < n; i++) {
        const size_t size = vr[i] == VECTOR ? 2 : 1;
        if (used + size > room) {
            return status(c, false);
        }
        if (!lag_get_float(c, vr[i] == VECTOR ? INPUT : vr[i], &values[used])) {
            return status(c, false);
        }
        if (vr[i] == VECTOR) {
            values[used + 1] = 2.0 * values[used];
        }
        used += size;
    }
    return status(c, used == room);
}

FUNCTION(fmi3Status, fmi3SetFloat64, fmi3Instance c, const fmi3ValueReference vr[], size_t n,
         const fmi3Float64 values[], size_t room) {
    bool done = n == room;
    for (size_t i = 0; i < n && done; i++) {
        done = lag_set_float(c, vr[i], values[i]);
    }
    return status(c, done);
}

/* The enumeration is an Int64, the count an Int32. */
static bool is_integer(unsigned reference, bool wide) {
    return (reference == SHAPE) == wide;
}

#define INTEGER(type, wide)                                                                                  \
    FUNCTION(fmi3Status, fmi3Get##type, fmi3Instance c, const fmi3ValueReference vr[], size_t n,             \
             fmi3##type values[], size_t room) {                                                             \
        bool done = n == room;                                                                               \
        for (size_t i = 0; i < n && done; i++) {                                                             \
            int value = 0;                                                                                   \
            done = is_integer(vr[i], wide) ? lag_get_integer(c, vr[i], &value) : lag_fail(c);                \
            values[i] = value;                                                                               \
        }                                                                                                    \
        return status(c, done);                                                                              \
    }                                                                                                        \
    FUNCTION(fmi3Status, fmi3Set##type, fmi3Instance c, const fmi3ValueReference vr[], size_t n,             \
             const fmi3##type values[], size_t room) {                                                       \
        bool done = n == room;                                                                               \
        for (size_t i = 0; i < n && done; i++) {                                                             \
            done = is_integer(vr[i], wide) ? lag_set_integer(c, vr[i], (int)values[i]) : lag_fail(c);        \
        }                                                                                                    \
        return status(c, done);                                                                              \
    }
INTEGER(Int64, true)
INTEGER(Int32, false)

FUNCTION(fmi3Status, fmi3DoStep, fmi3Instance c, fmi3Float64 time_s, fmi3Float64 size_s,
         fmi3Boolean no_way_back, fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
         fmi3Float64 *last_s) {
    (void)no_way_back;
    *event = BROKEN(ASKS_FOR_EVENT_MODE);
    *terminate = BROKEN(ENDS_SIMULATION);
    *early = BROKEN(RETURNS_EARLY);
    *last_s = BROKEN(WRONG_LAST_TIME) ? time_s : time_s + size_s;
    return lag_discards(c, size_s) ? fmi3Discard : status(c, lag_step(c, size_s));
}

FUNCTION(fmi3Status, fmi3GetFMUState, fmi3Instance c, fmi3FMUState *state) {
    return status(c, lag_save(c, state));
}

FUNCTION(fmi3Status, fmi3SetFMUState, fmi3Instance c, fmi3FMUState state) {
    return status(c, lag_restore(c, state));
}

FUNCTION(fmi3Status, fmi3FreeFMUState, fmi3Instance c, fmi3FMUState *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

FUNCTION(fmi3Status, fmi3SerializedFMUStateSize, fmi3Instance c, fmi3FMUState state, size_t *size) {
    (void)c, (void)state;
    *size = lag_size();
    return fmi3OK;
}

FUNCTION(fmi3Status, fmi3SerializeFMUState, fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[],
         size_t size) {
    (void)c, (void)size;
    lag_to_bytes(state, (char *)bytes);
    return fmi3OK;
}

FUNCTION(fmi3Status, fmi3DeserializeFMUState, fmi3Instance c, const fmi3Byte bytes[], size_t size,
         fmi3FMUState *state) {
    return status(c, lag_from_bytes(c, (const char *)bytes, size, state));
}

UNSUPPORTED_INSTANCE(fmi3InstantiateModelExchange)
UNSUPPORTED_INSTANCE(fmi3InstantiateScheduledExecution)
UNSUPPORTED(fmi3EnterEventMode)
UNSUPPORTED(fmi3GetFloat32)
UNSUPPORTED(fmi3GetInt8)
UNSUPPORTED(fmi3GetUInt8)
UNSUPPORTED(fmi3GetInt16)
UNSUPPORTED(fmi3GetUInt16)
UNSUPPORTED(fmi3GetUInt32)
UNSUPPORTED(fmi3GetUInt64)
UNSUPPORTED(fmi3GetBoolean)
UNSUPPORTED(fmi3GetString)
UNSUPPORTED(fmi3GetBinary)
UNSUPPORTED(fmi3GetClock)
UNSUPPORTED(fmi3SetFloat32)
UNSUPPORTED(fmi3SetInt8)
UNSUPPORTED(fmi3SetUInt8)
UNSUPPORTED(fmi3SetInt16)
UNSUPPORTED(fmi3SetUInt16)
UNSUPPORTED(fmi3SetUInt32)
UNSUPPORTED(fmi3SetUInt64)
UNSUPPORTED(fmi3SetBoolean)
UNSUPPORTED(fmi3SetString)
UNSUPPORTED(fmi3SetBinary)
UNSUPPORTED(fmi3SetClock)
UNSUPPORTED(fmi3GetNumberOfVariableDependencies)
UNSUPPORTED(fmi3GetVariableDependencies)
UNSUPPORTED(fmi3GetDirectionalDerivative)
UNSUPPORTED(fmi3GetAdjointDerivative)
UNSUPPORTED(fmi3EnterConfigurationMode)
UNSUPPORTED(fmi3ExitConfigurationMode)
UNSUPPORTED(fmi3GetIntervalDecimal)
UNSUPPORTED(fmi3GetIntervalFraction)
UNSUPPORTED(fmi3GetShiftDecimal)
UNSUPPORTED(fmi3GetShiftFraction)
UNSUPPORTED(fmi3SetIntervalDecimal)
UNSUPPORTED(fmi3SetIntervalFraction)
UNSUPPORTED(fmi3SetShiftDecimal)
UNSUPPORTED(fmi3SetShiftFraction)
UNSUPPORTED(fmi3EvaluateDiscreteStates)
UNSUPPORTED(fmi3UpdateDiscreteStates)
UNSUPPORTED(fmi3EnterContinuousTimeMode)
UNSUPPORTED(fmi3CompletedIntegratorStep)
UNSUPPORTED(fmi3SetTime)
UNSUPPORTED(fmi3SetContinuousStates)
UNSUPPORTED(fmi3GetContinuousStateDerivatives)
UNSUPPORTED(fmi3GetEventIndicators)
UNSUPPORTED(fmi3GetContinuousStates)
UNSUPPORTED(fmi3GetNominalsOfContinuousStates)
UNSUPPORTED(fmi3GetNumberOfEventIndicators)
UNSUPPORTED(fmi3GetNumberOfContinuousStates)
UNSUPPORTED(fmi3EnterStepMode)
UNSUPPORTED(fmi3GetOutputDerivatives)
UNSUPPORTED(fmi3ActivateModelPartition)
