"""Parameters from all over their ranges: finite values, an honest energy balance, or a sentence that says why not."""

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from hypothesis import HealthCheck, example, given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.plant_testbed import (
    ENERGY,
    MESSAGES,
    OUTPUTS,
    SLIP,
    START,
    VARIABLES,
    VOLTAGE,
    Robot,
    initialise,
    robot,
    slave,
)

RANGED = {
    name: (float(v.min), float(v.max))
    for name, v in VARIABLES.items()
    if v.causality == "parameter" and v.min is not None and v.max is not None and v.type == "Real"
}
CHOICES = {"contact": (1, 2), "rollers": (1, 2), "coriolis": (1, 2), "drive": (1, 2, 3)}
INTERNAL_STEPS = 100  # a communication step of these tests: as many as a millisecond needs can be millions


def anywhere(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers of any size within a range, and its ends."""
    if low < 0:
        return st.one_of(st.sampled_from([low, high]), st.floats(low, high))
    smallest = max(low, 1e-9 * high)
    sizes = st.floats(math.log(smallest), math.log(high)).map(lambda size: min(max(math.exp(size), low), high))
    return st.one_of(st.sampled_from([low, high]), sizes)


@st.composite
def extremes(draw: st.DrawFn) -> dict[str, float]:
    """A robot of defaults in which up to six parameters are anywhere in their ranges."""
    names = draw(st.lists(st.sampled_from(sorted(RANGED)), max_size=6, unique=True))
    chosen = {name: draw(anywhere(*RANGED[name])) for name in names}
    chosen |= {name: draw(st.sampled_from(values)) for name, values in CHOICES.items()}
    return chosen | {name: draw(st.floats(-3, 3)) for name in START}


inputs = st.lists(
    st.tuples(
        st.tuples(*[st.floats(-100, 100)] * 4),
        st.tuples(*[st.floats(-1, 1)] * 4),
        st.tuples(*[st.floats(-100, 100)] * 3),
    ),
    min_size=1,
    max_size=6,
)


def internal_step_s(parameters: Mapping[str, float]) -> float:
    """Return how long an internal step of this robot is: the refusal of a step of 30 years says it."""
    with robot(parameters) as plant, pytest.raises(FMICallException):
        plant.step(1e9)
    needed = re.search(r"needs (\d+) internal steps", MESSAGES[-1])
    assert needed is not None
    return 1e9 / int(needed[1])


@share_of_examples(1.5, suppress_health_check=[HealthCheck.too_slow])
@given(extremes(), inputs)
@example(
    dict.fromkeys(START, 0.0) | {"battery_voltage_v": 0.0, "gear_ratio": 0.01, "com_x_m": -10.0, "drive": 2.0},
    [((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0))],
)
def test_extreme_robots_stay_finite_and_make_no_energy(parameters: dict[str, float], run: list[Any]) -> None:
    """Where sampled motion cannot follow, a step is an error that names the trouble; elsewhere heat only grows."""
    with slave(initialised=False) as fmu:
        plant = Robot(fmu)
        try:
            initialise(fmu, parameters)
            step_s = INTERNAL_STEPS * internal_step_s(parameters)
            _, start, _ = plant.read(ENERGY)
            through, lost_before = abs(start), 0.0
            for torque, duty, push in run:
                plant.torque(torque)
                plant.duty(duty)
                plant.push(*push)
                plant.step(step_s)
                assert np.isfinite(plant.read(OUTPUTS)).all()
                supplied, stored, lost = plant.read(ENERGY)
                through = max(through, abs(supplied), abs(stored), lost)
                assert lost >= lost_before - 1e-9 * through
                assert abs(stored - start - supplied + lost) <= 0.05 * through + 1e-9
                lost_before = lost
        except FMICallException:
            assert re.search(r"expected|look at", MESSAGES[-1])


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (
            {"contact": SLIP, "roller_friction_coefficient": 5.0, "mass_kg": 1e4, "wheel_inertia_kg_m2": 1e-9},
            "internal steps",
        ),
        ({"inertia_kg_m2": 1e-6, "wheel_inertia_kg_m2": 0.0, "longest_step_s": 0.01}, "turns by"),
        ({"contact": SLIP, "wheel_inertia_kg_m2": 0.0}, "wheel_inertia_kg_m2 = 0"),
    ],
)
def test_what_cannot_be_followed_is_said(start: dict[str, float], words: str) -> None:
    with slave(initialised=False) as fmu:
        plant = Robot(fmu)
        with pytest.raises(FMICallException):  # noqa: PT012  whichever call notices
            initialise(fmu, start)
            plant.push(0.0, 0.0, 1000.0)
            plant.step(0.1)
    assert words in MESSAGES[-1]


@pytest.mark.parametrize("inductance_h", [1e-5, 5e-4, 0.01, 10.0])
@pytest.mark.parametrize("battery_ohm", [0.0, 0.05, 5.0])
def test_motors_of_any_time_constant_are_stable(inductance_h: float, battery_ohm: float) -> None:
    """At full duty for 50 ms no wheel passes its no-load speed, and no current its limit."""
    start = {"motor_inductance_h": inductance_h, "battery_resistance_ohm": battery_ohm, "drive": VOLTAGE}
    with robot(start, mass_kg=1.0, inertia_kg_m2=0.01, wheel_inertia_kg_m2=1e-5) as plant:
        plant.duty([1.0] * 4)
        for _ in range(10):
            plant.step(0.005)
            assert plant["wheel.fl.speed_rad_s"] <= 24 / 1.25 * (1.01 if inductance_h < 0.01 else 2.0)
            assert plant["wheel.fl.current_a"] <= 4.0 * (1 + 1e-9)
