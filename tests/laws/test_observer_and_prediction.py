"""The extended state observer and the prediction over the latency, against exact solutions."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.types import Acceleration, Pose, State, Twist, Wheels
from hil.laws.prediction import DelayPredictor, ExtendedStateObserver, PendingCommands, acceleration_of, observer_gains
from hil.references.shapes import Hold
from tests.support.closed_loop import AT_REST, PAPER_ROBOT

DT_S = 0.005
ROBOT = dataclasses.replace(PAPER_ROBOT, friction_coefficient=0.03)

number = st.floats(-10.0, 10.0)
accelerations = st.builds(Acceleration, number, number, number)
twists = st.builds(Twist, number, number, number)


def observer_matrices(bandwidth_rad_s, dt_s):
    """Return how the observer's error goes on: (I - l c) A, for x, v, d and a measured x."""
    step = np.array([[1.0, dt_s, dt_s**2 / 2], [0.0, 1.0, dt_s], [0.0, 0.0, 1.0]])
    gains = np.array(observer_gains(bandwidth_rad_s, dt_s))
    return step - np.outer(gains, step[0])


@given(st.floats(5.0, 200.0), st.sampled_from([0.001, 0.005, 0.01]))
def test_all_poles_of_the_observer_are_where_its_bandwidth_puts_them(bandwidth_rad_s, dt_s):
    beta = math.exp(-bandwidth_rad_s * dt_s)
    characteristic = np.poly(observer_matrices(bandwidth_rad_s, dt_s))
    assert characteristic == pytest.approx(np.poly([beta] * 3), abs=1e-9)


def test_an_observer_of_the_true_start_follows_any_command_without_error():
    observer = ExtendedStateObserver(60.0, 10.0)
    observer.reset(0.3, -0.2)
    x, v = 0.3, -0.2
    for n in range(100):
        u = 5.0 * math.sin(0.7 * n)
        displacement, rate_change = u * DT_S**2 / 2, u * DT_S
        x, v = x + v * DT_S + displacement, v + rate_change
        observer.update(x, displacement, rate_change, DT_S)
        assert (observer.position, observer.rate) == pytest.approx((x, v), abs=1e-12)
    assert observer.disturbance == pytest.approx(0.0, abs=1e-9)


def test_an_observer_finds_a_constant_disturbance_as_its_three_poles_let_it():
    bandwidth_rad_s, disturbance = 60.0, 1.5
    observer = ExtendedStateObserver(bandwidth_rad_s, 10.0)
    transition = observer_matrices(bandwidth_rad_s, DT_S)
    error = np.array([0.0, 0.0, -disturbance])
    for n in range(1, 60):
        t_s = n * DT_S
        observer.update(disturbance * t_s**2 / 2, 0.0, 0.0, DT_S)
        error = transition @ error
        truth = np.array([disturbance * t_s**2 / 2, disturbance * t_s, disturbance])
        found = np.array([observer.position, observer.rate, observer.disturbance])
        assert found - truth == pytest.approx(error, abs=1e-9)
    assert observer.disturbance == pytest.approx(disturbance, abs=1e-3)


def test_the_disturbance_stays_within_its_limit():
    observer = ExtendedStateObserver(60.0, 2.0)
    for sign in (1.0, -1.0):
        for n in range(50):
            observer.update(sign * n, 0.0, 0.0, DT_S)
            assert abs(observer.disturbance) <= 2.0


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_an_observer_without_a_bandwidth_or_a_limit_is_refused(value):
    with pytest.raises(ValueError, match="more than zero"):
        ExtendedStateObserver(value, 1.0)
    with pytest.raises(ValueError, match="more than zero"):
        ExtendedStateObserver(60.0, value)


@given(st.lists(accelerations, min_size=1, max_size=12), st.floats(0.0, 0.03), st.sampled_from([0.001, 0.005, 0.01]))
def test_the_prediction_is_that_of_an_integrator_that_knows_when_each_command_acts(commands, latency_s, dt_s):
    """Since each tick, and over the latency ahead of the last one, for any latency in periods."""
    on_their_way = PendingCommands()
    position, rate = np.zeros(3), np.zeros(3)

    def move(moved, time_s):
        nonlocal position, rate
        position, rate = position + time_s * rate + np.array(moved[:3]), rate + np.array(moved[3:])

    def exact(until_s):
        x, v, a, at_s = np.zeros(3), np.zeros(3), np.zeros(3), 0.0
        for n, following in enumerate([*map(np.array, commands), None]):
            d = (until_s if following is None else max(min(n * dt_s + latency_s, until_s), at_s)) - at_s
            x, v, at_s = x + d * v + d * d / 2 * a, v + d * a, at_s + d
            a = following
        return np.array([x, v])

    for n, command in enumerate(commands):
        move(on_their_way.advance(command, latency_s, dt_s), dt_s)
        assert np.array([position, rate]) == pytest.approx(exact((n + 1) * dt_s), abs=1e-9)
    move(on_their_way.motion(latency_s), latency_s)
    assert np.array([position, rate]) == pytest.approx(exact(len(commands) * dt_s + latency_s), abs=1e-9)


@pytest.mark.parametrize("from_observers", [True, False])
def test_from_observers_a_prediction_needs_no_measured_speed(from_observers):
    """A push without a command moves a robot that was commanded to stand; its measured speed is zero."""
    prediction = DelayPredictor(
        PAPER_ROBOT, tuple(ExtendedStateObserver(60.0, 5.0) for _ in range(3)), from_observers=from_observers
    )
    goal, still, push_m_s2, latency_s = Hold().at(0.0), Twist(0.0, 0.0, 0.0), 2.0, 0.02
    prediction.reset(State(goal.pose, still))
    for n in range(61):
        state = State(Pose(push_m_s2 * (n * DT_S) ** 2 / 2, 0.0, 0.0), still)
        ahead = prediction.predict(goal, state, AT_REST._replace(latency_s=latency_s), DT_S)
    end_s = 60 * DT_S + latency_s
    truth = push_m_s2 * end_s**2 / 2, push_m_s2 * end_s
    error, _, _, twist = ahead
    found = error[0], twist[0]
    if from_observers:
        assert found == pytest.approx(truth, abs=1e-3)
    else:
        assert found == pytest.approx((truth[0] - latency_s * push_m_s2 * 60 * DT_S, push_m_s2 * latency_s), abs=1e-3)


def test_a_robot_that_turns_beyond_half_a_turn_is_not_disturbed_by_that():
    """Its heading goes on at -π, where nothing pushes it."""
    prediction = DelayPredictor(PAPER_ROBOT, tuple(ExtendedStateObserver(60.0, 5.0) for _ in range(3)))
    turning = Twist(0.0, 0.0, 1.0)
    prediction.reset(State(Pose(0.0, 0.0, 3.1), turning))
    for n in range(31):
        state = State(Pose(0.0, 0.0, math.remainder(3.1 + n * DT_S, math.tau)), turning)
        prediction.predict(Hold().at(0.0), state, AT_REST, DT_S)
    assert state.pose.heading_rad < -3.0
    assert prediction.disturbance == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)


def test_a_command_that_a_later_one_overtakes_never_acts():
    on_their_way = PendingCommands()
    late, early = Acceleration(1.0, 0.0, 0.0), Acceleration(0.0, 2.0, 0.0)
    on_their_way.advance(late, 0.020, DT_S)
    on_their_way.advance(early, 0.005, DT_S)
    assert on_their_way.motion(0.1)[3:5] == pytest.approx((0.0, 0.2))


def test_after_a_reset_nothing_is_on_its_way():
    on_their_way = PendingCommands()
    on_their_way.advance(Acceleration(1.0, 1.0, 1.0), 0.005, DT_S)
    on_their_way.reset()
    assert on_their_way.motion(1.0) == (0.0,) * 6


@given(accelerations, twists, st.floats(-3.0, 3.0), twists, st.floats(-5.0, 5.0))
def test_the_acceleration_of_the_models_torques_is_the_one_asked_for(acceleration, twist, heading_rad, moving, against):
    torque = ROBOT.wheel_torques(acceleration, twist, heading_rad, moving)
    # Rollers that pull the front against the rear move nothing.
    nothing = Wheels(against, against, -against, -against)
    torque = Wheels(*(a + b for a, b in zip(torque, nothing, strict=True)))
    assert acceleration_of(ROBOT, torque, twist, heading_rad, moving) == pytest.approx(acceleration, abs=1e-9)
