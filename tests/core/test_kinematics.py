"""Laws of the wheel maps, against matrices built from the wheels' geometry."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.kinematics import BodyTwist, body_twist, body_wrench, to_body, to_world, wheel_speeds, wrap_angle
from hil.core.model import RobotModel
from hil.core.types import FourWheels, Twist, Wheels

number = st.floats(-50.0, 50.0)
triple = st.tuples(number, number, number)
four = st.builds(Wheels, number, number, number, number)
radius = st.floats(0.02, 0.3)
half = st.floats(0.05, 1.0)
angle = st.floats(-20.0, 20.0)


def geometry(radius_m: float, half_length_m: float, half_width_m: float) -> np.ndarray:
    """Return the 4 x 3 map from body twist to wheel speeds by the paper's equations 1 and 2."""
    rows = []
    for x, y, roller in ((1, 1, -45), (1, -1, 45), (-1, -1, -45), (-1, 1, 45)):
        contact = np.array([[1, 0, -y * half_width_m], [0, 1, x * half_length_m]])
        rows.append(np.array([1.0, math.tan(math.radians(roller))]) @ contact / radius_m)
    return np.array(rows)


@given(triple, radius, half, half)
def test_wheel_speeds_follow_from_where_the_wheels_and_rollers_are(v, r, l1, l2):
    expected = geometry(r, l1, l2) @ v
    assert wheel_speeds(BodyTwist(*v), r, l1 + l2) == pytest.approx(expected, rel=1e-9, abs=1e-7)


@given(four, radius, half, half)
def test_body_twist_is_the_least_squares_solution(wheels, r, l1, l2):
    expected = np.linalg.pinv(geometry(r, l1, l2)) @ wheels
    assert body_twist(wheels, r, l1 + l2) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(triple, radius, half)
def test_body_twist_undoes_wheel_speeds(v, r, lever):
    assert body_twist(wheel_speeds(BodyTwist(*v), r, lever), r, lever) == pytest.approx(v, rel=1e-9, abs=1e-9)


def wheel_torques(wrench: tuple[float, float, float], r: float, l1: float, l2: float) -> FourWheels:
    """Return the torques of a robot whose acceleration is the force on it: of unit mass, its wheels of none."""
    robot = RobotModel(1.0, 1.0, r, l1, l2, 0.0, 0.0, torque_limit_n_m=1.0, speed_limit_rad_s=1.0)
    still = 0.0, 0.0, 0.0
    return robot.wheel_torques(wrench, still, 0.0, still)


@given(triple, radius, half, half)
def test_wheel_torques_are_the_least_norm_solution(wrench, r, l1, l2):
    expected = np.linalg.pinv(geometry(r, l1, l2).T) @ wrench
    assert wheel_torques(wrench, r, l1, l2) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(triple, radius, half, half)
def test_body_wrench_undoes_wheel_torques(wrench, r, l1, l2):
    back = body_wrench(wheel_torques(wrench, r, l1, l2), r, l1 + l2)
    assert back == pytest.approx(wrench, rel=1e-9, abs=1e-9)


@given(four, triple, radius, half)
def test_the_power_of_the_wheels_is_the_power_of_the_body(torques, v, r, lever):
    at_wheels = np.dot(torques, wheel_speeds(BodyTwist(*v), r, lever))
    at_body = np.dot(body_wrench(torques, r, lever), v)
    assert at_wheels == pytest.approx(at_body, rel=1e-9, abs=1e-6)


@given(triple, angle)
def test_to_world_undoes_to_body_and_keeps_the_speed(v, heading):
    body = to_body(Twist(*v), heading)
    assert to_world(body, heading) == pytest.approx(v, rel=1e-9, abs=1e-9)
    assert math.hypot(*body[:2]) == pytest.approx(math.hypot(*v[:2]), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("body", "turning"),
    [
        (BodyTwist(1, 0, 0), (1, 1, 1, 1)),
        (BodyTwist(0, 1, 0), (-1, 1, -1, 1)),
        (BodyTwist(0, 0, 1), (-1, 1, 1, -1)),
    ],
    ids=["forward", "left", "counter-clockwise"],
)
def test_which_way_the_wheels_turn(body, turning):
    assert wheel_speeds(body, 1.0, 1.0) == turning


def test_left_of_a_robot_that_faces_left_is_backwards_in_the_world():
    assert to_world(BodyTwist(0.0, 1.0, 0.0), math.pi / 2) == pytest.approx((-1.0, 0.0, 0.0))


@given(angle, st.integers(-3, 3))
def test_wrapping_keeps_the_direction(a, turns):
    wrapped = wrap_angle(a + turns * math.tau)
    assert -math.pi <= wrapped <= math.pi
    assert math.cos(wrapped - a) == pytest.approx(1.0)
