/* The robot of wheels.h for FMI 2.0, co-simulation.
 *
 * Value references: 0-3 torques, 4-7 angles in degrees, 8 x, 9 y, 10 heading, 11-14 speeds, 20 inertia, 23
 * fault time, 25 grain (Real); 30-33 counts, 34 fault, 35 gear (Integer); 40 reversed (Boolean); 50 label. */
#include "wheels.h"

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(void *, int);
    void *environment;
} callbacks;

typedef struct {
    wheels now;
    callbacks call;
} slave;

static int say(const slave *s, int status) {
    s->call.logger(s->call.environment, "wheels", status, "logStatusError", "%s at %g s", "wheel 1 fell off",
                   s->now.time_s);
    return status;
}

EXPORT void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                             const callbacks *call, int visible, int logging_on) {
    (void)name, (void)type, (void)resources, (void)visible, (void)logging_on;
    if (strcmp(guid, GUID) != 0) {
        call->logger(call->environment, "wheels", ERROR, "logStatusError", "wrong GUID %s", guid);
        return NULL;
    }
    slave *const s = call->allocate(1, sizeof *s);
    wheels_init(&s->now);
    s->call = *call;
    return s;
}

EXPORT void fmi2FreeInstance(void *c) {
    slave *const s = c;
    if (is_faulty(&s->now, SAY_FATAL)) {
        abort(); /* nothing may be called any more */
    }
    s->call.release(s);
}

EXPORT int fmi2SetupExperiment(void *c, int tolerance_defined, double tolerance, double start_s,
                               int stop_defined, double stop_s) {
    (void)tolerance_defined, (void)tolerance, (void)stop_defined, (void)stop_s;
    slave *const s = c;
    s->now.time_s = start_s;
    return s->now.fault == REFUSE_TO_BEGIN ? say(s, ERROR) : OK;
}

EXPORT int fmi2SetDebugLogging(void *c, int on, size_t count, const char *const categories[]) {
    (void)c, (void)on;
    return count == 1 && strcmp(categories[0], "logStatusError") == 0 ? OK : ERROR;
}

EXPORT int fmi2EnterInitializationMode(void *c) {
    const slave *const s = c;
    return s->now.fault == FAIL_AT_INITIALIZATION ? say(s, ERROR) : OK;
}

EXPORT int fmi2ExitInitializationMode(void *c) {
    ((slave *)c)->now.initialised = true;
    return OK;
}

EXPORT int fmi2Terminate(void *c) {
    (void)c;
    return OK;
}

EXPORT int fmi2Reset(void *c) {
    slave *const s = c;
    if (s->now.fault == FAIL_TO_RESET) {
        return say(s, ERROR);
    }
    wheels_reset(&s->now);
    return OK;
}

static double *real(slave *s, unsigned reference) {
    wheels *const w = &s->now;
    switch (reference) {
    case 20:
        return &w->inertia_kg_m2;
    case 23:
        return &w->fault_time_s;
    case 25:
        return &w->grain_s;
    default:
        return reference < 4 ? &w->torque_n_cm[reference] : NULL;
    }
}

EXPORT int fmi2SetReal(void *c, const unsigned *reference, size_t n, const double *value) {
    for (size_t i = 0; i < n; i++) {
        if (real(c, reference[i]) == NULL) {
            return ERROR;
        }
        *real(c, reference[i]) = value[i];
    }
    return OK;
}

EXPORT int fmi2GetReal(void *c, const unsigned *reference, size_t n, double *value) {
    slave *const s = c;
    const wheels *const w = &s->now;
    if (is_faulty(w, FAIL_TO_READ)) {
        return ERROR;
    }
    for (size_t i = 0; i < n; i++) {
        const unsigned r = reference[i];
        if (r >= 4 && r < 8) {
            value[i] = w->angle_rad[r - 4] * 180.0 / PI;
        } else if (r >= 11 && r < 15) {
            value[i] = w->speed_rad_s[r - 11];
        } else if (r >= 8 && r <= 10) {
            value[i] = r == 8 ? x_m(w) : r == 9 ? y_m(w) : heading_deg(w);
        } else if (real(s, r) != NULL) {
            value[i] = *real(s, r);
        } else {
            return ERROR;
        }
    }
    return OK;
}

EXPORT int fmi2SetInteger(void *c, const unsigned *reference, size_t n, const int *value) {
    wheels *const w = &((slave *)c)->now;
    for (size_t i = 0; i < n; i++) {
        *(reference[i] == 34 ? &w->fault : &w->gear) = value[i];
    }
    return OK;
}

EXPORT int fmi2GetInteger(void *c, const unsigned *reference, size_t n, int *value) {
    const wheels *const w = &((slave *)c)->now;
    for (size_t i = 0; i < n; i++) {
        value[i] = reference[i] == 34   ? w->fault
                   : reference[i] == 35 ? w->gear
                                        : (int)count(w, (int)reference[i] - 30);
    }
    return OK;
}

EXPORT int fmi2SetBoolean(void *c, const unsigned *reference, size_t n, const int *value) {
    (void)reference, (void)n;
    ((slave *)c)->now.reversed = value[0] != 0;
    return OK;
}

EXPORT int fmi2SetString(void *c, const unsigned *reference, size_t n, const char *const value[]) {
    (void)reference, (void)n;
    slave *const s = c;
    if (strlen(value[0]) >= sizeof s->now.label) {
        return say(s, ERROR);
    }
    strcpy(s->now.label, value[0]);
    return OK;
}

EXPORT int fmi2GetString(void *c, const unsigned *reference, size_t n, const char *value[]) {
    (void)reference, (void)n;
    value[0] = ((slave *)c)->now.label;
    return OK;
}

EXPORT int fmi2DoStep(void *c, double from_s, double step_s, int no_set_state) {
    slave *const s = c;
    (void)no_set_state;
    if (fabs(from_s - s->now.time_s) > 1e-9 || !takes(&s->now, step_s)) {
        return ERROR;
    }
    wheels_step(&s->now, step_s);
    static const int FAULTS[][2] = {
        {SAY_ERROR, ERROR}, {SAY_DISCARD, DISCARD}, {SAY_FATAL, FATAL}, {SAY_WARNING, WARNING}};
    for (size_t i = 0; i < sizeof FAULTS / sizeof *FAULTS; i++) {
        if (is_faulty(&s->now, FAULTS[i][0])) {
            return say(s, FAULTS[i][1]);
        }
    }
    if (is_faulty(&s->now, END)) {
        return DISCARD;
    }
    return is_faulty(&s->now, RETURN_PENDING) ? PENDING : is_faulty(&s->now, SILENT_ERROR) ? ERROR : OK;
}

EXPORT int fmi2GetBooleanStatus(void *c, int kind, int *value) {
    *value = kind == 3 && is_faulty(&((slave *)c)->now, END);
    return OK;
}

STUB(fmi2GetTypesPlatform)
STUB(fmi2GetVersion)
STUB(fmi2GetBoolean)
STUB(fmi2GetFMUstate)
STUB(fmi2SetFMUstate)
STUB(fmi2FreeFMUstate)
STUB(fmi2SerializedFMUstateSize)
STUB(fmi2SerializeFMUstate)
STUB(fmi2DeSerializeFMUstate)
STUB(fmi2GetDirectionalDerivative)
STUB(fmi2SetRealInputDerivatives)
STUB(fmi2GetRealOutputDerivatives)
STUB(fmi2CancelStep)
STUB(fmi2GetStatus)
STUB(fmi2GetRealStatus)
STUB(fmi2GetIntegerStatus)
STUB(fmi2GetStringStatus)
