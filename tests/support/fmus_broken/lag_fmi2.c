/* The lag behind FMI 2.0. Types are those of the standard's headers, which FMPy ships. */
#include "fmi2FunctionTypes.h"
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
    EXPORT fmi2Status name(void);                                                                            \
    EXPORT fmi2Status name(void) {                                                                           \
        return fmi2Error;                                                                                    \
    }
#define FUNCTION(type, name, ...)                                                                            \
    EXPORT type name(__VA_ARGS__);                                                                           \
    EXPORT type name(__VA_ARGS__)

static fmi2Status status(lag *m, bool done) {
    if (!done) {
        const fmi2CallbackFunctions *const callbacks = m->logger;
        callbacks->logger(m->environment, "lag", fmi2Error, "error", "the lag says %s, for once", "no");
    }
    return done ? fmi2OK : BROKEN(FATAL_IN_STEP) ? fmi2Fatal : fmi2Error;
}

FUNCTION(const char *, fmi2GetTypesPlatform, void) {
    return "default";
}

FUNCTION(const char *, fmi2GetVersion, void) {
    return lag_version("2.0");
}

FUNCTION(fmi2Component, fmi2Instantiate, fmi2String name, fmi2Type type, fmi2String token,
         fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
         fmi2Boolean logging) {
    (void)name, (void)resources, (void)visible, (void)logging;
    if (type != fmi2CoSimulation || strcmp(token, LAG_TOKEN) != 0) {
        functions->logger(functions->componentEnvironment, "lag", fmi2Error, "error",
                          "another type or token");
        return NULL;
    }
    return lag_new(functions->componentEnvironment, (void *)functions);
}

FUNCTION(void, fmi2FreeInstance, fmi2Component c) {
    const lag *const m = c;
    const fmi2CallbackFunctions *const callbacks = m->logger;
    callbacks->logger(m->environment, "lag", fmi2OK, "error", "the lag is freed");
    lag_free(c);
}

FUNCTION(fmi2Status, fmi2SetDebugLogging, fmi2Component c, fmi2Boolean on, size_t count,
         const fmi2String names[]) {
    (void)on, (void)names;
    return status(c, lag_logs(count));
}

FUNCTION(fmi2Status, fmi2SetupExperiment, fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance,
         fmi2Real start_s, fmi2Boolean stops, fmi2Real stop_s) {
    (void)tolerant, (void)tolerance, (void)stops, (void)stop_s;
    lag *const m = c;
    m->now.time_s = start_s;
    return status(m, lag_legal(m, INSTANTIATED));
}

FUNCTION(fmi2Status, fmi2EnterInitializationMode, fmi2Component c) {
    return status(c, lag_enter(c, ((lag *)c)->now.time_s));
}

FUNCTION(fmi2Status, fmi2ExitInitializationMode, fmi2Component c) {
    return status(c, lag_exit(c));
}

FUNCTION(fmi2Status, fmi2Terminate, fmi2Component c) {
    return status(c, lag_terminate(c));
}

FUNCTION(fmi2Status, fmi2Reset, fmi2Component c) {
    lag_reset(c);
    return fmi2OK;
}

#define EACH(name, type, element)                                                                            \
    FUNCTION(fmi2Status, name, fmi2Component c, const fmi2ValueReference vr[], size_t n, type values[]) {    \
        for (size_t i = 0; i < n; i++) {                                                                     \
            if (!element) {                                                                                  \
                return status(c, false);                                                                     \
            }                                                                                                \
        }                                                                                                    \
        return fmi2OK;                                                                                       \
    }
EACH(fmi2GetReal, fmi2Real, lag_get_float(c, vr[i], &values[i]))
EACH(fmi2SetReal, const fmi2Real, lag_set_float(c, vr[i], values[i]))
EACH(fmi2GetInteger, fmi2Integer, lag_get_integer(c, vr[i], &values[i]))
EACH(fmi2SetInteger, const fmi2Integer, lag_set_integer(c, vr[i], values[i]))

FUNCTION(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real time_s, fmi2Real size_s, fmi2Boolean no_way_back) {
    (void)time_s, (void)no_way_back;
    return lag_discards(c, size_s) ? fmi2Discard : status(c, lag_step(c, size_s));
}

FUNCTION(fmi2Status, fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *state) {
    return status(c, lag_save(c, state));
}

FUNCTION(fmi2Status, fmi2SetFMUstate, fmi2Component c, fmi2FMUstate state) {
    return status(c, lag_restore(c, state));
}

FUNCTION(fmi2Status, fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    free(*state);
    *state = NULL;
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c, (void)state;
    *size = lag_size();
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
         size_t size) {
    (void)c, (void)size;
    lag_to_bytes(state, bytes);
    return fmi2OK;
}

FUNCTION(fmi2Status, fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte bytes[], size_t size,
         fmi2FMUstate *state) {
    return status(c, lag_from_bytes(c, bytes, size, state));
}

UNSUPPORTED(fmi2GetBoolean)
UNSUPPORTED(fmi2SetBoolean)
UNSUPPORTED(fmi2GetString)
UNSUPPORTED(fmi2SetString)
UNSUPPORTED(fmi2GetDirectionalDerivative)
UNSUPPORTED(fmi2SetRealInputDerivatives)
UNSUPPORTED(fmi2GetRealOutputDerivatives)
UNSUPPORTED(fmi2CancelStep)
UNSUPPORTED(fmi2GetStatus)
UNSUPPORTED(fmi2GetRealStatus)
UNSUPPORTED(fmi2GetIntegerStatus)
UNSUPPORTED(fmi2GetBooleanStatus)
UNSUPPORTED(fmi2GetStringStatus)
