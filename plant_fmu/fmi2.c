/* FMI 2.0 co-simulation over the plant's instance: legal calls, types, memory and the logger. */

#include "fmi2.h"

#include <stdlib.h>
#include <string.h>

#include "fmi_function.h"
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

/* Where each call is legal: FMI 2.0 section 4.2.4, the table of the state machine. */
enum {
    IN_SET = PLANT_INSTANTIATED | PLANT_INITIALIZATION | PLANT_STEP_COMPLETE,
    IN_GET = PLANT_INITIALIZATION | PLANT_STEP_COMPLETE | PLANT_TERMINATED | PLANT_ERROR,
    IN_STATUS = PLANT_STEP_COMPLETE | PLANT_TERMINATED | PLANT_ERROR,
};

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

/* Returns the plant when the call is legal, else NULL. */
static plant_instance *legal(fmi2Component c, unsigned modes, const char *call) {
    slave *const s = c;
    return s != NULL && plant_allows(&s->plant, modes, call) ? &s->plant : NULL;
}

/* Answers a call for a feature that modelDescription.xml does not claim. */
static fmi2Status unsupported(fmi2Component c, const char *call) {
    plant_instance *const plant = legal(c, PLANT_ANY, call);
    return plant == NULL ? fmi2Error : status(plant_fail(plant, "%s is not supported by this FMU", call));
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
        plant_release(&((slave *)c)->plant);
    }
    free(c);
}

FMI(fmi2Status, fmi2SetDebugLogging, fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
    const fmi2String categories[]) {
    plant_instance *const plant = legal(c, PLANT_ANY, "setDebugLogging");
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
    plant_instance *const plant = legal(c, PLANT_INSTANTIATED, "setupExperiment");
    return status(plant != NULL && plant_setup(plant, startTime, stopTimeDefined != fmi2False, stopTime));
}

FMI(fmi2Status, fmi2EnterInitializationMode, fmi2Component c) {
    plant_instance *const plant = legal(c, PLANT_INSTANTIATED, "enterInitializationMode");
    return status(plant != NULL && plant_enter_initialization(plant));
}

FMI(fmi2Status, fmi2ExitInitializationMode, fmi2Component c) {
    plant_instance *const plant = legal(c, PLANT_INITIALIZATION, "exitInitializationMode");
    return status(plant != NULL && plant_exit_initialization(plant));
}

FMI(fmi2Status, fmi2Terminate, fmi2Component c) {
    plant_instance *const plant = legal(c, PLANT_STEP_COMPLETE, "terminate");
    return status(plant != NULL && plant_terminate(plant));
}

FMI(fmi2Status, fmi2Reset, fmi2Component c) {
    plant_instance *const plant = legal(c, PLANT_ANY, "reset");
    if (plant == NULL) {
        return fmi2Error;
    }
    plant_release(plant);
    plant_init(plant, report, c);
    return fmi2OK;
}

/* --- Section 2.1.7: variables --- */

_Static_assert(sizeof(fmi2Integer) == sizeof(int32_t), "the plant keeps integers in 32 bits");

FMI(fmi2Status, fmi2GetReal, fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    plant_instance *const plant = legal(c, IN_GET, "getReal");
    return status(plant != NULL && plant_get(plant, PLANT_REAL, vr, nvr, value));
}

FMI(fmi2Status, fmi2GetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2Integer value[]) {
    plant_instance *const plant = legal(c, IN_GET, "getInteger");
    return status(plant != NULL && plant_get(plant, PLANT_INTEGER | PLANT_ENUMERATION, vr, nvr, value));
}

FMI(fmi2Status, fmi2SetReal, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Real value[]) {
    plant_instance *const plant = legal(c, IN_SET, "setReal");
    return status_of(plant, plant != NULL && plant_set(plant, PLANT_REAL, vr, nvr, value));
}

FMI(fmi2Status, fmi2SetInteger, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Integer value[]) {
    plant_instance *const plant = legal(c, IN_SET, "setInteger");
    return status_of(plant,
                     plant != NULL && plant_set(plant, PLANT_INTEGER | PLANT_ENUMERATION, vr, nvr, value));
}

/* There are no Boolean or String variables: a call for none of them is fine. */
static fmi2Status none_of_this_type(fmi2Component c, unsigned modes, size_t nvr, const char *call) {
    plant_instance *const plant = legal(c, modes, call);
    return status(plant != NULL &&
                  (nvr == 0 || plant_fail(plant, "%s: there are no variables of this type", call)));
}

FMI(fmi2Status, fmi2GetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, IN_GET, nvr, "getBoolean");
}

FMI(fmi2Status, fmi2GetString, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2String value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, IN_GET, nvr, "getString");
}

FMI(fmi2Status, fmi2SetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, IN_SET, nvr, "setBoolean");
}

FMI(fmi2Status, fmi2SetString, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2String value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, IN_SET, nvr, "setString");
}

/* --- Section 2.1.8: saved states --- */

FMI(fmi2Status, fmi2GetFMUstate, fmi2Component c, fmi2FMUstate *FMUstate) {
    plant_instance *const plant = legal(c, PLANT_ANY, "getFMUstate");
    return status(plant != NULL && plant_save(plant, FMUstate));
}

FMI(fmi2Status, fmi2SetFMUstate, fmi2Component c, fmi2FMUstate FMUstate) {
    plant_instance *const plant = legal(c, PLANT_ANY, "setFMUstate");
    return status(plant != NULL && plant_restore(plant, FMUstate));
}

FMI(fmi2Status, fmi2FreeFMUstate, fmi2Component c, fmi2FMUstate *FMUstate) {
    if (legal(c, PLANT_ANY, "freeFMUstate") == NULL) {
        return fmi2Error;
    }
    plant_forget(FMUstate);
    return fmi2OK;
}

FMI(fmi2Status, fmi2SerializedFMUstateSize, fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    (void)FMUstate; /* every state has one size */
    if (legal(c, PLANT_ANY, "serializedFMUstateSize") == NULL) {
        return fmi2Error;
    }
    *size = plant_serialized_size();
    return fmi2OK;
}

FMI(fmi2Status, fmi2SerializeFMUstate, fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
    size_t size) {
    plant_instance *const plant = legal(c, PLANT_ANY, "serializeFMUstate");
    return status(plant != NULL && plant_serialize(plant, FMUstate, serializedState, size));
}

FMI(fmi2Status, fmi2DeSerializeFMUstate, fmi2Component c, const fmi2Byte serializedState[], size_t size,
    fmi2FMUstate *FMUstate) {
    plant_instance *const plant = legal(c, PLANT_ANY, "deSerializeFMUstate");
    return status(plant != NULL && plant_deserialize(plant, serializedState, size, FMUstate));
}

/* --- Section 4.2: computing in co-simulation --- */

FMI(fmi2Status, fmi2DoStep, fmi2Component c, fmi2Real currentCommunicationPoint,
    fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    plant_instance *const plant = legal(c, PLANT_STEP_COMPLETE, "doStep");
    return status_of(plant,
                     plant != NULL && plant_step(plant, currentCommunicationPoint, communicationStepSize));
}

FMI(fmi2Status, fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    const plant_instance *const plant = legal(c, IN_STATUS, "getRealStatus");
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
    if (legal(c, IN_STATUS, "getBooleanStatus") == NULL) {
        return fmi2Error;
    }
    if (s != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False; /* the plant never ends a simulation by itself */
    return fmi2OK;
}

/* The remaining kinds of status belong to asynchronous steps, which this FMU does not do. */

FMI(fmi2Status, fmi2GetStatus, fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)s, (void)value;
    return legal(c, IN_STATUS, "getStatus") == NULL ? fmi2Error : fmi2Discard;
}

FMI(fmi2Status, fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    (void)s, (void)value;
    return legal(c, IN_STATUS, "getIntegerStatus") == NULL ? fmi2Error : fmi2Discard;
}

FMI(fmi2Status, fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    (void)s, (void)value;
    return legal(c, IN_STATUS, "getStringStatus") == NULL ? fmi2Error : fmi2Discard;
}

FMI(fmi2Status, fmi2CancelStep, fmi2Component c) {
    return unsupported(c, "cancelStep");
}

FMI(fmi2Status, fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr, (void)nvr, (void)order, (void)value;
    return unsupported(c, "setRealInputDerivatives");
}

FMI(fmi2Status, fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)nvr, (void)order, (void)value;
    return unsupported(c, "getRealOutputDerivatives");
}

FMI(fmi2Status, fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference vUnknown_ref[],
    size_t nUnknown, const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
    fmi2Real dvUnknown[]) {
    (void)vUnknown_ref, (void)nUnknown, (void)vKnown_ref, (void)nKnown, (void)dvKnown, (void)dvUnknown;
    return unsupported(c, "getDirectionalDerivative");
}
