/* The functions of FMI 3.0 that modelDescription.xml claims nothing of. An FMU exports them all the same
 * (section 2.5); here each is an error with a message that says what this FMU has not. */

#include "fmi3_slave.h"
#include "fmi_function.h"

#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter" /* nearly every one in this file is */
#endif

static fmi3Status unclaimed(fmi3Instance instance, const char *call, const char *lack) {
    plant_instance *const plant = fmi3_legal(instance, PLANT_ANY, call);
    if (plant != NULL) {
        plant_fail(plant, "%s: %s", call, lack);
    }
    return fmi3Error;
}

#define UNCLAIMED(name, lack, ...)                                                                           \
    FMI(fmi3Status, fmi3##name, __VA_ARGS__) {                                                               \
        return unclaimed(instance, "fmi3" #name, lack);                                                      \
    }

/* --- Section 2.3.1: other kinds of instances --- */

static const char ONLY[] = "instantiate: this FMU is for co-simulation only";

FMI(fmi3Instance, fmi3InstantiateModelExchange, fmi3String instanceName, fmi3String instantiationToken,
    fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage) {
    return fmi3_no_instance(logMessage, instanceEnvironment, ONLY);
}

FMI(fmi3Instance, fmi3InstantiateScheduledExecution, fmi3String instanceName, fmi3String instantiationToken,
    fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption) {
    return fmi3_no_instance(logMessage, instanceEnvironment, ONLY);
}

/* --- Section 2.2.6: types that no variable has. As in any type, a call for no variables is fine. --- */

static fmi3Status none(fmi3Instance instance, unsigned modes, const char *call, size_t count) {
    if (count > 0) {
        return unclaimed(instance, call, "there are no variables of this type");
    }
    return fmi3_legal(instance, modes, call) == NULL ? fmi3Error : fmi3OK;
}

#define NO_VARIABLES_OF(type)                                                                                \
    FMI(fmi3Status, fmi3Get##type, fmi3Instance instance, const fmi3ValueReference valueReferences[],        \
        size_t nValueReferences, fmi3##type values[], size_t nValues) {                                      \
        return none(instance, FMI3_IN_GET, "fmi3Get" #type, nValueReferences);                               \
    }                                                                                                        \
    FMI(fmi3Status, fmi3Set##type, fmi3Instance instance, const fmi3ValueReference valueReferences[],        \
        size_t nValueReferences, const fmi3##type values[], size_t nValues) {                                \
        return none(instance, FMI3_IN_SET, "fmi3Set" #type, nValueReferences);                               \
    }

NO_VARIABLES_OF(Float32)
NO_VARIABLES_OF(Int8)
NO_VARIABLES_OF(UInt8)
NO_VARIABLES_OF(Int16)
NO_VARIABLES_OF(UInt16)
NO_VARIABLES_OF(UInt32)
NO_VARIABLES_OF(UInt64)
NO_VARIABLES_OF(Boolean)
NO_VARIABLES_OF(String)

FMI(fmi3Status, fmi3GetBinary, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, size_t valueSizes[], fmi3Binary values[], size_t nValues) {
    return none(instance, FMI3_IN_GET, "fmi3GetBinary", nValueReferences);
}

FMI(fmi3Status, fmi3SetBinary, fmi3Instance instance, const fmi3ValueReference valueReferences[],
    size_t nValueReferences, const size_t valueSizes[], const fmi3Binary values[], size_t nValues) {
    return none(instance, FMI3_IN_SET, "fmi3SetBinary", nValueReferences);
}

/* --- Section 2.2: dependencies of array elements, derivatives --- */

#define NO_DERIVATIVES "this FMU provides no derivatives"
#define NO_DEPENDENCIES "there are no arrays; modelDescription.xml has the dependencies"

UNCLAIMED(GetNumberOfVariableDependencies, NO_DEPENDENCIES, fmi3Instance instance,
          fmi3ValueReference valueReference, size_t *nDependencies)
UNCLAIMED(GetVariableDependencies, NO_DEPENDENCIES, fmi3Instance instance, fmi3ValueReference dependent,
          size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
          size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[], size_t nDependencies)
UNCLAIMED(GetDirectionalDerivative, NO_DERIVATIVES, fmi3Instance instance,
          const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
          size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
          size_t nSensitivity)
UNCLAIMED(GetAdjointDerivative, NO_DERIVATIVES, fmi3Instance instance, const fmi3ValueReference unknowns[],
          size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
          size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
UNCLAIMED(GetOutputDerivatives, NO_DERIVATIVES, fmi3Instance instance,
          const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int32 orders[],
          fmi3Float64 values[], size_t nValues)

/* --- Section 2.3: configuration and reconfiguration mode, which only structural parameters allow --- */

#define NO_STRUCTURE "there are no structural parameters"

UNCLAIMED(EnterConfigurationMode, NO_STRUCTURE, fmi3Instance instance)
UNCLAIMED(ExitConfigurationMode, NO_STRUCTURE, fmi3Instance instance)

/* --- Section 2.3.5: event mode, and with it clocks --- */

#define NO_EVENTS "this FMU has no event mode"
#define NO_CLOCKS "this FMU has no clocks"

UNCLAIMED(EnterEventMode, NO_EVENTS, fmi3Instance instance)
UNCLAIMED(EnterStepMode, NO_EVENTS, fmi3Instance instance)
UNCLAIMED(EvaluateDiscreteStates, NO_EVENTS, fmi3Instance instance)
UNCLAIMED(UpdateDiscreteStates, NO_EVENTS, fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
          fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
          fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
          fmi3Float64 *nextEventTime)
UNCLAIMED(GetClock, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3Clock values[])
UNCLAIMED(SetClock, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3Clock values[])
UNCLAIMED(GetIntervalDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
UNCLAIMED(GetIntervalFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
          fmi3IntervalQualifier qualifiers[])
UNCLAIMED(GetShiftDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3Float64 shifts[])
UNCLAIMED(GetShiftFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
UNCLAIMED(SetIntervalDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3Float64 intervals[])
UNCLAIMED(SetIntervalFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
UNCLAIMED(SetShiftDecimal, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3Float64 shifts[])
UNCLAIMED(SetShiftFraction, NO_CLOCKS, fmi3Instance instance, const fmi3ValueReference valueReferences[],
          size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

/* --- Sections 3 and 5: model exchange and scheduled execution --- */

#define NOT_HERE "this FMU is for co-simulation only"

UNCLAIMED(EnterContinuousTimeMode, NOT_HERE, fmi3Instance instance)
UNCLAIMED(CompletedIntegratorStep, NOT_HERE, fmi3Instance instance,
          fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *enterEventMode,
          fmi3Boolean *terminateSimulation)
UNCLAIMED(SetTime, NOT_HERE, fmi3Instance instance, fmi3Float64 time)
UNCLAIMED(SetContinuousStates, NOT_HERE, fmi3Instance instance, const fmi3Float64 continuousStates[],
          size_t nContinuousStates)
UNCLAIMED(GetContinuousStateDerivatives, NOT_HERE, fmi3Instance instance, fmi3Float64 derivatives[],
          size_t nContinuousStates)
UNCLAIMED(GetEventIndicators, NOT_HERE, fmi3Instance instance, fmi3Float64 eventIndicators[],
          size_t nEventIndicators)
UNCLAIMED(GetContinuousStates, NOT_HERE, fmi3Instance instance, fmi3Float64 continuousStates[],
          size_t nContinuousStates)
UNCLAIMED(GetNominalsOfContinuousStates, NOT_HERE, fmi3Instance instance, fmi3Float64 nominals[],
          size_t nContinuousStates)
UNCLAIMED(GetNumberOfEventIndicators, NOT_HERE, fmi3Instance instance, size_t *nEventIndicators)
UNCLAIMED(GetNumberOfContinuousStates, NOT_HERE, fmi3Instance instance, size_t *nContinuousStates)
UNCLAIMED(ActivateModelPartition, NOT_HERE, fmi3Instance instance, fmi3ValueReference clockReference,
          fmi3Float64 activationTime)
