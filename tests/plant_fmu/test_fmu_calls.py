"""The laws of the FMU's interface, the same for FMI 2.0 and 3.0: legal order, variables, saved states, time."""

import ctypes
import math
import subprocess
import sys
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.support.fmu_slave import (
    DESCRIPTIONS,
    OUTPUTS,
    TORQUES,
    VARIABLES,
    VERSIONS,
    Slave,
    discarded,
    fmpy_slave,
    refused,
    slave,
)

TORQUE, MASS, RADIUS, X, COUNT = TORQUES[0], "mass_kg", "wheel_radius_m", "pose.x_m", "wheel.fl.count"

both_versions = pytest.mark.parametrize("fmi", VERSIONS, ids=["FMI 2.0", "FMI 3.0"])

# Each call, and its legal states in FMI 2.0 (section 4.2.4) and in FMI 3.0 (sections 2.3 and 4.2): i instantiated, n
# initialization mode, s between steps, t terminated, e error.
Call = Callable[[Slave], object]
CALLS: dict[str, tuple[str, str, Call]] = {
    "enter initialization mode": ("i", "i", lambda f: f.enter_initialization()),
    "exit initialization mode": ("n", "n", lambda f: f.raw.exitInitializationMode()),
    "terminate": ("s", "s", lambda f: f.raw.terminate()),
    "reset": ("inste", "inste", lambda f: f.raw.reset()),
    "set logging": ("inste", "inste", lambda f: f.raw.setDebugLogging(True, ["logStatusError"])),
    "get an output": ("nste", "nste", lambda f: f.get([X])),
    "get an integer": ("nste", "nste", lambda f: f.get([COUNT])),
    "get the time": ("nste", "nste", lambda f: f.get(["time"])),
    "get a parameter": ("nste", "inste", lambda f: f.get([MASS])),
    "get an enumeration": ("nste", "inste", lambda f: f.get(["contact"])),
    "get no Boolean": ("nste", "inste", lambda f: f.raw.getBoolean([])),
    "get no String": ("nste", "inste", lambda f: f.raw.getString([])),
    "set an input": ("ins", "ins", lambda f: f.set({TORQUE: 0.5})),
    "set a tunable parameter": ("ins", "ins", lambda f: f.set({MASS: 21.0})),
    "set a fixed parameter": ("in", "in", lambda f: f.set({RADIUS: 0.08})),
    "set an enumeration": ("in", "in", lambda f: f.set({"coriolis": 2})),
    "set an integer": ("in", "in", lambda f: f.set({"counts_per_revolution": 1000})),
    "set no Boolean": ("ins", "ins", lambda f: f.raw.setBoolean([], [])),
    "set no String": ("ins", "ins", lambda f: f.raw.setString([], [])),
    "step": ("s", "s", lambda f: f.step()),
    "save the state": ("inste", "inste", lambda f: f.serialized()),
}
LEADS_TO = {"enter initialization mode": "n", "exit initialization mode": "s", "terminate": "t", "reset": "i"}


@both_versions
@given(calls=st.lists(st.sampled_from([*CALLS, "step", "enter initialization mode", "exit initialization mode"])))
def test_every_call_is_done_or_refused_as_the_state_machine_has_it(fmi: int, calls: list[str]) -> None:
    with slave(fmi, initialized=False) as fmu:
        state = "i"
        for name in calls:
            legal, action = CALLS[name][fmi - 2], CALLS[name][2]
            if state in legal:
                action(fmu)
                state = LEADS_TO.get(name, state)
            else:
                refused(lambda action=action: action(fmu))  # type: ignore[misc]
                state = "e"


STATES: dict[str, Call] = {
    "i": lambda f: None,
    "n": lambda f: f.enter_initialization(),
    "s": lambda f: f.initialize(),
    "t": lambda f: (f.initialize(), f.raw.terminate()),
    "e": lambda f: (f.initialize(), refused(lambda: f.step(-1.0))),
}


@both_versions
@pytest.mark.parametrize("state", STATES)
def test_every_call_in_every_state(fmi: int, state: str) -> None:
    for *legal, action in CALLS.values():
        with slave(fmi, initialized=False) as fmu:
            STATES[state](fmu)
            if state in legal[fmi - 2]:
                action(fmu)
            else:
                refused(lambda: action(fmu))  # noqa: B023


def damaged(fmu: Slave) -> bytes:
    data = bytearray(fmu.serialized())
    data[len(data) // 2] ^= 1
    return bytes(data)


WRONG: dict[str, Call] = {
    "an output is set": lambda f: f.set({X: 1.0}),
    "the time is set": lambda f: f.set({"time": 1.0}),
    "a fixed parameter is set after initialization": lambda f: f.set({RADIUS: 0.08}),
    "a Boolean": lambda f: f.raw.getBoolean([VARIABLES[f.fmi][X].valueReference]),
    "a String": lambda f: f.raw.setString([VARIABLES[f.fmi][X].valueReference], ["1"]),
    "an unknown log category": lambda f: f.raw.setDebugLogging(True, ["logEverything"]),
    "a step of zero": lambda f: f.raw.doStep(0.0, 0.0),
    "a step back": lambda f: f.raw.doStep(0.0, -1e-3),
    "a step that is no number": lambda f: f.raw.doStep(0.0, math.nan),
    "a step from elsewhere": lambda f: f.raw.doStep(0.5, 1e-3),
    "a damaged state": lambda f: f.restore(damaged(f)),
    "a cut state": lambda f: f.restore(f.serialized()[:-1]),
    "no state": lambda f: f.raw.setFMUState(None),
}


DISCARDED: dict[str, Call] = {
    "not a number": lambda f: f.set({TORQUE: math.nan}),
    "infinite": lambda f: f.set({TORQUE: -math.inf}),
    "a tunable parameter below its range": lambda f: f.set({MASS: 0.0}),
    "one of two values out of its range": lambda f: f.set_together({TORQUE: 0.5, MASS: 0.0}),
    "a step of a year": lambda f: f.raw.doStep(0.0, 3.15e7),
}


@both_versions
@pytest.mark.parametrize("call", DISCARDED.values(), ids=list(DISCARDED))
def test_after_a_discarded_call_the_instance_is_as_it_was(fmi: int, call: Call) -> None:
    """FMI 3.0 section 2.2.3; FMI 2.0 section 2.2.7 has it for values out of range."""
    with slave(fmi) as fmu, slave(fmi) as other:
        before = fmu.serialized()
        discarded(lambda: call(fmu))
        assert fmu.serialized() == before
        if fmi == 3:
            status, category, _ = fmu.log[-1]
            assert (status, category) == (2, "logStatusDiscard")
        assert fmu.drive(0, 3) == other.drive(0, 3)


@both_versions
def test_a_step_that_does_not_stay_finite_names_what_is_far_from_usual_and_may_be_tried_again(fmi: int) -> None:
    with slave(fmi, {"mass_kg": 0.01, "com_y_m": 8.0}) as fmu:
        fmu.set({TORQUE: 1e200})
        before = fmu.serialized()
        discarded(lambda: fmu.step())
        if fmi == 3:
            words = fmu.log[-1][2]
            assert "no longer finite" in words
            assert words.endswith("; far from usual: wheel.fl.torque_n_m = 1e+200, mass_kg = 0.01, com_y_m = 8")
        assert fmu.serialized() == before
        fmu.set({TORQUE: 0.1})
        fmu.step()


@both_versions
def test_errors_and_discards_are_logged_apart(fmi: int) -> None:
    with slave(fmi) as fmu:
        fmu.raw.setDebugLogging(False, ["logStatusDiscard"])
        discarded(lambda: fmu.set({MASS: 0.0}))
        assert fmu.log == []
        refused(lambda: fmu.step(-1.0))
        if fmi == 3:
            ((status, category, _),) = fmu.log
            assert (status, category) == (3, "logStatusError")


@both_versions
@pytest.mark.parametrize("call", WRONG.values(), ids=list(WRONG))
def test_after_a_wrong_call_values_can_be_read_and_a_reset_starts_afresh(fmi: int, call: Call) -> None:
    with slave(fmi) as fmu:
        first = fmu.drive(0, 3)
        fmu.raw.reset()
        fmu.initialize()
        refused(lambda: call(fmu))
        assert all(math.isfinite(value) for value in fmu.get(OUTPUTS))
        refused(lambda: fmu.raw.doStep(0.0, 1e-3))
        fmu.raw.reset()
        fmu.initialize()
        assert fmu.drive(0, 3) == first


@both_versions
@pytest.mark.parametrize(
    ("name", "value"),
    [(MASS, 0.0), ("half_width_m", 11.0), (RADIUS, -0.1), ("counts_per_revolution", 0), ("contact", 3), ("drive", 0)],
)
def test_a_value_out_of_its_range_is_discarded(fmi: int, name: str, value: float) -> None:
    with slave(fmi, initialized=False) as fmu:
        discarded(lambda: fmu.set({name: value}))
        fmu.initialize()
        start = VARIABLES[fmi][name].start
        assert start is not None
        assert fmu.get([name]) == [float(start)]


@both_versions
def test_a_reference_of_no_variable_or_another_type_is_refused(fmi: int) -> None:
    count, x = VARIABLES[fmi][COUNT].valueReference, VARIABLES[fmi][X].valueReference
    real, integer = ("getReal", "getInteger") if fmi == 2 else ("getFloat64", "getInt32")
    for getter, reference in ((real, count), (integer, x), (real, len(VARIABLES[fmi])), (real, 2**32 - 1)):
        with slave(fmi) as fmu:
            refused(lambda: getattr(fmu.raw, getter)([reference]))  # noqa: B023


@both_versions
def test_a_wrong_token_is_refused(fmi: int) -> None:
    with pytest.raises(Exception, match="Failed to instantiate"):
        fmpy_slave(fmi, token="{00000000-0000-0000-0000-000000000000}").instantiate()


@both_versions
def test_start_values_show_in_initialization_mode(fmi: int) -> None:
    with slave(fmi, initialized=False) as fmu:
        fmu.enter_initialization()
        assert fmu.get([X]) == [0.0]
        fmu.set({"start_x_m": 1.25})
        assert fmu.get([X]) == [1.25]
        fmu.raw.exitInitializationMode()
        assert fmu.get([X]) == [1.25]


@both_versions
def test_start_values_of_the_description_are_those_of_the_binary(fmi: int) -> None:
    with slave(fmi) as fmu:
        for variable in DESCRIPTIONS[fmi].modelVariables:
            if variable.start is not None:
                assert fmu.get([variable.name]) == [float(variable.start)], variable.name


def test_both_versions_have_the_same_variables_and_give_the_same_bits() -> None:
    two, three = (
        [(v.valueReference, v.name, v.causality) for v in DESCRIPTIONS[fmi].modelVariables] for fmi in VERSIONS
    )
    assert two == three
    assert DESCRIPTIONS[2].guid == DESCRIPTIONS[3].instantiationToken
    with slave(2) as one, slave(3) as other:
        assert one.drive(0, 50) == other.drive(0, 50)


@both_versions
def test_a_tunable_parameter_takes_effect_between_steps(fmi: int) -> None:
    with slave(fmi) as plain, slave(fmi) as tuned:
        assert plain.drive(0, 10) == tuned.drive(0, 10)
        tuned.set({MASS: 20.0})
        assert plain.drive(10, 20) == tuned.drive(10, 20), "the value that it has changes nothing"
        tuned.set({MASS: 40.0})
        assert tuned.get([MASS]) == [40.0]
        assert plain.drive(20, 21) != tuned.drive(20, 21)


@both_versions
def test_outputs_depend_at_once_on_nothing_that_the_description_does_not_list(fmi: int) -> None:
    """ModelStructure: in every drive and contact, an input changes only outputs that name it."""
    declared = {u.variable.name: {d.name for d in u.dependencies} for u in DESCRIPTIONS[fmi].outputs}
    assert set(declared) == set(OUTPUTS)
    inputs = [variable.name for variable in DESCRIPTIONS[fmi].modelVariables if variable.causality == "input"]
    seen: set[str] = set()
    for start in ({"drive": drive, "contact": contact} for drive in (1, 2, 3) for contact in (1, 2)):
        with slave(fmi, {**start, "start_vx_m_s": 0.3}) as fmu:
            fmu.step()
            for name in inputs:
                before = fmu.get(OUTPUTS)
                fmu.set({name: 0.25})
                changed = {o for o, a, b in zip(OUTPUTS, before, fmu.get(OUTPUTS), strict=True) if a != b}
                seen |= changed
                assert {output for output in changed if name not in declared[output]} == set()
    assert "wheel.fl.current_a" in seen


@both_versions
def test_initial_values_depend_on_no_input_beyond_direct_feedthrough(fmi: int) -> None:
    description = DESCRIPTIONS[fmi]
    now = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs}
    parameters = {v.name for v in description.modelVariables if v.causality == "parameter"}
    initially = {u.variable.name: {d.name for d in u.dependencies} for u in description.initialUnknowns}
    assert initially == {name: known | parameters for name, known in now.items()}


@both_versions
def test_two_instances_are_independent(fmi: int) -> None:
    with slave(fmi) as alone:
        expected = alone.drive(0, 40)
    with slave(fmi) as one, slave(fmi, {MASS: 3.0, "start_vy_m_s": 0.5}) as other:
        rows = []
        for n in range(40):
            rows += one.drive(n, n + 1)
            other.drive(n, n + 1)
        other.raw.reset()
    assert rows == expected


@both_versions
def test_saved_states_continue_bit_for_bit(fmi: int) -> None:
    """In the same instance, and as bytes in another one that started elsewhere."""
    with slave(fmi, {"friction_coefficient": 0.05}) as one, slave(fmi, {MASS: 3.0}) as other:
        one.drive(0, 20)
        state, data = one.raw.getFMUState(), one.serialized()
        onward = one.drive(20, 60)
        one.raw.setFMUState(state)
        assert one.serialized() == data
        assert one.drive(20, 60) == onward
        one.raw.freeFMUState(state)
        other.restore(data)
        assert other.drive(20, 60) == onward


@both_versions
def test_a_state_saved_through_one_version_continues_through_the_other(fmi: int) -> None:
    with slave(fmi, {MASS: 7.0}) as one, slave(5 - fmi) as other:
        one.drive(0, 20)
        data = one.serialized()
        other.restore(data)
        assert other.serialized() == data
        assert one.drive(20, 40) == other.drive(20, 40)


@both_versions
def test_a_saved_state_leads_out_of_the_error_state(fmi: int) -> None:
    with slave(fmi) as fmu:
        fmu.drive(0, 5)
        data = fmu.serialized()
        onward = fmu.drive(5, 10)
        refused(lambda: fmu.step(-1.0))
        fmu.restore(data)
        assert fmu.drive(5, 10) == onward


@both_versions
def test_the_stop_time_is_kept_and_time_is_what_the_importer_says(fmi: int) -> None:
    with slave(fmi, initialized=False) as fmu:
        fmu.enter_initialization(start_s=1.0, stop_s=1.01)
        assert fmu.get(["time"]) == [1.0]
        fmu.raw.exitInitializationMode()
        for n in range(10):
            fmu.raw.doStep(1.0 + n / 1000, 1e-3)
            assert fmu.get(["time"]) == [1.0 + n / 1000 + 1e-3]
        refused(lambda: fmu.raw.doStep(1.01, 1e-3))


def growth_bytes(*arguments: str) -> int:
    """Measure in a process of its own: the freed memory of other tests would take up what leaks here."""
    command = [sys.executable, "-m", "tests.support.memory_growth", *arguments]
    return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()[-1])


on_linux = pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="asks mallinfo2 of glibc 2.33")


@on_linux
@both_versions
def test_two_thousand_instances_leave_nothing_behind(fmi: int) -> None:
    assert growth_bytes("lives", str(fmi)) < 200_000, "a leak of 200 bytes a life would show"


@on_linux
def test_the_measure_of_growth_sees_a_leak() -> None:
    assert growth_bytes("leak", "3") > 500_000, "a saved state of some 1.5 kB is left behind each time"
