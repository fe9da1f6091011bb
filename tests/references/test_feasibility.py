"""The wheel speeds and torques that a reference needs, compared with an independent computation by matrices."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.model import RobotModel
from hil.references import Feasibility, feasibility
from hil.references.shapes import Circle, Hold, Spin
from tests.references.test_references import circles, eights, routes, spins, squares
from tests.support.examples import share_of_examples

MASS, INERTIA, RADIUS, LEVER, WHEEL_INERTIA, FRICTION = 24.0, 0.8, 0.08, 0.55, 0.006, 0.02
WHEELS = ("fl", "fr", "rr", "rl")


def robot(speed_limit: float, torque_limit: float) -> RobotModel:
    return RobotModel(
        MASS,
        INERTIA,
        RADIUS,
        0.3,
        0.25,
        WHEEL_INERTIA,
        FRICTION,
        torque_limit_n_m=torque_limit,
        speed_limit_rad_s=speed_limit,
    )


def demanded(source, t_s: np.ndarray):
    """Return wheel speeds and torques, each of shape (times, 4): one dense system a time, solved by least squares."""
    h = np.array([[1, -1, -LEVER], [1, 1, LEVER], [1, -1, LEVER], [1, 1, -LEVER]])
    k = 4 * WHEEL_INERTIA / RADIUS**2
    mass = np.diag([MASS + k, MASS + k, INERTIA + k * LEVER**2])
    speeds, torques = [], []
    for t in t_s:
        (_, _, heading), twist, acceleration = (np.array(part) for part in source.at(t))
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        speed = h @ turn.T @ twist / RADIUS
        force = mass @ acceleration + k * twist[2] * np.array([twist[1], -twist[0], 0])
        friction = FRICTION * MASS * 9.81 * RADIUS / 4 * np.tanh(speed / 0.3)
        torques.append(np.linalg.pinv(turn @ h.T / RADIUS) @ force + friction)
        speeds.append(speed)
    return np.array(speeds), np.array(torques)


@share_of_examples(0.25)
@given(st.one_of(circles, eights, squares, spins, routes), st.floats(2.0, 20.0), st.floats(0.05, 2.0))
def test_requirements_agree_with_an_independent_computation(source, speed_limit, torque_limit):
    found = feasibility(source, robot(speed_limit, torque_limit), 5.0, 0.02)
    t_s = np.arange(int(min(5.0, source.span_s) / 0.02 + 1e-9) + 1) * 0.02
    for demand, values, limit in zip(found[:2], demanded(source, t_s), (speed_limit, torque_limit), strict=True):
        sizes = abs(values)
        assert demand.limit == limit
        assert demand.worst == pytest.approx(sizes.max(), abs=1e-9)
        at = sizes[round(demand.worst_s / 0.02)]
        assert at[WHEELS.index(demand.worst_wheel)] == pytest.approx(sizes.max(), abs=1e-9)
        over = np.flatnonzero(sizes.max(axis=1) > limit + 1e-9)
        if len(over):
            assert demand.first_s == pytest.approx(t_s[over[0]])
            first = sizes[over[0]]
            assert demand.first == pytest.approx(first.max())
            assert first[WHEELS.index(demand.first_wheel)] == pytest.approx(first.max())
        else:
            assert demand.first is None or demand.first == pytest.approx(limit, abs=1e-8)


@share_of_examples(0.15)
@given(st.floats(0.3, 3.0), st.floats(4.0, 15.0), st.floats(-4.0, 4.0))
def test_a_circle_with_a_fixed_heading_asks_for_the_diagonal_of_its_speed(radius, period, heading):
    speed = feasibility(Circle(radius, period, heading), robot(20.0, 2.0), 1e4, 0.01).speed
    assert speed.worst == pytest.approx(math.sqrt(2.0) * math.tau * radius / period / RADIUS, rel=1e-4)


def test_a_periodic_reference_is_sampled_over_one_period_only():
    assert feasibility(Hold(1.0, 2.0, 3.0), robot(20.0, 2.0), 1e9, 0.001).speed.worst == 0.0
    calls: list[float] = []

    class Counted(Spin):
        def at(self, t_s):
            calls.append(t_s)
            return Spin.at(self, t_s)

    feasibility(Counted(yaw_rate_rad_s=1e-3), robot(20.0, 2.0), 86_400.0, 0.001)
    assert len(calls) <= 20_001
    assert calls[-1] == pytest.approx(math.tau / 1e-3, rel=1e-3)
    for period_s, step_s in ((0.001, 0.01), (0.02, 0.02)):
        calls.clear()
        feasibility(Counted(), robot(20.0, 2.0), 0.1, period_s)
        assert calls == pytest.approx([number * step_s for number in range(round(0.1 / step_s) + 1)])


def test_a_requirement_beyond_the_limit_gives_one_warning():
    source = Circle(1.0, 4.0)
    assert feasibility(source, robot(40.0, 2.1), 10.0, 0.01).sentences == ()
    speed, torque = feasibility(source, robot(20.0, 0.6), 10.0, 0.01).sentences
    assert speed == (
        "wheel fl would need 20.2 rad/s at t = 0.02 s, its limit is 20 rad/s; at most wheel fl 27.8 rad/s at "
        "t = 0.5 s: the robot cannot follow this reference, make it slower"
    )
    assert "N·m" in torque


@pytest.mark.parametrize(("apart_s", "is_noted"), [(0.009, False), (-0.009, False), (0.011, True), (-0.011, True)])
def test_an_end_a_step_from_the_run_s_is_no_note(apart_s, is_noted):
    wide = robot(20.0, 2.0)
    speed, torque, *_ = feasibility(Hold(), wide, 1.0, 0.01)
    assert bool(Feasibility(speed, torque, 5.0 + apart_s, 5.0).notes) == is_noted
