/* FMI 2.0 co-simulation over the plant's instance: legal calls, types, memory and the logger. What the FMU
 * claims nothing of is in fmi2_unclaimed.c. */

#include <stdlib.h>
#include <string.h>

#include "fmi2_slave.h"
#include "fmi_function.h"
#include "physics.h"
#include "saved_state.h"

typedef struct {
    plant_instance plant; /* first: who has a component has its plant */
    fmi2CallbackFunctions callbacks;
    bool log_errors;
    bool log_discards;
    char name[]; /* flexible: the importer's string need not outlive the call */
} slave;

static const char ERRORS[] = "logStatusError";
static const char DISCARDS[] = "logStatusDiscard";

static void log_error(fmi2CallbackFunctions callbacks, const char *name, const char *text) {
    if (callbacks.logger != NULL) {
        callbacks.logger(callbacks.componentEnvironment, name, fmi2Error, ERRORS, "%s", text);
    }
}

static void report(void *owner, bool discarded, const char *text) {
    const slave *const s = owner;
    if (discarded && s->log_discards && s->callbacks.logger != NULL) {
        s->callbacks.logger(s->callbacks.componentEnvironment, s->name, fmi2Discard, DISCARDS, "%s", text);
    }
    if (!discarded && s->log_errors) {
        log_error(s->callbacks, s->name, text);
    }
}

static fmi2Status status(bool done) {
    return done ? fmi2OK : fmi2Error;
}

/* Of a call that may be discarded: section 2.1.3 allows it of fmi2SetXXX and fmi2DoStep. */
static fmi2Status status_of(const plant_instance *plant, bool done) {
    return !done && plant != NULL && plant_has_discarded(plant) ? fmi2Discard : status(done);
}

plant_instance *fmi2_legal(fmi2Component c, unsigned modes, const char *call) {
    slave *const s = c;
    return s != NULL && plant_allows(&s->plant, modes, call) ? &s->plant : NULL;
}

/* --- Section 2.1.4 and 2.1.5: versions, instances, logging --- */

FMI(const char *, fmi2GetTypesPlatform, void) {
    return "default";
}

FMI(const char *, fmi2GetVersion, void) {
    return "2.0";
}

FMI(fmi2Component, fmi2Instantiate, fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
    fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
    fmi2Boolean loggingOn) {
    (void)fmuResourceLocation; /* there are no resources */
    (void)visible;
    (void)loggingOn; /* turns on debug messages, of which there are none; errors are always worth a line */
    if (functions == NULL) {
        return NULL;
    }
    if (instanceName == NULL || instanceName[0] == '\0') {
        log_error(*functions, "?", "instantiate: the instance name is empty");
        return NULL;
    }
    if (fmuType != fmi2CoSimulation) {
        log_error(*functions, instanceName, "instantiate: this FMU is for co-simulation only");
        return NULL;
    }
    if (fmuGUID == NULL || strcmp(fmuGUID, MECANUM_GUID) != 0) {
        log_error(*functions, instanceName,
                  "instantiate: wrong GUID; modelDescription.xml and the binary are not of one build");
        return NULL;
    }
    const size_t name_size = strlen(instanceName) + 1;
    slave *const s = calloc(1, sizeof *s + name_size);
    if (s == NULL) {
        log_error(*functions, instanceName, "instantiate: out of memory");
        return NULL;
    }
    memcpy(s->name, instanceName, name_size);
    s->callbacks = *functions;
    s->log_errors = s->log_discards = true;
    plant_init(&s->plant, report, s);
    return s;
}

FMI(void, fmi2FreeInstance, fmi2Component c) {
    if (c != NULL) {
        physics_release(&((slave *)c)->plant);
    }
    free(c);
}

FMI(fmi2Status, fmi2SetDebugLogging, fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
    const fmi2String categories[]) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "setDebugLogging");
    if (plant == NULL) {
        return fmi2Error;
    }
    bool errors = nCategories == 0, discards = nCategories == 0;
    for (size_t i = 0; i < nCategories; i++) {
        const char *const category = categories[i] == NULL ? "" : categories[i];
        if (strcmp(category, ERRORS) != 0 && strcmp(category, DISCARDS) != 0) {
            return status(
                plant_fail(plant, "setDebugLogging: unknown category; expected %s or %s", ERRORS, DISCARDS));
        }
        errors = errors || strcmp(category, ERRORS) == 0;
        discards = discards || strcmp(category, DISCARDS) == 0;
    }
    slave *const s = c;
    s->log_errors = errors ? loggingOn != fmi2False : s->log_errors;
    s->log_discards = discards ? loggingOn != fmi2False : s->log_discards;
    return fmi2OK;
}

/* --- Section 2.1.6: initialization, termination, reset --- */

FMI(fmi2Status, fmi2SetupExperiment, fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
    fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    (void)toleranceDefined; /* the internal step is fixed */
    (void)tolerance;
    plant_instance *const plant = fmi2_legal(c, PLANT_INSTANTIATED, "setupExperiment");
    return status(plant != NULL && plant_setup(plant, startTime, stopTimeDefined != fmi2False, stopTime));
}

FMI(fmi2Status, fmi2EnterInitializationMode, fmi2Component c) {
    plant_instance *const plant = fmi2_legal(c, PLANT_INSTANTIATED, "enterInitializationMode");
    return status(plant != NULL && plant_enter_initialization(plant));
}

FMI(fmi2Status, fmi2ExitInitializationMode, fmi2Component c) {
    plant_instance *const plant = fmi2_legal(c, PLANT_INITIALIZATION, "exitInitializationMode");
    return status(plant != NULL && plant_exit_initialization(plant));
}

FMI(fmi2Status, fmi2Terminate, fmi2Component c) {
    plant_instance *const plant = fmi2_legal(c, PLANT_STEP_COMPLETE, "terminate");
    return status(plant != NULL && plant_terminate(plant));
}

FMI(fmi2Status, fmi2Reset, fmi2Component c) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "reset");
    if (plant == NULL) {
        return fmi2Error;
    }
    physics_release(plant);
    plant_init(plant, report, c);
    return fmi2OK;
}

/* --- Section 2.1.7: variables --- */

_Static_assert(sizeof(fmi2Integer) == sizeof(int32_t), "the plant keeps integers in 32 bits");

FMI(fmi2Status, fmi2GetReal, fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    plant_instance *const plant = fmi2_legal(c, FMI2_IN_GET, "getReal");
    return status(plant != NULL && plant_get(plant, PLANT_REAL, vr, nvr, value));
}

FMI(fmi2Status, fmi2GetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2Integer value[]) {
    plant_instance *const plant = fmi2_legal(c, FMI2_IN_GET, "getInteger");
    return status(plant != NULL && plant_get(plant, PLANT_INTEGER | PLANT_ENUMERATION, vr, nvr, value));
}

FMI(fmi2Status, fmi2SetReal, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Real value[]) {
    plant_instance *const plant = fmi2_legal(c, FMI2_IN_SET, "setReal");
    return status_of(plant, plant != NULL && plant_set(plant, PLANT_REAL, vr, nvr, value));
}

FMI(fmi2Status, fmi2SetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Integer value[]) {
    plant_instance *const plant = fmi2_legal(c, FMI2_IN_SET, "setInteger");
    return status_of(plant,
                     plant != NULL && plant_set(plant, PLANT_INTEGER | PLANT_ENUMERATION, vr, nvr, value));
}

/* --- Section 2.1.8: saved states --- */

FMI(fmi2Status, fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *FMUstate) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "getFMUstate");
    return status(plant != NULL && plant_save(plant, FMUstate));
}

FMI(fmi2Status, fmi2SetFMUstate, fmi2Component c, fmi2FMUstate FMUstate) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "setFMUstate");
    return status(plant != NULL && plant_restore(plant, FMUstate));
}

FMI(fmi2Status, fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *FMUstate) {
    if (fmi2_legal(c, PLANT_ANY, "freeFMUstate") == NULL) {
        return fmi2Error;
    }
    plant_forget(FMUstate);
    return fmi2OK;
}

FMI(fmi2Status, fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)FMUstate; /* every state has one size */
    if (fmi2_legal(c, PLANT_ANY, "serializedFMUstateSize") == NULL) {
        return fmi2Error;
    }
    *size = plant_serialized_size();
    return fmi2OK;
}

FMI(fmi2Status, fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
    size_t size) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "serializeFMUstate");
    return status(plant != NULL && plant_serialize(plant, FMUstate, serializedState, size));
}

FMI(fmi2Status, fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte serializedState[], size_t size,
    fmi2FMUstate *FMUstate) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, "deSerializeFMUstate");
    return status(plant != NULL && plant_deserialize(plant, serializedState, size, FMUstate));
}

/* --- Section 4.2: computing in co-simulation --- */

FMI(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real currentCommunicationPoint,
    fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    plant_instance *const plant = fmi2_legal(c, PLANT_STEP_COMPLETE, "doStep");
    return status_of(plant,
                     plant != NULL && plant_step(plant, currentCommunicationPoint, communicationStepSize));
}

FMI(fmi2Status, fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    const plant_instance *const plant = fmi2_legal(c, FMI2_IN_STATUS, "getRealStatus");
    if (plant == NULL) {
        return fmi2Error;
    }
    if (s != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = plant->now.time_s;
    return fmi2OK;
}

FMI(fmi2Status, fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    if (fmi2_legal(c, FMI2_IN_STATUS, "getBooleanStatus") == NULL) {
        return fmi2Error;
    }
    if (s != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False; /* the plant never ends a simulation by itself */
    return fmi2OK;
}
