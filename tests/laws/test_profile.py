"""The law `profile`: the promises of its parts, and each requirement on the circle of comparison."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

import hil
from hil.core.errors import BadInputError
from hil.core.kinematics import body_wrench, to_body
from hil.core.options import build
from hil.core.types import Acceleration, Applied, CommandMode, Pose, Reference, State, Twist, WheelCommand, Wheels
from hil.laws.approach import allocate, directions, profile
from hil.laws.profile import Profile
from tests.support.closed_loop import AT_REST, PAPER_ROBOT, after
from tests.support.examples import share_of_examples

ROBOT = dataclasses.replace(PAPER_ROBOT, friction_coefficient=0.03, speed_limit_rad_s=20.0)
LIMIT_N_M = 5.0

torque = st.floats(-12.0, 12.0)
losses = st.builds(Wheels, *[st.floats(-0.5, 0.5)] * 4)
coordinate = st.floats(-3.0, 3.0)
states = st.builds(State, st.builds(Pose, *[coordinate] * 3), st.builds(Twist, *[coordinate] * 3))
references = st.builds(
    Reference,
    st.builds(Pose, *[coordinate] * 3),
    st.builds(Twist, *[coordinate] * 3),
    st.builds(Acceleration, *[coordinate] * 3),
)


def law(mode=CommandMode.TORQUE, robot=ROBOT, **options):
    return Profile(robot, mode, Profile.Options(**options))


# ------------------------------------------------------------------------------------------------- the diagonals


@given(torque, torque, torque, losses)
def test_no_wheel_is_given_more_than_its_limit_and_pushing_comes_before_turning(push_1, push_2, turn, losses):
    given_n_m, given_1, given_2, given_turn = allocate(push_1, push_2, turn, losses, LIMIT_N_M)
    assert max(map(abs, given_n_m)) <= LIMIT_N_M
    for wanted, given_push, loss in (
        (push_1, given_1, (losses.fl + losses.rr) / 2),
        (push_2, given_2, (losses.fr + losses.rl) / 2),
    ):
        assert given_push == pytest.approx(np.clip(wanted + loss, -LIMIT_N_M, LIMIT_N_M) - loss, abs=1e-12)
    # The given pushes and turn are those of the wheels after their losses.
    radius, lever = ROBOT.wheel_radius_m, ROBOT.lever_m
    wrench = body_wrench(Wheels(*(a - b for a, b in zip(given_n_m, losses, strict=True))), radius, lever)
    assert wrench.forward_n == pytest.approx(2.0 * (given_1 + given_2) / radius, abs=1e-9)
    assert wrench.left_n == pytest.approx(2.0 * (given_2 - given_1) / radius, abs=1e-9)
    assert wrench.yaw_n_m == pytest.approx(4.0 * lever * given_turn / radius, abs=1e-9)


@share_of_examples(0.4)
@given(torque, torque, torque, losses)
def test_of_turning_there_is_as_much_as_four_wheels_can_give_beside_pushing(push_1, push_2, turn, losses):
    """Against a linear program over the four torques that holds the pushes and goes as near to the turn as it can."""
    _, given_1, given_2, given_turn = allocate(push_1, push_2, turn, losses, LIMIT_N_M)
    pushes = [[0.5, 0.0, 0.5, 0.0], [0.0, 0.5, 0.0, 0.5]]
    turning = np.array([-1.0, 1.0, 1.0, -1.0]) / 4.0
    bounds = [(-LIMIT_N_M - 1e-9 - loss, LIMIT_N_M + 1e-9 - loss) for loss in losses]
    reach = [
        sign * linprog(sign * turning, A_eq=pushes, b_eq=[given_1, given_2], bounds=bounds).fun for sign in (1, -1)
    ]
    assert given_turn == pytest.approx(np.clip(turn, *reach), abs=1e-6)


@given(st.floats(-4.0, 4.0))
def test_each_pair_pushes_along_its_diagonal_of_the_body(heading_rad):
    x1, y1, x2, y2 = directions(heading_rad)
    half = math.sqrt(0.5)
    assert to_body(Twist(x1, y1, 0.0), heading_rad) == pytest.approx((half, -half, 0.0))
    assert to_body(Twist(x2, y2, 0.0), heading_rad) == pytest.approx((half, half, 0.0))


# -------------------------------------------------------------------------------------------------- the profile


@given(st.floats(-3.0, 3.0), st.floats(2.0, 40.0), st.floats(0.5, 20.0))
def test_on_the_profile_the_robot_brakes_no_harder_than_it_may_and_from_far_just_so(error, k1, braking):
    rate, slope = profile(error, 0.0, k1, braking, -math.inf, math.inf)
    assert slope == 0.0
    _, slope = profile(error, rate, k1, braking, -math.inf, math.inf)
    assert abs(slope) <= braking * (1.0 + 1e-9)
    assert rate * error <= 0.0
    if abs(error) > braking / k1**2:
        assert slope == pytest.approx(math.copysign(braking, error))
    step = 1e-6
    later, _ = profile(error + step * rate, rate, k1, braking, -math.inf, math.inf)
    assert (later - rate) / step == pytest.approx(slope, rel=1e-3, abs=1e-3)


def test_the_profile_stays_within_its_limits():
    assert profile(1.0, -0.3, 10.0, 8.0, -0.4, 0.7) == (-0.4, 0.0)
    assert profile(-1.0, 0.3, 10.0, 8.0, -0.4, 0.7) == (0.7, 0.0)


# ------------------------------------------------------------------------------------------------------ the law


@given(states, references, st.floats(0.0, 0.02))
def test_torques_are_within_the_limit_before_the_guard_sees_them(state, reference, latency_s):
    controller = law()
    controller.reset(state, reference)
    applied = AT_REST._replace(latency_s=latency_s)
    for _ in range(2):
        command = controller.update(reference, state, applied, 0.005)
        assert max(map(abs, command.torque_n_m)) <= ROBOT.torque_limit_n_m
        applied = Applied(command, False, latency_s)


@given(states, references, st.floats(0.0, 0.02))
def test_set_points_are_within_the_speed_limit_before_the_guard_sees_them(state, reference, latency_s):
    """With all defaults, the lead over the firmware's lag too: the guard would scale the reference's part as well."""
    controller = law(CommandMode.SPEED)
    controller.reset(state, reference)
    command = controller.update(reference, state, AT_REST._replace(latency_s=latency_s), 0.005)
    assert max(map(abs, command.speed_rad_s)) <= ROBOT.speed_limit_rad_s


@pytest.mark.parametrize("mode", CommandMode)
@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("rest", [0.0, 0.3])
def test_a_state_that_is_no_number_raises_nothing(mode, place, rest):
    """A law is pure: what is wrong with its state is for the loop to say."""
    values = [rest] * 6
    values[place] = math.nan
    reference = Reference(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))
    controller = law(mode)
    controller.reset(State(Pose(*[rest] * 3), Twist(*[rest] * 3)), reference)
    for _ in range(2):
        command = controller.update(reference, State(Pose(*values[:3]), Twist(*values[3:])), AT_REST, 0.005)
        assert command.mode is mode


@pytest.mark.parametrize("share", [1.0, 0.4, 0.0])
def test_what_became_of_a_command_on_its_way_is_no_disturbance(share):
    """The guard, a fault or a stop changed it; the observers receive the command that was really given."""
    robot = dataclasses.replace(ROBOT, friction_coefficient=0.0)
    controller = law(robot=robot)
    reference = Reference(Pose(0.4, 0.2, 0.3), Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))
    motion = (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)
    state = State(Pose(*motion[:3]), Twist(*motion[3:]))
    controller.reset(state, reference)
    applied = AT_REST
    for _ in range(40):
        command = controller.update(reference, state, applied, 0.005)
        scaled = Wheels(*(share * value for value in command.torque_n_m))
        applied = Applied(WheelCommand(CommandMode.TORQUE, command.speed_rad_s, scaled), share < 1.0, 0.0)
        motion = after(robot, motion, scaled, 0.005)
        state = State(Pose(*motion[:3]), Twist(*motion[3:]))
    seen = controller._predictor.disturbance
    assert seen == pytest.approx([0.0, 0.0, 0.0], abs=1e-2)
    assert (abs(state.pose.x_m) > 0.05) == (share > 0.0)


def test_in_speed_mode_the_inner_gain_is_not_in_force():
    gains = law(CommandMode.SPEED).gains
    assert gains.k1_x_1_s == Profile.Options().speed_k1_1_s
    assert math.isnan(gains.k2_x_1_s)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"k1_1_s": 0.0}, "k1_1_s"),
        ({"braking_share": 1.2}, "at most 1"),
        ({"observer_rad_s": -1.0}, "observer_rad_s"),
        ({"speed_lag_s": -0.1}, "from 0 to 1"),
    ],
)
def test_options_out_of_range_are_refused(options, sentence):
    with pytest.raises(BadInputError, match=sentence):
        build(Profile.Options, options, "controller.gains")


# ----------------------------------------------------------------------------------------- through the real wire


def circle(torque_n_m, mass_kg, duration_s, **changes):
    limits = {"robot.torque_limit_n_m": torque_n_m, "firmware.torque_limit_n_m": torque_n_m}
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    run = {"plant.start.mass_kg": mass_kg, "loop.duration_s": duration_s, "controller.law": "profile"}
    run["controller.gains.keeps_speed_limit"] = False  # the wanted times were measured on laws without it
    result = hil.run("compare_circle", set=limits | run | changes)
    assert result.failure is None
    return result


@pytest.mark.parametrize(("torque_n_m", "t10_s"), [(5.0, 0.55), (1.8, 0.85)])
def test_the_robot_is_on_the_circle_as_fast_as_it_has_to_be_whatever_its_mass(torque_n_m, t10_s):
    for mass_kg in (16.0, 20.0, 24.0):
        assert circle(torque_n_m, mass_kg, 2.0).metrics["t10_s"] <= t10_s


def test_the_steady_error_is_a_tenth_of_a_millimetre_for_the_heaviest_robot():
    """The heaviest has the most friction beyond what is believed; both torque limits give the same figures."""
    metrics = circle(1.8, 24.0, 15.0).metrics
    assert metrics["steady_rms_m"] <= 0.1e-3
    assert metrics["steady_max_m"] <= 0.6e-3


def test_with_speed_commands_the_steady_error_is_as_small():
    metrics = circle(1.8, 20.0, 9.0, controller__command="speed").metrics
    assert metrics["t10_s"] <= 0.95
    assert metrics["steady_rms_m"] <= 0.1e-3


def test_from_far_off_the_heading_no_wheel_is_dragged_backwards_into_a_fault():
    changes = {"controller.law": "profile", "controller.command": "speed", "loop.duration_s": 0.4}
    assert hil.run("circle_slip", set=changes).failure is None


@pytest.mark.parametrize(("keeps", "is_beyond"), [(True, False), (False, True)])
def test_the_robots_speed_limit_holds_in_torque_mode_unless_it_is_given_up(keeps, is_beyond):
    signals = circle(5.0, 20.0, 1.0, controller__gains__keeps_speed_limit=keeps).signals
    fastest = max(np.abs(signals[f"wheel.{wheel}.speed_rad_s"]).max() for wheel in Wheels._fields)
    assert (fastest > 1.1 * ROBOT.speed_limit_rad_s) == is_beyond


def test_a_robot_that_is_turned_round_does_not_lose_a_fast_reference_while_it_turns_back():
    """Turning had 0.3 of the wheels' speed whatever the reference took: it was lost and regained for 10 s."""
    limits = {"robot.torque_limit_n_m": 4.99, "firmware.torque_limit_n_m": 4.99, "robot.speed_limit_rad_s": 17.28}
    place = {"start_x_m": 1.3234, "start_y_m": 1.2314, "start_heading_rad": 2.6794}
    sets = {
        **limits,
        **{f"plant.start.{name}": value for name, value in place.items()},
        "plant.start.drive": "voltage",
        "plant.start.contact": "slip",
        "plant.start.grip_coefficient": 0.45,
        "controller.gains.keeps_speed_limit": True,
        "reference": {"kind": "circle", "radius_m": 0.88, "period_s": 10.24, "heading": "path", "heading_rad": -3.08},
        "loop.duration_s": 9.0,
        "expect": [],
    }
    result = hil.run("compare_circle", set=sets, lenient=True)
    late = result.signals["loop.t_s"] > 7.0
    assert result.signals["error.planar_m"][late].max() < 0.003
