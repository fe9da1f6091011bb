"""What FMI 2.0 has and 3.0 has not: the experiment's set-up, the step's status functions, enumerations as integers."""

import ctypes
from collections.abc import Callable

import pytest

from tests.plant_fmu.test_fmu_calls import STATES
from tests.support.fmu_slave import VARIABLES, Slave, refused, slave

REFERENCE = {name: variable.valueReference for name, variable in VARIABLES[2].items()}
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3  # fmi2StatusKind
DISCARD = 2  # fmi2Discard


def test_set_up_comes_before_initialization() -> None:
    with slave(2, initialized=False) as fmu:
        refused(fmu.raw.enterInitializationMode)


def test_set_up_is_legal_in_the_instantiated_state_alone() -> None:
    for state, bring in STATES.items():
        with slave(2, initialized=False) as fmu:
            bring(fmu)
            if state == "i":
                fmu.raw.setupExperiment(startTime=0.0)
            else:
                refused(lambda: fmu.raw.setupExperiment(startTime=0.0))


def test_nothing_can_be_read_before_initialization() -> None:
    with slave(2, initialized=False) as fmu:
        refused(lambda: fmu.get(["mass_kg"]))


def test_enumerations_go_as_integers() -> None:
    with slave(2, initialized=False) as fmu:
        fmu.raw.setInteger([REFERENCE["drive"], REFERENCE["seed"]], [2, 7])
        fmu.enter_initialization()
        assert fmu.raw.getInteger([REFERENCE["drive"], REFERENCE["seed"]]) == [2, 7]


def real_status(fmu: Slave, kind: int = LAST_SUCCESSFUL_TIME) -> float:
    value = ctypes.c_double()
    fmu.raw.fmi2GetRealStatus(fmu.raw.component, kind, ctypes.byref(value))
    return value.value


def test_the_last_successful_time_is_known_after_initialization() -> None:
    for state, bring in STATES.items():
        with slave(2, initialized=False) as fmu:
            bring(fmu)
            if state in "ste":
                assert real_status(fmu) == 0.0
            else:
                refused(lambda: real_status(fmu))
    with slave(2) as fmu:
        fmu.step(0.25)
        refused(lambda: fmu.step(-1.0))
        assert real_status(fmu) == 0.25


def test_the_plant_ends_no_simulation_and_steps_at_once() -> None:
    """The remaining kinds of status are of asynchronous steps, and discarded."""
    with slave(2) as fmu:
        ended, other = ctypes.c_int(7), ctypes.c_int(7)
        functions = ctypes.CDLL(fmu.raw.dll._name)
        component = ctypes.c_void_p(fmu.raw.component)
        assert functions.fmi2GetBooleanStatus(component, TERMINATED, ctypes.byref(ended)) == 0
        assert ended.value == 0
        for name in ("fmi2GetStatus", "fmi2GetIntegerStatus", "fmi2GetStringStatus", "fmi2GetBooleanStatus"):
            assert getattr(functions, name)(component, 0, ctypes.byref(other)) == DISCARD
        assert functions.fmi2GetRealStatus(component, TERMINATED, ctypes.byref(other)) == DISCARD


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("input derivatives", lambda f: f.raw.setRealInputDerivatives([REFERENCE["wheel.fl.duty"]], [1], [0.0])),
        ("output derivatives", lambda f: f.raw.getRealOutputDerivatives([REFERENCE["pose.x_m"]], [1])),
        (
            "directional derivatives",
            lambda f: f.raw.getDirectionalDerivative([REFERENCE["pose.x_m"]], [REFERENCE["wheel.fl.duty"]], [1.0]),
        ),
        ("cancelling a step", lambda f: f.raw.fmi2CancelStep(f.raw.component)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_not_claimed_is_an_error(name: str, call: Callable[[Slave], object]) -> None:
    with slave(2) as fmu:
        refused(lambda: call(fmu))
        refused(fmu.step)
