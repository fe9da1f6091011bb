"""Save and restore, independence, determinism, steps of any length, parameters that change on the way."""

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.support.examples import share_of_examples
from tests.support.plant_cases import robots
from tests.support.plant_testbed import (
    ANGLES,
    CURRENT,
    DEFAULTS,
    ENERGY,
    POSE,
    RIGID,
    SLIP,
    SPEEDS,
    START,
    TORQUE,
    TWIST,
    VARIABLES,
    VOLTAGE,
    Robot,
    robot,
)

KINDS = list(product((RIGID, SLIP), (TORQUE, CURRENT, VOLTAGE)))
NOISY = {"gyro_noise_rad_s": 0.02, "accelerometer_noise_m_s2": 0.3, "seed": 7}
LIVELY = {"friction_coefficient": 0.05, "slope_rad": 0.03, "com_x_m": 0.02, "viscous_n_m_s_rad": 0.01} | NOISY
# The windings have the temperature of the air in which the robot was started.
TUNABLE = [name for name, v in VARIABLES.items() if v.variability == "tunable" and name != "air_degc"]


def drive(plant: Robot, ticks: int, seed: int = 0) -> list[bytes]:
    """Drive a millisecond at a time with torques and duties of a seed; return all outputs after each."""
    rng = np.random.default_rng(seed)
    seen = []
    for _ in range(ticks):
        plant.torque(rng.uniform(-3, 3, 4))
        plant.duty(rng.uniform(-0.3, 0.3, 4))
        plant.step()
        seen.append(plant.bits())
    return seen


def stand(plant: Robot) -> None:
    """Hold still: friction keeps the wheels."""
    plant.torque([0.01] * 4)
    plant.step(1e-3, 5)


@pytest.mark.parametrize(("contact", "drives"), KINDS)
@pytest.mark.parametrize("before", [stand, lambda plant: drive(plant, 20, 3)], ids=["sticking", "moving"])
@pytest.mark.parametrize("as_bytes", [False, True])
def test_a_restored_state_goes_on_with_the_same_bits(
    contact: int, drives: int, before: Callable[[Robot], object], as_bytes: bool
) -> None:
    """Into the same instance, and as bytes into another one that has meanwhile gone elsewhere."""
    with robot(LIVELY, contact=contact, drive=drives) as plant, robot(mass_kg=50.0) as other:
        before(plant)
        if before is stand:
            assert not plant.read(SPEEDS).any()
        saved, time_s = plant.save(), plant.time_s
        expected = drive(plant, 30)
        again = plant
        if as_bytes:
            data = plant.fmu.serializeFMUstate(saved)
            drive(other, 5)
            saved, again = other.fmu.deSerializeFMUstate(data), other
        again.restore(saved, time_s)
        assert drive(again, 30) == expected


@pytest.mark.parametrize(("contact", "drives"), KINDS)
def test_the_same_run_has_the_same_bits_and_neighbours_do_not_matter(contact: int, drives: int) -> None:
    """Alone, and step by step in turn with an instance that does something else."""
    start = LIVELY | {"contact": contact, "drive": drives}
    with robot(start) as alone:
        expected = drive(alone, 20)
    with robot(start) as one, robot(contact=SLIP, drive=VOLTAGE, mass_kg=5.0) as two:
        rng, seen = np.random.default_rng(0), []
        for n in range(20):
            one.torque(rng.uniform(-3, 3, 4))
            one.duty(rng.uniform(-0.3, 0.3, 4))
            drive(two, 1, n)
            one.step()
            seen.append(one.bits())
    assert seen == expected


@pytest.mark.parametrize(("contact", "drives"), KINDS)
def test_many_steps_equal_one_where_internal_steps_coincide(contact: int, drives: int) -> None:
    """Twelve digits: the length of an internal step is a quotient, and rounds differently."""
    start = LIVELY | {"contact": contact, "drive": drives, "longest_step_s": 1.25e-4}
    with robot(start) as long, robot(start) as short:
        for plant in (long, short):
            plant.torque([0.9, 0.7, 0.4, 1.1])
            plant.duty([0.1, 0.05, 0.02, 0.08])
        long.step(0.2)
        short.step(1e-3, 200)
        names = (*POSE, *TWIST, *ANGLES, *ENERGY)
        np.testing.assert_allclose(long.read(names), short.read(names), rtol=1e-10, atol=1e-12)


TWO_REST_AT_ONCE = {
    "friction_coefficient": 0.02,
    "gear_ratio": 20.0,
    "rotor_inertia_kg_m2": 5e-6,
    "wheel_inertia_kg_m2": 0.002,
    "wheel_radius_m": 0.12,
    "mass_kg": 26.0,
    "start_heading_rad": -0.65,
    "start_vy_m_s": 1e-5,
}
"""Two wheels come to rest within 4 us. Once the first is at rest, the other turns back."""


@share_of_examples(0.15)
@example(TWO_REST_AT_ONCE, [1e-5, 0.06])
@given(robots(friction_coefficient=0.02), st.lists(st.floats(1e-5, 3e-2), min_size=3, max_size=20))
def test_steps_of_any_length_lead_to_the_same_place(parameters: dict[str, float], steps_s: list[float]) -> None:
    """Irregular communication steps and a single one differ by the integrator's error, a micrometre with slip."""
    with robot(parameters) as one, robot(parameters) as many:
        for plant in (one, many):
            plant.torque([0.5, -0.4, 0.8, 0.3])
        for step_s in steps_s:
            many.step(step_s)
        one.step(many.time_s)
        np.testing.assert_allclose(many.read((*POSE, *TWIST)), one.read((*POSE, *TWIST)), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", TUNABLE)
def test_a_parameter_that_is_tuned_before_the_first_step_is_a_start_value(name: str) -> None:
    """And each of them matters, for motors on rollers that slip."""
    base = LIVELY | {"contact": SLIP, "drive": VOLTAGE}
    value = 1.0 if name.endswith(".lifted") else base.get(name, DEFAULTS[name]) * 0.7 + 0.01
    if name == "blocks":
        base, value = base | {"wheel.fl.lifted": 1.0}, 0.0
    with robot(base) as tuned, robot(base | {name: value}) as started, robot(base) as untouched:
        tuned.set({name: value})
        assert tuned[name] == value
        ends = [drive(plant, 40)[-1] for plant in (tuned, started, untouched)]
    assert ends[0] == ends[1]
    assert ends[0] != ends[2]


@share_of_examples(0.15)
@given(robots(), robots())
def test_parameters_tuned_on_the_way_act_as_if_started_there(before: dict[str, float], after: dict[str, float]) -> None:
    """A robot loaded in motion continues as one that starts there, at the same speed, with the same load."""
    tuned = {name: after[name] for name in TUNABLE if name in after}
    with robot(before) as plant:
        plant.torque([0.5, -0.4, 0.8, 0.3])
        plant.step(1e-3, 20)
        plant.set(tuned)
        start = dict(zip(START, plant.read((*POSE, *TWIST)), strict=True))
        turned = plant.read(ANGLES)
        with robot(before | tuned | start) as fresh:
            fresh.torque([0.5, -0.4, 0.8, 0.3])
            for one in (plant, fresh):
                one.step(1e-3, 20)
            np.testing.assert_allclose(plant.read((*POSE, *TWIST)), fresh.read((*POSE, *TWIST)), rtol=1e-11, atol=1e-12)
            np.testing.assert_allclose(plant.read(ANGLES) - turned, fresh.read(ANGLES), rtol=1e-9, atol=1e-11)
