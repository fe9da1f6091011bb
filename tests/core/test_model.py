"""The inverse dynamics, against Newton and Euler for a platform and its wheels."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.model import RobotModel
from hil.core.types import Acceleration, Twist

ROBOT = RobotModel(
    mass_kg=20.0,
    inertia_kg_m2=0.56,
    wheel_radius_m=0.075,
    half_length_m=0.3,
    half_width_m=0.25,
    wheel_inertia_kg_m2=0.005,
    friction_coefficient=0.0,
    torque_limit_n_m=5.0,
    speed_limit_rad_s=60.0,
)
number = st.floats(-5.0, 5.0)
triple = st.tuples(number, number, number)


def newton_euler(robot: RobotModel, a: np.ndarray, v: np.ndarray, heading: float) -> np.ndarray:
    """Return the wheel torques of least norm by balancing the platform and each wheel, in the body frame.

    Nothing here knows of C: it is in the wheels' angular acceleration, since the body frame turns.
    """
    lever = robot.half_length_m + robot.half_width_m
    h = np.array([[1, -1, -lever], [1, 1, lever], [1, -1, lever], [1, 1, -lever]])
    c, s = math.cos(heading), math.sin(heading)
    to_body = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turning = v[2] * np.array([[-s, c, 0], [-c, -s, 0], [0, 0, 0]])  # d(to_body)/dt
    wheel_acceleration = h @ (to_body @ a + turning @ v) / robot.wheel_radius_m
    inertia = np.diag([robot.mass_kg, robot.mass_kg, robot.inertia_kg_m2])
    traction = np.linalg.pinv(h.T) @ inertia @ to_body @ a
    return robot.wheel_inertia_kg_m2 * wheel_acceleration + robot.wheel_radius_m * traction


@given(triple, triple, st.floats(-7.0, 7.0))
def test_torques_balance_the_platform_and_each_wheel(a, v, heading):
    torques = ROBOT.wheel_torques(Acceleration(*a), Twist(*v), heading, (0.0, 0.0, 0.0))
    expected = newton_euler(ROBOT, np.array(a), np.array(v), heading)
    assert torques == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(triple, triple, st.floats(-7.0, 7.0), st.sampled_from([tuple, list, np.array]))
def test_torques_are_to_the_bit_those_of_the_formula_and_take_any_sequence(a, v, heading, kind):
    mass, coupling = ROBOT.effective_mass_kg, ROBOT.wheels_mass_kg * v[2]
    fx, fy = mass * a[0] + coupling * v[1], mass * a[1] - coupling * v[0]
    c, s, quarter = math.cos(heading), math.sin(heading), ROBOT.wheel_radius_m / 4.0
    forward, left = quarter * (c * fx + s * fy), quarter * (c * fy - s * fx)
    turn = quarter * (ROBOT.effective_inertia_kg_m2 * a[2]) / ROBOT.lever_m
    minus, plus = forward - left, forward + left
    found = ROBOT.wheel_torques(kind(a), kind(v), heading, (0.0, 0.0, 0.0))
    assert found == (minus - turn, plus + turn, minus + turn, plus - turn)


@given(triple, st.floats(-7.0, 7.0))
def test_wheel_speeds_and_twist_are_inverse(v, heading):
    back = ROBOT.twist(ROBOT.wheel_speeds(Twist(*v), heading), heading)
    assert back == pytest.approx(v, rel=1e-9, abs=1e-9)


def test_friction_is_added_with_the_sign_of_the_intended_speed():
    robot = dataclasses.replace(ROBOT, friction_coefficient=0.04)
    still = Acceleration(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), math.pi / 2
    full = 0.04 * 20.0 * 9.81 * 0.075 / 4
    # Forward and left by as much: the wheels FL and RR stand, the others turn.
    for speed_rad_s, expected in ((9.0, full), (-9.0, -full), (0.3, full * math.tanh(1.0))):
        along = speed_rad_s * 0.075 / 2
        torque = robot.wheel_torques(*still, Twist(-along, along, 0.0))
        assert torque == pytest.approx((0.0, expected, 0.0, expected), abs=1e-12)


def test_what_follows_from_the_numbers():
    k = 4 * 0.005 / 0.075**2
    assert ROBOT.lever_m == pytest.approx(0.55)
    assert ROBOT.wheels_mass_kg == pytest.approx(k)
    assert ROBOT.effective_mass_kg == pytest.approx(20.0 + k)
    assert ROBOT.effective_inertia_kg_m2 == pytest.approx(0.56 + k * 0.55**2)


def test_a_robot_is_shown_and_compared_by_the_numbers_that_were_given():
    given = [f.name for f in dataclasses.fields(RobotModel) if f.init]
    assert repr(ROBOT) == f"RobotModel({', '.join(f'{name}={getattr(ROBOT, name)!r}' for name in given)})"
    assert dataclasses.replace(ROBOT) == ROBOT
    assert hash(dataclasses.replace(ROBOT)) == hash(ROBOT)
    assert dataclasses.replace(ROBOT, half_width_m=0.3) != ROBOT


def test_a_changed_copy_follows_its_own_numbers():
    assert dataclasses.replace(ROBOT, mass_kg=30.0).effective_mass_kg - ROBOT.effective_mass_kg == 10.0


@pytest.mark.parametrize("name", [f.name for f in dataclasses.fields(RobotModel) if f.init])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_impossible_numbers_are_refused_by_name(name, value):
    with pytest.raises(BadInputError, match=rf"robot\.{name} = {value}; expected"):
        dataclasses.replace(ROBOT, **{name: value})


def test_what_may_be_zero():
    robot = dataclasses.replace(ROBOT, wheel_inertia_kg_m2=0.0, friction_coefficient=0.0)
    assert robot.effective_mass_kg == 20.0
    with pytest.raises(BadInputError, match="greater than 0"):
        dataclasses.replace(ROBOT, mass_kg=0.0)
