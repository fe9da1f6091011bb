"""PID, computed torque, LQI, and the surfaces with feedforward bypass and observer: what their equations promise."""

import dataclasses
import math
from collections import deque

import numpy as np
import pytest
import scipy.linalg
import scipy.signal
from hypothesis import assume, given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.options import build
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Applied,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.laws.law_registry import shipped_laws
from hil.laws.lqi import lqr_gain
from hil.laws.surface import Dsc
from hil.references.shapes import Hold
from tests.support.closed_loop import AT_REST, PAPER_CIRCLE, PAPER_ROBOT, after, derivative
from tests.support.examples import share_of_examples

SHIPPED = shipped_laws()

DT_S = 0.005
TORQUE_LAWS = ["pid", "computed_torque", "lqi", "dsc_eso", "afdsc_eso", "mpc"]
MODEL_LAWS = TORQUE_LAWS[1:]
TORQUE_ALONE = ["computed_torque", "mpc"]
SPEED_LAWS = ["pid", "lqi", "dsc_eso", "afdsc_eso"]
NO_SETPOINT = Applied(WheelCommand(CommandMode.SPEED, ZERO_WHEELS, ZERO_WHEELS), False, 0.0)

coordinate = st.floats(-2.0, 2.0)
poses = st.builds(Pose, coordinate, coordinate, st.floats(-3.0, 3.0))
twists = st.builds(Twist, coordinate, coordinate, coordinate)
states = st.builds(State, poses, twists)
references = st.builds(Reference, poses, twists, st.builds(Acceleration, coordinate, coordinate, coordinate))


def made(name, mode=CommandMode.TORQUE, robot=PAPER_ROBOT, **options):
    law = SHIPPED[name]
    return law(robot, mode, law.Options(**options))


def drive(law, reference_at, start, ticks, *, delay=0, told_s=0.0, limit_n_m=1e3, push=ZERO_WHEELS):
    """Let a law drive the robot by torques that act ``delay`` ticks late, with a push that it does not know of.

    Returns the motion at each tick.
    """
    guard = Guard(60.0, limit_n_m)
    motion = (*start, 0.0, 0.0, 0.0)
    waiting = deque([ZERO_WHEELS] * delay)
    applied = Applied(AT_REST.command, False, told_s)
    motions = [motion]
    for number in range(ticks):
        reference = reference_at(number * DT_S)
        state = State(Pose(*motion[:3]), Twist(*motion[3:]))
        if number == 0:
            law.reset(state, reference)
        command, saturated = guard.apply(law.update(reference, state, applied, DT_S))
        applied = Applied(command, saturated, told_s)
        waiting.append(command.torque_n_m)
        acting = Wheels(*(a + b for a, b in zip(waiting.popleft(), push, strict=True)))
        motion = after(PAPER_ROBOT, motion, acting, DT_S)
        motions.append(motion)
    return motions


def distance(motion, pose):
    return math.hypot(motion[0] - pose.x_m, motion[1] - pose.y_m)


# ---------------------------------------------------------------------------------------------------- all of them


@pytest.mark.parametrize("name", MODEL_LAWS)
@given(reference=references)
def test_on_the_reference_the_robot_gets_the_reference_s_acceleration(name, reference):
    turning = PAPER_ROBOT.wheel_speeds(reference.twist, reference.pose.heading_rad)
    assume(name != "mpc" or max(map(abs, turning)) <= PAPER_ROBOT.speed_limit_rad_s)  # which it keeps at any cost
    law = made(name)
    state = State(reference.pose, reference.twist)
    law.reset(state, reference)
    torque = law.update(reference, state, AT_REST, DT_S).torque_n_m
    found = derivative(PAPER_ROBOT, (*state.pose, *state.twist), torque)[3:]
    assert found == pytest.approx(reference.acceleration, abs=1e-9)


@pytest.mark.parametrize("name", SPEED_LAWS)
@given(reference=references)
def test_on_the_reference_the_wheels_turn_as_it_moves(name, reference):
    law = made(name, CommandMode.SPEED)
    state = State(reference.pose, reference.twist)
    law.reset(state, reference)
    command = law.update(reference, state, NO_SETPOINT, DT_S)
    found = PAPER_ROBOT.twist(command.speed_rad_s, state.pose.heading_rad)
    assert found == pytest.approx(reference.twist, abs=1e-9)
    rates = derivative(PAPER_ROBOT, (*state.pose, *state.twist), command.torque_n_m)
    assert rates[3:] == pytest.approx(reference.acceleration, abs=1e-9)


@pytest.mark.parametrize("name", MODEL_LAWS)
@pytest.mark.parametrize("delay", [1, 3])
def test_a_latency_that_is_told_only_shifts_the_motion(name, delay):
    """To a pose to reach, without turning: an axis is then a double integrator, which the prediction knows exactly."""
    goal, start = Hold(0.3, -0.2, 0.4), Pose(0.0, 0.0, 0.4)
    prompt = drive(made(name), goal.at, start, 100)
    late = drive(made(name), goal.at, start, 100 + delay, delay=delay, told_s=delay * DT_S)
    assert np.array(late[delay:]) == pytest.approx(np.array(prompt), abs=1e-9)
    unaware = drive(made(name), goal.at, start, 100 + delay, delay=delay)
    assert np.abs(np.array(unaware[delay:]) - np.array(prompt)).max() > 1e-3


@pytest.mark.parametrize("name", MODEL_LAWS)
def test_the_latency_is_compensated_when_the_guard_limits_too(name):
    goal, start = Hold(0.5, 0.0, 0.0), Pose(0.0, 0.0, 0.0)
    prompt = drive(made(name), goal.at, start, 150, limit_n_m=3.0)
    late = drive(made(name), goal.at, start, 152, delay=2, told_s=2 * DT_S, limit_n_m=3.0)
    assert np.array(late[2:]) == pytest.approx(np.array(prompt), abs=1e-9)


@pytest.mark.parametrize("name", ["lqi", "dsc_eso", "afdsc_eso", "mpc", "pid"])
def test_a_constant_push_leaves_no_error(name):
    goal = Hold(0.0, 0.0, 0.3)
    at_rest = drive(made(name), goal.at, Pose(0.0, 0.0, 0.3), 1000, push=Wheels(0.3, 0.2, 0.1, 0.3))[-1]
    assert distance(at_rest, goal.at(0.0).pose) < 1e-5
    assert at_rest[2] == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize("name", TORQUE_LAWS)
def test_the_circle_is_tracked_without_the_filter_s_lag(name):
    """DSC's error there is ς ω² r / K1; what is left here is the tick's."""
    last = drive(made(name), PAPER_CIRCLE.at, PAPER_CIRCLE.at(0.0).pose, 800, delay=1, told_s=DT_S, limit_n_m=5.0)[-1]
    assert distance(last, PAPER_CIRCLE.at(800 * DT_S).pose) < 1e-4


@pytest.mark.parametrize("mode", CommandMode)
@pytest.mark.parametrize("name", SHIPPED)
@given(state=states, reference=references, before=states)
@share_of_examples(0.2)
def test_reset_forgets_whatever_was_before(name, mode, state, reference, before):
    if name in TORQUE_ALONE and mode is CommandMode.SPEED:
        return
    fresh, used = made(name, mode), made(name, mode)
    command = WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS)
    late = Applied(command, False, 0.007)
    used.reset(before, reference)
    for _ in range(3):
        late = late._replace(command=used.update(reference, before, late, DT_S))
    rest = Applied(command, False, 0.007)
    commands = []
    for law in (fresh, used):
        law.reset(state, reference)
        commands.append(law.update(reference, state, rest, DT_S))
    assert commands[0] == commands[1]


@pytest.mark.parametrize("name", TORQUE_ALONE)
def test_a_law_that_computes_torques_refuses_speed_commands(name):
    with pytest.raises(BadInputError, match=r"set controller\.command = 'torque'"):
        made(name, CommandMode.SPEED)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("computed_torque", {"damping": 0.0}, "damping = 0.0; expected a number greater than 0"),
        ("pid", {"ki_1_s2": -1.0}, "ki_1_s2 = -1.0; expected a number from 0 to 10000"),
        ("lqi", {"speed_error_1_s2": 0.0}, "speed_error_1_s2 = 0.0; expected a number greater than 0"),
        ("dsc_eso", {"observer_rad_s": -1.0}, "observer_rad_s = -1.0; expected a number greater than 0"),
        ("afdsc_eso", {"error_range_m": 0.0}, "error_range_m = 0.0; expected a number greater than 0"),
        ("afdsc_eso", {"filter_s": 0.0}, "filter_s = 0.0; expected a number greater than 0"),
    ],
)
def test_options_out_of_range(name, options, message):
    with pytest.raises(BadInputError, match=f"controller.gains.{message}"):
        build(SHIPPED[name].Options, options, "controller.gains")


# ---------------------------------------------------------------------------------------------------- one by one


@pytest.mark.parametrize("damping", [0.7, 1.0, 1.6])
def test_computed_torque_decays_as_the_second_order_system(damping):
    """Against the exact response of the sampled double integrator, by the matrix exponential."""
    frequency = 6.0
    law = made("computed_torque", frequency_rad_s=frequency, damping=damping)
    goal = Hold(0.0, 0.0, 0.2)
    motions = np.array(drive(law, goal.at, Pose(0.4, -0.3, 0.2), 200))
    held = scipy.linalg.expm(np.array([[0, 1, 0], [0, 0, 1], [0, 0, 0]]) * DT_S)
    feedback = np.array([[frequency**2, 2 * damping * frequency]])
    closed = held[:2, :2] - held[:2, 2:] @ feedback
    expected = np.array([np.linalg.matrix_power(closed, n) @ [1.0, 0.0] for n in range(201)])[:, 0]
    assert motions[:, 0] == pytest.approx(0.4 * expected, abs=1e-9)
    assert motions[:, 1] == pytest.approx(-0.3 * expected, abs=1e-9)


@given(
    weights=st.lists(st.floats(1e-2, 1e6), min_size=3, max_size=3),
    control=st.floats(1e-2, 1e2),
    dt_s=st.sampled_from([0.001, 0.005, 0.02]),
)
@share_of_examples(0.2)
def test_the_riccati_equation_is_solved_as_scipy_does(weights, control, dt_s):
    a = np.array([[1.0, dt_s, dt_s**2 / 2], [0.0, 1.0, dt_s], [0.0, 0.0, 1.0]])
    b = np.array([[dt_s**3 / 6], [dt_s**2 / 2], [dt_s]])
    q, r = np.diag(weights), np.array([[control]])
    cost = scipy.linalg.solve_discrete_are(a, b, q, r)
    expected = np.linalg.solve(r + b.T @ cost @ b, b.T @ cost @ a)
    assert lqr_gain(a, b, q, r) == pytest.approx(expected, rel=1e-5)


def test_what_no_input_reaches_cannot_be_stabilised():
    a, b = np.diag([1.2, 0.5]), np.array([[0.0], [1.0]])
    with pytest.raises(ValueError, match="no stabilising solution"):
        lqr_gain(a, b, np.eye(2), np.eye(1))


def test_weights_of_which_no_gains_follow_are_bad_input():
    law = made("lqi", torque_integral_1_s6=1e-250, torque_error_1_s4=1e-250, torque_rate_1_s2=1e-250)
    reference = PAPER_CIRCLE.at(0.0)
    state = State(reference.pose, reference.twist)
    law.reset(state, reference)
    with pytest.raises(BadInputError) as refused:
        law.update(reference, state, AT_REST, DT_S)
    assert str(refused.value) == (
        "controller.gains: no gains exist for the weights [1e-250, 1e-250, 1e-250] at 200 Hz (the Riccati equation has "
        "no stabilising solution for these weights); take weights nearer to the defaults"
    )


@pytest.mark.parametrize("mode", CommandMode)
@pytest.mark.parametrize("name", ["pid", "lqi"])
def test_the_integral_stands_still_while_the_guard_limits(name, mode):
    reference = PAPER_CIRCLE.at(0.0)
    state = State(reference.pose._replace(x_m=reference.pose.x_m + 0.1), reference.twist)
    limited = Applied(WheelCommand(mode, ZERO_WHEELS, ZERO_WHEELS), True, 0.0)
    commands = {}
    for saturated in (True, False):
        law = made(name, mode)
        law.reset(state, reference)
        law.update(reference, state, limited, DT_S)
        # No applied command is reported, so only the integral can change the output.
        for _ in range(20):
            commands[saturated] = law.update(reference, state, limited._replace(saturated=saturated), DT_S)
        if saturated:
            fresh = made(name, mode)
            fresh.reset(state, reference)
            assert commands[True] == fresh.update(reference, state, limited, DT_S)
    assert commands[True] != commands[False]


def test_pid_in_torque_mode_knows_neither_mass_nor_friction():
    heavy = dataclasses.replace(PAPER_ROBOT, mass_kg=80.0, inertia_kg_m2=5.0, friction_coefficient=0.3)
    reference = PAPER_CIRCLE.at(1.0)
    state = State(Pose(0.0, 0.0, 0.0), Twist(0.1, 0.2, 0.3))
    commands = []
    for robot in (PAPER_ROBOT, heavy):
        law = made("pid", robot=robot)
        law.reset(state, reference)
        commands.append([law.update(reference, state, AT_REST, DT_S) for _ in range(3)])
    assert commands[0] == commands[1]


@given(
    speeds=st.lists(coordinate, min_size=1, max_size=40),
    filter_s=st.floats(0.005, 0.5),
    dt_s=st.sampled_from([0.001, 0.005, 0.02]),
)
@share_of_examples(0.3)
def test_the_filter_s_steps_are_the_exact_solution_for_an_input_that_is_held(speeds, filter_s, dt_s):
    """ς ẋ + x = x̄2 by SciPy's zero-order hold; x is what DSC's torque tells of it for a robot at rest."""
    k2 = 40.0
    law = made("dsc", k2_1_s=k2, filter_s=filter_s)
    still = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
    at = Hold().at(0.0)
    law.reset(still, at)
    share = -math.expm1(-dt_s / filter_s)
    found = []
    for speed in speeds:
        moving = at._replace(twist=Twist(speed, 0.0, 0.0))
        torque = law.update(moving, still, AT_REST, dt_s).torque_n_m
        asked = derivative(PAPER_ROBOT, (0.0,) * 6, torque)[3]  # (x̄2 - x) share / dt + K2 x
        found.append((asked - share / dt_s * speed) / (k2 - share / dt_s))
    system = tuple(np.array([[value]]) for value in (-1 / filter_s, 1 / filter_s, 1.0, 0.0))
    a, b, *_ = scipy.signal.cont2discrete(system, dt_s, "zoh")
    expected = [0.0]
    for speed in speeds[:-1]:
        expected.append(a[0, 0] * expected[-1] + b[0, 0] * speed)
    # Where both gains are nearly the same the torque tells nothing of x.
    if abs(k2 - share / dt_s) > 1.0:
        assert found == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("name", ["dsc_eso", "afdsc_eso"])
def test_the_bypass_takes_the_reference_past_the_filter(name):
    """A slow filter, a robot on the reference: DSC lags behind on the circle, with the bypass nothing changes."""
    slow = made(name, filter_s=0.5)
    last = drive(slow, PAPER_CIRCLE.at, PAPER_CIRCLE.at(0.0).pose, 1000, delay=1, told_s=DT_S)[-1]
    assert distance(last, PAPER_CIRCLE.at(1000 * DT_S).pose) < 3e-4
    lagging = Dsc(PAPER_ROBOT, CommandMode.TORQUE, Dsc.Options(filter_s=0.5))
    last = drive(lagging, PAPER_CIRCLE.at, PAPER_CIRCLE.at(0.0).pose, 1000)[-1]
    assert distance(last, PAPER_CIRCLE.at(1000 * DT_S).pose) > 1e-3


def test_afdsc_eso_has_afdsc_s_gains_and_in_speed_mode_k1_alone():
    reference = PAPER_CIRCLE.at(0.0)
    state = State(Pose(0.7, 0.1, 0.2), Twist(0.1, 0.0, 0.0))
    gains = []
    for name in ("afdsc_corrected", "afdsc_eso"):
        law = made(name)
        law.reset(state, reference)
        gains.append(law.gains)
    assert gains[0] == gains[1]
    for name in ("dsc_eso", "afdsc_eso"):
        law = made(name, CommandMode.SPEED)
        law.reset(state, reference)
        assert all(map(math.isnan, law.gains[3:]))
        assert all(map(math.isfinite, law.gains[:3]))


@pytest.mark.parametrize("name", ["dsc_eso", "afdsc_eso", "mpc"])
def test_no_push_is_believed_to_be_more_than_the_page_says(name):
    """Within ±3 m/s² and ±10 rad/s² (LAWS.md), however far a measured pose leaps."""
    goal = Hold(0.0, 0.0, 0.0).at(0.0)
    for sign in (1.0, -1.0):
        law = made(name)
        state = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
        law.reset(state, goal)
        for number in range(20):
            x = sign * 0.02 * number**2
            law.update(goal, State(Pose(x, -x, 0.1 * x), state.twist), AT_REST, DT_S)
            if abs(x) > 0.3:
                break
        assert law._predictor.disturbance[:2] == (sign * 3.0, -sign * 3.0)
        law.reset(state, goal)
        for heading in (0.0, 0.3, 1.0):
            law.update(goal, State(Pose(0.0, 0.0, sign * heading), state.twist), AT_REST, DT_S)
        assert law._predictor.disturbance[2] == sign * 10.0
