"""The FMI 2.0 interface, call by call through FMPy: legal order, variables, saved states, time."""

import math
from collections.abc import Callable

import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Slave

from tests.plant_testbed import (
    DESCRIPTION,
    MOTION,
    REFERENCE,
    TORQUES,
    initialise,
    last_successful_time_s,
    slave,
)

TORQUE, MASS, X = TORQUES[0], REFERENCE["mass_kg"], REFERENCE["pose.x_m"]
COUNT, CORIOLIS = REFERENCE["wheel.fl.count"], REFERENCE["coriolis"]


def drive(fmu: FMU2Slave, first: int, last: int) -> list[list[float]]:
    rows = []
    for n in range(first, last):
        fmu.setReal(TORQUES, [0.1 * (n % 7), -0.2, 0.3, 0.05 * (n % 3)])
        fmu.doStep(n / 1000, 1e-3)
        rows.append(fmu.getReal(MOTION))
    return rows


# Each call and the states in which it is legal:
# i instantiated, n initialization mode, s step complete, t terminated, e error.
CALLS: dict[str, tuple[str, Callable[[FMU2Slave], object]]] = {
    "setupExperiment": ("i", lambda f: f.setupExperiment(startTime=0.0)),
    "enterInitializationMode": ("i", lambda f: f.enterInitializationMode()),
    "exitInitializationMode": ("n", lambda f: f.exitInitializationMode()),
    "terminate": ("s", lambda f: f.terminate()),
    "reset": ("inste", lambda f: f.reset()),
    "setDebugLogging": ("inste", lambda f: f.setDebugLogging(True, ["logStatusError"])),
    "getReal": ("nste", lambda f: f.getReal([X])),
    "getInteger": ("nste", lambda f: f.getInteger([COUNT])),
    "getBoolean": ("nste", lambda f: f.getBoolean([])),
    "getString": ("nste", lambda f: f.getString([])),
    "setReal": ("ins", lambda f: f.setReal([TORQUE], [0.5])),
    "setInteger": ("in", lambda f: f.setInteger([CORIOLIS], [2])),
    "setBoolean": ("ins", lambda f: f.setBoolean([], [])),
    "setString": ("ins", lambda f: f.setString([], [])),
    "doStep": ("s", lambda f: f.doStep(0.0, 1e-3)),
    "getFMUstate": ("inste", lambda f: f.freeFMUstate(f.getFMUstate())),
    "getRealStatus": ("ste", last_successful_time_s),
}
STATES: dict[str, Callable[[FMU2Slave], object]] = {
    "i": lambda f: f.setupExperiment(startTime=0.0),
    "n": lambda f: (f.setupExperiment(startTime=0.0), f.enterInitializationMode()),
    "s": lambda f: initialise(f, {}),
    "t": lambda f: (initialise(f, {}), f.terminate()),
    "e": lambda f: (initialise(f, {}), refused(lambda: f.doStep(0.0, -1.0))),
}


def refused(call: Callable[[], object]) -> None:
    with pytest.raises(FMICallException) as caught:
        call()
    assert caught.value.status == 3, "fmi2Error"


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("call", CALLS)
def test_calling_order(call: str, state: str) -> None:
    """Every call in every state is done or refused as section 4.2.4 of the standard has it."""
    legal, action = CALLS[call]
    with slave(initialised=False) as fmu:
        STATES[state](fmu)
        if state in legal:
            action(fmu)
        else:
            refused(lambda: action(fmu))


def test_set_up_comes_before_initialization() -> None:
    with slave(initialised=False) as fmu:
        refused(fmu.enterInitializationMode)


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("unknown reference", lambda f: f.getReal([9999])),
        ("integer read as real", lambda f: f.getReal([COUNT])),
        ("real read as integer", lambda f: f.getInteger([X])),
        ("an output is set", lambda f: f.setReal([X], [1.0])),
        ("a parameter is set after initialization", lambda f: f.setReal([MASS], [1.0])),
        ("not a number", lambda f: f.setReal([TORQUE], [math.nan])),
        ("infinite", lambda f: f.setReal([TORQUE], [-math.inf])),
        ("a Boolean", lambda f: f.getBoolean([X])),
        ("a String", lambda f: f.setString([X], ["1"])),
        ("an unknown log category", lambda f: f.setDebugLogging(True, ["logEverything"])),
        ("input derivatives", lambda f: f.setRealInputDerivatives([TORQUE], [1], [0.0])),
        ("output derivatives", lambda f: f.getRealOutputDerivatives([X], [1])),
        ("directional derivatives", lambda f: f.getDirectionalDerivative([X], [TORQUE], [1.0])),
        ("cancelling a step", lambda f: f.fmi2CancelStep(f.component)),
        ("a step of zero", lambda f: f.doStep(0.0, 0.0)),
        ("a step back", lambda f: f.doStep(0.0, -1e-3)),
        ("a step that is no number", lambda f: f.doStep(0.0, math.nan)),
        ("a step of a year", lambda f: f.doStep(0.0, 3.15e7)),
        ("a step from elsewhere", lambda f: f.doStep(0.5, 1e-3)),
        ("a damaged state", lambda f: f.deSerializeFMUstate(damaged(f))),
        ("a cut state", lambda f: f.deSerializeFMUstate(serialised(f)[:-1])),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_wrong_calls_are_refused(name: str, call: Callable[[FMU2Slave], object]) -> None:
    """They are errors, after which values can be read and a reset starts afresh."""
    with slave() as fmu:
        first = drive(fmu, 0, 3)
        fmu.reset()
        initialise(fmu, {})
        refused(lambda: call(fmu))
        fmu.getReal(MOTION)
        refused(lambda: fmu.doStep(0.0, 1e-3))
        fmu.reset()
        initialise(fmu, {})
        assert drive(fmu, 0, 3) == first


@pytest.mark.parametrize(("name", "value"), [("mass_kg", 0.0), ("half_width_m", 11.0), ("wheel_radius_m", -0.1)])
def test_a_parameter_out_of_its_range_is_refused(name: str, value: float) -> None:
    with slave(initialised=False) as fmu:
        refused(lambda: fmu.setReal([REFERENCE[name]], [value]))


def test_a_wrong_guid_is_refused() -> None:
    with slave() as fmu:
        fmu.guid = "{00000000-0000-0000-0000-000000000000}"
        component = fmu.component
        with pytest.raises(Exception, match="Failed to instantiate"):
            fmu.instantiate()
        fmu.component = component


def test_start_values_show_in_initialization_mode() -> None:
    with slave(initialised=False) as fmu:
        fmu.setupExperiment(startTime=0.0)
        fmu.enterInitializationMode()
        assert fmu.getReal([X]) == [0.0]
        fmu.setReal([REFERENCE["start_x_m"]], [1.25])
        assert fmu.getReal([X]) == [1.25]
        fmu.exitInitializationMode()
        assert fmu.getReal([X]) == [1.25]


def test_start_values_of_the_description_are_those_of_the_binary() -> None:
    with slave() as fmu:
        for variable in DESCRIPTION.modelVariables:
            if variable.start is not None:
                read = fmu.getReal if variable.type == "Real" else fmu.getInteger
                assert read([variable.valueReference]) == [float(variable.start)], variable.name


def test_the_current_follows_the_torque_at_once() -> None:
    """The only direct feedthrough, as ModelStructure says."""
    current = REFERENCE["wheel.rl.current_a"]
    with slave({"torque_constant_n_m_a": 0.5}) as fmu:
        fmu.setReal([REFERENCE["wheel.rl.torque_n_m"]], [2.0])
        assert fmu.getReal([current]) == [4.0]
    index = {u.variable.name: [d.name for d in u.dependencies] for u in DESCRIPTION.outputs}
    assert index["wheel.rl.current_a"] == ["wheel.rl.torque_n_m"]
    assert sum(bool(dependencies) for dependencies in index.values()) == 4


def serialised(fmu: FMU2Slave) -> bytes:
    state = fmu.getFMUstate()
    try:
        return fmu.serializeFMUstate(state)
    finally:
        fmu.freeFMUstate(state)


def damaged(fmu: FMU2Slave) -> bytes:
    data = bytearray(serialised(fmu))
    data[len(data) // 2] ^= 1
    return bytes(data)


def test_saved_states_continue_bit_for_bit() -> None:
    """In the same instance, and as bytes in another one that started elsewhere."""
    with slave({"friction_coefficient": 0.05}) as one, slave({"mass_kg": 3.0}) as other:
        drive(one, 0, 20)
        state, data = one.getFMUstate(), serialised(one)
        onward = drive(one, 20, 60)
        one.setFMUstate(state)
        assert serialised(one) == data
        assert drive(one, 20, 60) == onward
        one.freeFMUstate(state)
        state = other.deSerializeFMUstate(data)
        other.setFMUstate(state)
        assert drive(other, 20, 60) == onward
        other.freeFMUstate(state)


def test_a_saved_state_leads_out_of_the_error_state() -> None:
    with slave() as fmu:
        drive(fmu, 0, 5)
        state = fmu.getFMUstate()
        onward = drive(fmu, 5, 10)
        refused(lambda: fmu.setReal([TORQUE], [math.nan]))
        fmu.setFMUstate(state)
        assert drive(fmu, 5, 10) == onward
        fmu.freeFMUstate(state)


def test_the_stop_time_is_kept() -> None:
    with slave(initialised=False) as fmu:
        fmu.setupExperiment(startTime=1.0, stopTime=1.01)
        fmu.enterInitializationMode()
        fmu.exitInitializationMode()
        for n in range(10):
            fmu.doStep(1.0 + n / 1000, 1e-3)
        assert last_successful_time_s(fmu) == pytest.approx(1.01)
        refused(lambda: fmu.doStep(1.01, 1e-3))
