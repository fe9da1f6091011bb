"""The plant's motion against independent equations, the order of its integrator, and analytic cases."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given

from tests.support.examples import share_of_examples
from tests.support.plant_cases import held, robots
from tests.support.plant_oracle import Inputs, Oracle
from tests.support.plant_testbed import (
    ANGLES,
    CURRENTS,
    DEFAULTS,
    MOTION,
    POSE,
    SLIP,
    SLIPS,
    SPEEDS,
    TORQUE,
    TWIST,
    VOLTAGE,
    WHEELS,
    O,
    robot,
)

M, INERTIA, R, L = DEFAULTS["mass_kg"], DEFAULTS["inertia_kg_m2"], DEFAULTS["wheel_radius_m"], 0.6
K = 4 * DEFAULTS["wheel_inertia_kg_m2"] / R**2
HOLD_S = 0.03
LIGHT = {"wheel_inertia_kg_m2": 0.0, "viscous_n_m_s_rad": 0.05, "com_x_m": 0.1, "start_yaw_rate_rad_s": 1.0}
LIGHT |= {"slope_rad": 0.1, "longest_step_s": 2.5e-4, "drive": TORQUE}


def ours(parameters: Mapping[str, float], run: list[Any], step_s: float = 1e-3) -> np.ndarray:
    """Return pose, twist, wheel angles, speeds and currents of the plant at the end."""
    with robot(parameters) as plant:
        for drive, push in run:
            plant.duty(drive) if parameters["drive"] == VOLTAGE else plant.torque(drive)
            plant.push(*push)
            plant.step(step_s, round(HOLD_S / step_s))
        current = plant.read(CURRENTS) if parameters["drive"] == VOLTAGE else np.zeros(4)
        return np.concatenate([plant.fmu.getReal(MOTION), plant.read(SPEEDS), current])


def theirs(parameters: Mapping[str, float], run: list[Any]) -> np.ndarray:
    """Return the same of the independent equations."""
    oracle = Oracle(parameters)
    state = oracle.run([Inputs(drive, push) for drive, push in run], HOLD_S)
    return np.concatenate([oracle.motion(state), state[10:14], state[18:22]])


# Viscous friction on light wheels leaves 3e-8 at the default step of 1 ms; a quarter of it leaves 1e-10.
@share_of_examples(0.3)
@given(robots(longest_step_s=2.5e-4), held(2.0))
@example(LIGHT, [((1.0, 0.2, -0.7, 0.4), (3.0, -5.0, 0.2))])
def test_agrees_with_independent_equations(parameters: dict[str, float], run: list[Any]) -> None:
    np.testing.assert_allclose(ours(parameters, run), theirs(parameters, run), rtol=1e-8, atol=1e-10)


# The default step, a quarter of the electrical time constant, leaves 1e-7; it falls with the fourth power.
@share_of_examples(0.08)
@given(robots(drive=VOLTAGE, longest_step_s=5e-5, current_limit_a=1000.0), held(0.3))
def test_motors_agree_with_independent_equations(parameters: dict[str, float], run: list[Any]) -> None:
    np.testing.assert_allclose(ours(parameters, run), theirs(parameters, run), rtol=1e-8, atol=1e-10)


# From rest, with a grip of 5 and so heavy, every roller stays below 0.7 of its limit, where the equations are smooth.
ELASTIC: dict[str, Any] = {"contact": SLIP, "longest_step_s": 2.5e-5, "grip_coefficient": 5.0, "mass_kg": 40.0}
ELASTIC |= {"start_vx_m_s": 0.0, "start_vy_m_s": 0.0, "start_yaw_rate_rad_s": 0.0, "wheel_radius_m": 0.08}


@share_of_examples(0.08)
@given(robots(**ELASTIC), held(2.0))
def test_elastic_rollers_agree_with_independent_equations(parameters: dict[str, float], run: list[Any]) -> None:
    np.testing.assert_allclose(ours(parameters, run), theirs(parameters, run), rtol=1e-8, atol=1e-9)


@share_of_examples(0.05)
@given(robots(**ELASTIC, drive=VOLTAGE, current_limit_a=1000.0), held(0.05))
def test_motors_on_elastic_rollers_agree_with_independent_equations(
    parameters: dict[str, float], run: list[Any]
) -> None:
    np.testing.assert_allclose(ours(parameters, run), theirs(parameters, run), rtol=1e-8, atol=1e-9)


# The friction of sliding rollers has corners, at the limit and where a slide turns back. They cost the integrator its
# order: steps of 2e-5 s left 2.1e-5 of a value in one of 60 runs, and those of 1e-5 s a fortieth of that.
@share_of_examples(0.06)
@given(robots(contact=SLIP, longest_step_s=1e-5, mass_kg=30.0), held(9.0))
def test_sliding_rollers_agree_with_independent_equations(parameters: dict[str, float], run: list[Any]) -> None:
    np.testing.assert_allclose(ours(parameters, run), theirs(parameters, run), rtol=1e-5, atol=5e-6)


@pytest.mark.parametrize(
    ("start", "steps_s"),
    [
        ({"start_vx_m_s": 1.0, "start_yaw_rate_rad_s": 300.0}, (1e-3, 5e-4, 2.5e-4)),
        ({"drive": VOLTAGE, "current_limit_a": 1000.0}, (1e-4, 5e-5, 2.5e-5)),
        ({"contact": SLIP, "grip_coefficient": 5.0, "viscous_n_m_s_rad": 0.01}, (1e-4, 5e-5, 2.5e-5)),
    ],
    ids=["rigid", "motors", "slip"],
)
def test_the_integrator_is_of_fourth_order(start: dict[str, float], steps_s: tuple[float, ...]) -> None:
    """Half the step, a sixteenth of the error: a yaw rate of 300 rad/s lifts that of rigid contact above rounding."""
    ends = []
    for longest_s in (*steps_s, steps_s[-1] / 4):
        with robot(start, com_x_m=0.02, longest_step_s=longest_s) as plant:
            plant.torque([0.9, -0.4, 0.3, 0.5])
            plant.duty([0.2, -0.1, 0.1, 0.15])
            plant.step(0.02, 1)
            ends.append(plant.read((*POSE, *TWIST, *SPEEDS)))
    errors = [np.linalg.norm(end - ends[-1]) for end in ends[:-1]]
    slope, _ = np.polyfit(np.log(steps_s), np.log(errors), 1)
    assert slope == pytest.approx(4.0, abs=0.15)


@pytest.mark.parametrize(
    ("torque", "axis", "inertia"),
    [
        ((1, 1, 1, 1), 0, M + K),
        ((-1, 1, -1, 1), 1, M + K),
        ((-1, 1, 1, -1), 2, (INERTIA + K * L * L) / L),
    ],
    ids=["forward", "left", "turn left"],
)
def test_constant_torque_accelerates_evenly(torque: tuple[int, ...], axis: int, inertia: float) -> None:
    """Four equal torques: acceleration 4 tau / (r (m + k)), in rotation 4 tau L / (r (I + k L^2))."""
    acceleration = 4 * 0.5 / (R * inertia)
    twist, pose = np.zeros(3), np.zeros(3)
    twist[axis], pose[axis] = acceleration, acceleration / 2
    lever = L if axis == 2 else 1.0
    speeds = [t * lever * acceleration / R for t in torque]
    with robot() as plant:
        plant.torque(0.5 * t for t in torque)
        plant.step(1e-3, 1000)
        np.testing.assert_allclose(plant.read(TWIST), twist, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(plant.read(POSE), pose, rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(plant.read(SPEEDS), speeds, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(plant.read(ANGLES), np.array(speeds) / 2, rtol=1e-12, atol=1e-12)


def test_a_free_robot_rolls_on_for_ever() -> None:
    """Without friction and yaw the velocity stays, in any direction, and wheel angles follow the way."""
    start = {"start_heading_rad": 0.5, "start_vx_m_s": 0.7, "start_vy_m_s": -0.4}
    forward, left = 0.7 * np.cos(0.5) - 0.4 * np.sin(0.5), -0.7 * np.sin(0.5) - 0.4 * np.cos(0.5)
    with robot(start) as plant:
        plant.step(0.1, 100)
        np.testing.assert_allclose(plant.read(POSE), [7.0, -4.0, 0.5], rtol=1e-12)
        np.testing.assert_allclose(plant.read(TWIST), [0.7, -0.4, 0.0], rtol=1e-14)
        expected = np.array([forward - left, forward + left, forward - left, forward + left]) * 10 / R
        np.testing.assert_allclose(plant.read(ANGLES), expected, rtol=1e-12)


def test_the_arrangement_o_mirrors_the_sideways_motion() -> None:
    """Its wheel speeds for a motion to the left are those of X for one to the right."""
    with robot(start_vy_m_s=0.3, rollers=O) as ring, robot(start_vy_m_s=-0.3) as cross:
        np.testing.assert_array_equal(ring.read(SPEEDS), cross.read(SPEEDS))


def test_a_square_robot_with_the_arrangement_o_cannot_turn_itself() -> None:
    with robot(rollers=O) as plant:
        plant.torque([-1, 1, 1, -1])
        plant.step(1e-3, 100)
        np.testing.assert_array_equal(plant.read((*POSE, *TWIST, *SPEEDS)), 0.0)


@pytest.mark.parametrize(("coriolis", "ratio"), [(1, K / (M + K)), (2, 1.0)], ids=["rigid", "as printed in the paper"])
def test_coasting_in_a_turn(coriolis: int, ratio: float) -> None:
    """The velocity of a coasting robot turns at k / (m + k) of its yaw rate: the README's analytic case."""
    yaw_rate, v, t = 2.0, 1.5, 2.0
    a = ratio * yaw_rate
    with robot(start_vx_m_s=v, start_yaw_rate_rad_s=yaw_rate, coriolis=coriolis) as plant:
        plant.step(1e-3, 2000)
        pose = (v * np.sin(a * t) / a, v * (1 - np.cos(a * t)) / a, yaw_rate * t)
        np.testing.assert_allclose(plant.read(POSE), pose, rtol=1e-11)
        np.testing.assert_allclose(plant.read(TWIST), (v * np.cos(a * t), v * np.sin(a * t), yaw_rate), rtol=1e-11)


def test_the_wheels_of_the_slip_contact_decide_the_coriolis_term_too() -> None:
    """On stiff rollers a coasting robot turns its velocity at k / (m + k) of its yaw rate, not at the whole of it."""
    with robot(contact=SLIP, start_vx_m_s=1.0, start_yaw_rate_rad_s=2.0, roller_friction_coefficient=0.0) as plant:
        plant.step(1e-3, 1000)
        vx, vy, _ = plant.read(TWIST)
        assert np.arctan2(vy, vx) == pytest.approx(2.0 * K / (M + K), rel=0.01)
        assert np.abs(plant.read(SLIPS)).max() < 1e-3


def test_gears_and_rotors_add_to_the_wheels_inertia() -> None:
    """J = wheel inertia + gear^2 rotor inertia: two ways to the same robot."""
    with robot(gear_ratio=20.0, rotor_inertia_kg_m2=1e-5) as geared, robot(wheel_inertia_kg_m2=0.009) as heavy:
        for plant in (geared, heavy):
            plant.torque([0.4, 0.1, -0.3, 0.2])
            plant.step(1e-3, 500)
        np.testing.assert_allclose(geared.read((*POSE, *SPEEDS)), heavy.read((*POSE, *SPEEDS)), rtol=1e-13)


def test_the_sense_of_every_wheel_is_that_of_the_docs() -> None:
    """One wheel alone pushes along its own roller's diagonal: the front left one forward and to the right."""
    sides = dict(zip(WHEELS, [-1, 1, -1, 1], strict=True))
    for number, side in enumerate(sides.values()):
        with robot() as plant:
            plant.torque(np.eye(4)[number])
            vx, vy = plant.read(("accelerometer.x_m_s2", "accelerometer.y_m_s2"))
            assert vx > 0
            assert vy == pytest.approx(side * vx, rel=1e-14)
