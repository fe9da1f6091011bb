/* The functions of FMI 2.0 that modelDescription.xml claims nothing of. An FMU exports them all the same
 * (section 2.3); here each is an error, but for a status that is discarded. */

#include "fmi2_slave.h"
#include "fmi_function.h"

/* Answers a call for a feature that modelDescription.xml does not claim. */
static fmi2Status unsupported(fmi2Component c, const char *call) {
    plant_instance *const plant = fmi2_legal(c, PLANT_ANY, call);
    if (plant != NULL) {
        plant_fail(plant, "%s is not supported by this FMU", call);
    }
    return fmi2Error;
}

/* There are no Boolean or String variables: a call for none of them is fine. */
static fmi2Status none_of_this_type(fmi2Component c, unsigned modes, size_t nvr, const char *call) {
    plant_instance *const plant = fmi2_legal(c, modes, call);
    const bool done =
        plant != NULL && (nvr == 0 || plant_fail(plant, "%s: there are no variables of this type", call));
    return done ? fmi2OK : fmi2Error;
}

FMI(fmi2Status, fmi2GetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, FMI2_IN_GET, nvr, "getBoolean");
}

FMI(fmi2Status, fmi2GetString, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    fmi2String value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, FMI2_IN_GET, nvr, "getString");
}

FMI(fmi2Status, fmi2SetBoolean, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2Boolean value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, FMI2_IN_SET, nvr, "setBoolean");
}

FMI(fmi2Status, fmi2SetString, fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
    const fmi2String value[]) {
    (void)vr, (void)value;
    return none_of_this_type(c, FMI2_IN_SET, nvr, "setString");
}

/* The remaining kinds of status belong to asynchronous steps, which this FMU does not do. */

FMI(fmi2Status, fmi2GetStatus, fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    (void)s, (void)value;
    return fmi2_legal(c, FMI2_IN_STATUS, "getStatus") == NULL ? fmi2Error : fmi2Discard;
}

FMI(fmi2Status, fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    (void)s, (void)value;
    return fmi2_legal(c, FMI2_IN_STATUS, "getIntegerStatus") == NULL ? fmi2Error : fmi2Discard;
}

FMI(fmi2Status, fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    (void)s, (void)value;
    return fmi2_legal(c, FMI2_IN_STATUS, "getStringStatus") == NULL ? fmi2Error : fmi2Discard;
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
