"""The latency from motion: found on a robot that is integrated here, and not where nothing shows."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hil
from hil.core.model import RobotModel
from hil.core.types import Pose, State, Twist, Wheels
from hil.robot.motion_echo import MotionEcho

MODEL = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, 0.03, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)
TOLD_S = 0.004
_FINE_S = 1e-4


def driven(
    latency_s: float, tick_s: float, mass_kg: float, friction_n: float, heading_rad: float, rng_seed: int
) -> MotionEcho:
    """Drive a point mass with random torques that act ``latency_s`` late; every tick is told to the estimator."""
    rng, echo = np.random.default_rng(rng_seed), MotionEcho(MODEL, TOLD_S)
    sent: list[tuple[float, float]] = []  # from when it acts, the force along the heading
    speed, now_s, torque_n_m = 0.0, 0.0, 0.0
    effective_kg = mass_kg + MODEL.wheels_mass_kg
    for tick in range(round(1.5 / tick_s)):
        at_s = tick * tick_s
        while now_s < at_s - 0.5 * _FINE_S:
            force = next((one for from_s, one in reversed(sent) if from_s <= now_s + 1e-9), 0.0)
            speed += _FINE_S * (force - friction_n * math.tanh(speed / 0.01)) / effective_kg
            now_s += _FINE_S
        if tick % max(1, round(0.02 / tick_s)) == 0:
            torque_n_m = 0.5 * rng.uniform(-1.0, 1.0)
        twist = Twist(speed * math.cos(heading_rad), speed * math.sin(heading_rad), 0.0)
        state, at_ns = State(Pose(0.0, 0.0, heading_rad), twist), round(at_s * 1e9)
        echo.update(Wheels(*[torque_n_m] * 4), state, at_ns, is_limited=False)
        sent.append((at_s + latency_s, 4.0 * torque_n_m / MODEL.wheel_radius_m))
    return echo


@settings(max_examples=12, deadline=None)
@given(
    st.integers(4, 40),
    st.sampled_from([0.001, 0.002, 0.004, 0.005, 0.01]),
    st.floats(10.0, 40.0),
    st.floats(0.0, 8.0),
    st.floats(-math.pi, math.pi),
    st.integers(0, 1000),
)
def test_the_latency_of_a_mass_with_friction_is_found_to_three_milliseconds(
    late_ms: int, tick_s: float, mass_kg: float, friction_n: float, heading_rad: float, rng_seed: int
):
    echo = driven(late_ms * 1e-3, tick_s, mass_kg, friction_n, heading_rad, rng_seed)
    assert echo.s == pytest.approx(late_ms * 1e-3, abs=0.0031)


def test_a_robot_at_rest_or_one_that_does_not_follow_teaches_nothing():
    echo, rng = MotionEcho(MODEL, TOLD_S), np.random.default_rng(1)
    for tick in range(400):
        state = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
        assert echo.update(Wheels(0.0, 0.0, 0.0, 0.0), state, tick * 5_000_000, is_limited=False) == TOLD_S
    for tick in range(400, 800):
        state = State(Pose(0.0, 0.0, 0.0), Twist(*rng.uniform(-0.1, 0.1, 2), 0.0))
        torque = Wheels(*[rng.uniform(-1.0, 1.0)] * 4)
        assert echo.update(torque, state, tick * 5_000_000, is_limited=False) == TOLD_S


def test_nothing_is_learnt_where_the_limiter_acts_and_a_reset_clock_begins_anew():
    echo = MotionEcho(MODEL, TOLD_S)
    for tick in range(200):
        pushed = 1.0 if tick // 4 % 2 else -1.0
        state = State(Pose(0.0, 0.0, 0.0), Twist(0.1 * (tick % 4), 0.0, 0.0))
        assert echo.update(Wheels(*[pushed] * 4), state, tick * 5_000_000, is_limited=True) == TOLD_S
    assert echo.update(Wheels(1.0, 1.0, 1.0, 1.0), state, 0, is_limited=False) == TOLD_S


@pytest.mark.parametrize("driver", ["odrive", "vesc"])
def test_a_delay_on_commands_that_nobody_told_is_found_through_a_makers_driver(driver: str):
    sets = {
        "device.driver": driver,
        "controller.command": "torque",
        "controller.law": "profile",
        "loop.duration_s": 1.0,
        "fault": [{"kind": "delay", "target": "command", "value": 0.015}],
        "expect": [],
    }
    result = hil.run("compare_circle", set=sets, lenient=True)
    assert result.signals["link.latency_ms"][-1] == pytest.approx(20.0, abs=2.0)
