/* FMI 3.0 co-simulation over the plant's instance: legal calls, types, memory and the logger. What the FMU
 * does not claim is in fmi3_unclaimed.c. */

#include "fmi3.h"

#include <stdlib.h>
#include <string.h>

#include "fmi3_slave.h"
#include "fmi_function.h"
#include "physics.h"
#include "saved_state.h"

typedef struct {
    plant_instance plant;
    fmi3LogMessageCallback log_message;
    fmi3InstanceEnvironment environment;
    bool log_errors;
    bool log_discards;
} slave;

static const char ERRORS[] = "logStatusError";
static const char DISCARDS[] = "logStatusDiscard";

static void report(void *owner, bool discarded, const char *text) {
    const slave *const s = owner;
    if (s->log_message != NULL && (discarded ? s->log_discards : s->log_errors)) {
        s->log_message(s->environment, discarded ? fmi3Discard : fmi3Error, discarded ? DISCARDS : ERRORS,
                       text);
    }
}

static fmi3Status status(bool done) {
    return done ? fmi3OK : fmi3Error;
}

/* Of a call that may be discarded: setting variables, and a step. */
static fmi3Status status_of(const plant_instance *plant, bool done) {
    return !done && plant != NULL && plant_has_discarded(plant) ? fmi3Discard : status(done);
}

plant_instance *fmi3_legal(fmi3Instance instance, unsigned modes, const char *call) {
    slave *const s = instance;
    return s != NULL && plant_allows(&s->plant, modes, call) ? &s->plant : NULL;
}

/* --- Section 2.2.4 and 2.3.1: version, instances, logging --- */

FMI(const char *, fmi3GetVersion, void) {
    return "3.0";
}

fmi3Instance fmi3_no_instance(fmi3LogMessageCallback log_message, fmi3InstanceEnvironment environment,
                              fmi3String text) {
    if (log_message != NULL) {
        log_message(environment, fmi3Error, ERRORS, text);
    }
    return NULL;
}

FMI(fmi3Instance, fmi3InstantiateCoSimulation, fmi3String instanceName, fmi3String instantiationToken,
    fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate) {
    (void)resourcePath; /* there are no resources */
    (void)visible;
    (void)earlyReturnAllowed; /* steps are always done whole */
    (void)requiredIntermediateVariables;
    (void)intermediateUpdate;
    if (instanceName == NULL || instanceName[strspn(instanceName, " \t\r\n")] == '\0') {
        return fmi3_no_instance(logMessage, instanceEnvironment, "instantiate: the instance name is empty");
    }
    if (instantiationToken == NULL || strcmp(instantiationToken, MECANUM_GUID) != 0) {
        return fmi3_no_instance(logMessage, instanceEnvironment,
                                "instantiate: wrong instantiation token; modelDescription.xml and the binary "
                                "are not of one build");
    }
    if (eventModeUsed) {
        return fmi3_no_instance(logMessage, instanceEnvironment,
                                "instantiate: eventModeUsed is true; this FMU has no event mode");
    }
    if (nRequiredIntermediateVariables != 0) {
        return fmi3_no_instance(logMessage, instanceEnvironment,
                                "instantiate: intermediate variables are required; this FMU has none");
    }
    slave *const s = calloc(1, sizeof *s);
    if (s == NULL) {
        return fmi3_no_instance(logMessage, instanceEnvironment, "instantiate: out of memory");
    }
    s->log_message = logMessage;
    s->environment = instanceEnvironment;
    s->log_errors = s->log_discards = loggingOn;
    plant_init(&s->plant, report, s);
    return s;
}

FMI(void, fmi3FreeInstance, fmi3Instance instance) {
    if (instance != NULL) {
        physics_release(&((slave *)instance)->plant);
    }
    free(instance);
}

FMI(fmi3Status, fmi3SetDebugLogging, fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
    const fmi3String categories[]) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3SetDebugLogging");
    if (plant == NULL) {
        return fmi3Error;
    }
    bool errors = nCategories == 0, discards = nCategories == 0;
    for (size_t i = 0; i < nCategories; i++) {
        const char *const category = categories[i] == NULL ? "" : categories[i];
        if (strcmp(category, ERRORS) != 0 && strcmp(category, DISCARDS) != 0) {
            return status(plant_fail(plant, "fmi3SetDebugLogging: unknown category; expected %s or %s",
                                     ERRORS, DISCARDS));
        }
        errors = errors || strcmp(category, ERRORS) == 0;
        discards = discards || strcmp(category, DISCARDS) == 0;
    }
    slave *const s = instance;
    s->log_errors = errors ? loggingOn : s->log_errors;
    s->log_discards = discards ? loggingOn : s->log_discards;
    return fmi3OK;
}

/* --- Section 2.3: initialization, termination, reset --- */

FMI(fmi3Status, fmi3EnterInitializationMode, fmi3Instance instance, fmi3Boolean toleranceDefined,
    fmi3Float64 tolerance, fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    (void)toleranceDefined; /* the internal step is fixed */
    (void)tolerance;
    plant_instance *const plant = fmi3_legal(instance, PLANT_INSTANTIATED, "fmi3EnterInitializationMode");
    return status(plant != NULL && plant_setup(plant, startTime, stopTimeDefined, stopTime) &&
                  plant_enter_initialization(plant));
}

FMI(fmi3Status, fmi3ExitInitializationMode, fmi3Instance instance) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_INITIALIZATION, "fmi3ExitInitializationMode");
    return status(plant != NULL && plant_exit_initialization(plant));
}

FMI(fmi3Status, fmi3Terminate, fmi3Instance instance) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_STEP_COMPLETE, "fmi3Terminate");
    return status(plant != NULL && plant_terminate(plant));
}

FMI(fmi3Status, fmi3Reset, fmi3Instance instance) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3Reset");
    if (plant == NULL) {
        return fmi3Error;
    }
    physics_release(plant);
    plant_init(plant, report, instance);
    return fmi3OK;
}

/* --- Section 2.2.6: variables, which are all scalar: one value for each reference --- */

static plant_instance *scalars(fmi3Instance instance, unsigned modes, const char *call,
                               size_t nValueReferences, size_t nValues) {
    plant_instance *const plant = fmi3_legal(instance, modes, call);
    if (plant != NULL && nValues != nValueReferences) {
        plant_fail(plant, "%s: %zu values; expected %zu, one for each variable", call, nValues,
                   nValueReferences);
        return NULL;
    }
    return plant;
}

FMI(fmi3Status, fmi3GetFloat64, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3Float64 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_GET, "fmi3GetFloat64", nValueReferences, nValues);
    return status(plant != NULL && plant_get(plant, PLANT_REAL, valueReferences, nValueReferences, values));
}

FMI(fmi3Status, fmi3SetFloat64, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Float64 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_SET, "fmi3SetFloat64", nValueReferences, nValues);
    return status_of(plant, plant != NULL &&
                                plant_set(plant, PLANT_REAL, valueReferences, nValueReferences, values));
}

FMI(fmi3Status, fmi3GetInt32, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3Int32 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_GET, "fmi3GetInt32", nValueReferences, nValues);
    return status(plant != NULL &&
                  plant_get(plant, PLANT_INTEGER, valueReferences, nValueReferences, values));
}

FMI(fmi3Status, fmi3SetInt32, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Int32 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_SET, "fmi3SetInt32", nValueReferences, nValues);
    return status_of(plant, plant != NULL &&
                                plant_set(plant, PLANT_INTEGER, valueReferences, nValueReferences, values));
}

/* Enumerations travel in 64 bits; the plant keeps them in 32. */

FMI(fmi3Status, fmi3GetInt64, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, fmi3Int64 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_GET, "fmi3GetInt64", nValueReferences, nValues);
    if (plant == NULL) {
        return fmi3Error;
    }
    for (size_t i = 0; i < nValueReferences; i++) {
        int32_t item;
        if (!plant_get(plant, PLANT_ENUMERATION, &valueReferences[i], 1, &item)) {
            return fmi3Error;
        }
        values[i] = item;
    }
    return fmi3OK;
}

FMI(fmi3Status, fmi3SetInt64, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const fmi3Int64 values[], size_t nValues) {
    plant_instance *const plant = scalars(instance, FMI3_IN_SET, "fmi3SetInt64", nValueReferences, nValues);
    if (plant == NULL) {
        return fmi3Error;
    }
    /* All are looked at before the first is set: a call that is discarded has set none. */
    for (size_t i = 0; i < nValueReferences; i++) {
        const int32_t item = (int32_t)values[i];
        if (item != values[i]) {
            return status_of(plant, plant_discard(plant, "fmi3SetInt64: %lld is no item of an enumeration",
                                                  (long long)values[i]));
        }
        if (!plant_may_set(plant, PLANT_ENUMERATION, &valueReferences[i], 1, &item)) {
            return status_of(plant, false);
        }
    }
    for (size_t i = 0; i < nValueReferences; i++) {
        const int32_t item = (int32_t)values[i];
        plant_set(plant, PLANT_ENUMERATION, &valueReferences[i], 1, &item);
    }
    return fmi3OK;
}

/* --- Section 2.2: saved states --- */

FMI(fmi3Status, fmi3GetFMUState, fmi3Instance instance, fmi3FMUState *FMUState) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3GetFMUState");
    return status(plant != NULL && plant_save(plant, FMUState));
}

FMI(fmi3Status, fmi3SetFMUState, fmi3Instance instance, fmi3FMUState FMUState) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3SetFMUState");
    return status(plant != NULL && plant_restore(plant, FMUState));
}

FMI(fmi3Status, fmi3FreeFMUState, fmi3Instance instance, fmi3FMUState *FMUState) {
    if (fmi3_legal(instance, PLANT_ANY, "fmi3FreeFMUState") == NULL) {
        return fmi3Error;
    }
    plant_forget(FMUState);
    return fmi3OK;
}

FMI(fmi3Status, fmi3SerializedFMUStateSize, fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    (void)FMUState; /* every state has one size */
    if (fmi3_legal(instance, PLANT_ANY, "fmi3SerializedFMUStateSize") == NULL) {
        return fmi3Error;
    }
    *size = plant_serialized_size();
    return fmi3OK;
}

FMI(fmi3Status, fmi3SerializeFMUState, fmi3Instance instance, fmi3FMUState FMUState,
    fmi3Byte serializedState[], size_t size) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3SerializeFMUState");
    return status(plant != NULL && plant_serialize(plant, FMUState, serializedState, size));
}

FMI(fmi3Status, fmi3DeserializeFMUState, fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
    fmi3FMUState *FMUState) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, "fmi3DeserializeFMUState");
    return status(plant != NULL && plant_deserialize(plant, serializedState, size, FMUState));
}

/* --- Section 4.2.1: step mode --- */

FMI(fmi3Status, fmi3DoStep, fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
    fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
    fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
    fmi3Float64 *lastSuccessfulTime) {
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    plant_instance *const plant = fmi3_legal(instance, PLANT_STEP_COMPLETE, "fmi3DoStep");
    if (plant == NULL) {
        return fmi3Error;
    }
    const bool done = plant_step(plant, currentCommunicationPoint, communicationStepSize);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False; /* the plant never ends a simulation by itself */
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = plant->now.time_s;
    return status_of(plant, done);
}
