"""The limiter of a moving robot: no law drives it into its own protection, and a service keeps its limits."""

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import hil
from hil.addons.service.motions import check_path
from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.kinematics import BodyTwist, body_twist, body_wrench, wheel_speeds
from hil.core.model import RobotModel
from hil.core.motion_limits import BAND, BodyLimits, MotionLimits, TorqueSpeed
from hil.core.types import WHEEL_NAMES, ZERO_WHEELS, CommandMode, Limit, Pose, State, Twist, WheelCommand, Wheels
from hil.references import make_reference
from hil.scenario import ServiceTable
from tests.support.pilot_bench import OPTIONS, PilotBench, armed_pilot

MODEL = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)
PERIOD_S = 0.005
AT_REST = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
speeds = st.builds(Wheels, *[st.floats(-60.0, 60.0)] * 4)
torques = st.builds(Wheels, *[st.floats(-5.0, 5.0)] * 4)
weak_torques = st.builds(Wheels, *[st.floats(-2.0, 2.0)] * 4)
SLIPPERY = {
    "plant.start.contact": "slip",
    "plant.start.grip_coefficient": 0.35,
    "robot.torque_limit_n_m": 1.8,
    "firmware.torque_limit_n_m": 1.8,
    "firmware.overspeed_rad_s": 40.0,
    "controller.gains": {},
    "loop.duration_s": 4.0,
    "expect": [],
}

OFF = {"limiter.torque_speed": "off", "limiter.slip_m_s": math.inf}


def guard(torque_speed: TorqueSpeed = "protection", slip_m_s: float = math.inf) -> Guard:
    made = Guard(20.0, 5.0, MotionLimits(MODEL, PERIOD_S, slip_m_s, torque_speed))
    made.limit_to(32.0, 40.0)
    return made


def faded(made: Guard, torque: Wheels, *measured: Wheels, state: State = AT_REST) -> Wheels:
    """Return the torques that are left after these speeds were measured, a tick apart."""
    command = WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)
    for tick, speed in enumerate(measured):
        left, limited, guarded = made.fade(command, False, speed, round(tick * PERIOD_S * 1e9), state, 0.005)
        assert limited == (left.torque_n_m != torque)
        assert guarded.taken_n_m >= 0.99 * sum(abs(a - b) for a, b in zip(torque, left.torque_n_m, strict=True))
        assert (guarded.limit is Limit.NONE) == (guarded.taken_n_m == 0.0) == (not limited)
    return left.torque_n_m


@given(st.sampled_from([(1, 0, 0), (0, 1, 0), (1, -1, 0), (0, 0, 1)]), st.floats(-4.0, 4.0), torques)
def test_what_is_taken_away_is_drive_and_braking_is_free(along: tuple[int, int, int], size: float, torque: Wheels):
    twist = size * along[0], size * along[1], size * along[2]
    now = Wheels(*wheel_speeds(twist, MODEL.wheel_radius_m, MODEL.lever_m))
    for slip_m_s in (math.inf, 0.3):
        left = faded(guard("limit", slip_m_s), torque, now, now)
        assert max(map(abs, left)) <= 5.0
        power, kept = (sum(map(operator.mul, one, now)) for one in (torque, left))
        assert kept <= power + 1e-9
        if all(one * speed <= 0.0 for one, speed in zip(torque, now, strict=True)):
            assert left == pytest.approx(torque)


@given(torques)
def test_beyond_the_limit_nothing_drives_a_wheel_on(torque: Wheels):
    fast = Wheels(*(math.copysign(39.0, one) for one in torque))
    assert not any(faded(guard(), torque, fast))
    assert faded(guard("off"), torque, fast) == torque


def test_the_fade_looks_ahead_as_far_as_the_wheel_gains_until_the_command_acts():
    push = Wheels(1.8, 1.8, 1.8, 1.8)
    slow, near = Wheels(30.0, 30.0, 30.0, 30.0), Wheels(31.0, 31.0, 31.0, 31.0)
    assert faded(guard(), push, near, near) == push
    assert max(faded(guard(), push, slow, near)) < 1.0, "at 200 rad/s² it will have 35.7 rad/s"
    assert faded(guard(), push, Wheels(32.0, 32.0, 32.0, 32.0), near) == push, "it slows down"


def test_a_wheel_that_slips_is_faded_and_those_that_roll_are_not():
    rolling = State(Pose(0.0, 0.0, 0.0), Twist(0.75, 0.0, 0.0))  # 10 rad/s each
    push = Wheels(1.0, 1.0, 1.0, 1.0)
    measured = Wheels(13.0, 10.0, 10.0, 10.0)
    left = faded(guard(slip_m_s=0.3), push, measured, measured, state=rolling)
    assert left == (pytest.approx(0.5), 1.0, 1.0, 1.0), "0.225 m/s of 0.3, faded from 0.15 on"
    assert faded(guard(), push, measured, measured, state=rolling) == push


def test_a_robot_that_was_reset_while_it_rolled_does_not_count_as_slipping():
    """Its clock and its estimate of the wheels' speed begin at zero, while the floor goes by as before."""
    rolling = State(Pose(0.0, 0.0, 0.0), Twist(0.75, 0.0, 0.0))  # 10 rad/s each
    push, lag_s = Wheels(1.0, 1.0, 1.0, 1.0), 0.0133
    made = guard(slip_m_s=0.3)
    assert faded(made, push, *[Wheels(10.0, 10.0, 10.0, 10.0)] * 4, state=rolling) == push
    begins = [10.0 * (1.0 - math.exp(-2.0 * t) * (1.0 + 2.0 * t)) for t in np.arange(20) * PERIOD_S / lag_s]
    assert faded(made, push, *[Wheels(one, one, one, one) for one in begins], state=rolling) == push


@given(st.floats(1.0, 20.0), st.floats(-5.0, 5.0))
def test_a_wheel_that_slips_far_beyond_the_limit_is_not_braked_either_for_a_while(slips: float, torque: float):
    """Only its own inertia is braked: the torque that is on its way would make it slip in the other direction."""
    made = guard(slip_m_s=0.3)
    at_once = Wheels(4.0 + slips, 0.0, 0.0, 0.0)
    faded(made, Wheels(5.0, 5.0, 5.0, 5.0), at_once, at_once)
    command = WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, Wheels(torque, torque, torque, torque))
    left = made.fade(command, False, at_once, round(2 * PERIOD_S * 1e9), AT_REST, 0.005)[0].torque_n_m
    assert abs(left.fl) <= 0.05 * abs(torque)
    assert left[1:] == command.torque_n_m[1:]


@example(Wheels(5.0, 5.0, 5.0, 5.0), Wheels(1.0, 1.0, 1.0, 1.0))  # below both limits
@given(speeds, weak_torques)
def test_limits_of_the_body_take_away_what_drives_it_on_and_nothing_else(now: Wheels, torque: Wheels):
    made = guard("off")
    made.keep_body(BodyLimits(0.5, 1.0))
    geometry = MODEL.wheel_radius_m, MODEL.lever_m
    twist, asked = body_twist(now, *geometry), body_wrench(torque, *geometry)
    left = body_wrench(faded(made, torque, now, now), *geometry)
    speed = math.hypot(twist.forward_m_s, twist.left_m_s)
    along, across = (
        [(w.forward_n * x + w.left_n * y) / max(speed, 1e-9) for w in (asked, left)]
        for x, y in ((twist.forward_m_s, twist.left_m_s), (-twist.left_m_s, twist.forward_m_s))
    )
    assert across[1] == pytest.approx(across[0], abs=1e-6), "steering is free"
    if not 0.5 < speed < (1.0 + BAND) * 0.5:  # there it fades
        gone = speed > 0.5 and along[0] > 0.0
        assert along[1] == pytest.approx(0.0 if gone else along[0], abs=1e-6)
    if abs(twist.yaw_rate_rad_s) >= 1.0 + BAND and asked.yaw_n_m * twist.yaw_rate_rad_s > 0.0:
        assert left.yaw_n_m == pytest.approx(0.0, abs=1e-6)


@given(speeds)
def test_set_points_of_a_body_with_limits_are_scaled_together(asked: Wheels):
    made = Guard(64.0, 5.0, MotionLimits(MODEL, PERIOD_S))
    made.keep_body(BodyLimits(0.5, 1.0))
    left, limited = made.apply(WheelCommand(CommandMode.SPEED, asked, ZERO_WHEELS))
    forward, sideways, yaw_rate = body_twist(left.speed_rad_s, MODEL.wheel_radius_m, MODEL.lever_m)
    assert math.hypot(forward, sideways) <= 0.525 + 1e-9
    assert abs(yaw_rate) <= 1.05 + 1e-9
    assert limited == (left.speed_rad_s != asked)
    wheel = max(range(4), key=lambda place: abs(asked[place]))
    if asked[wheel]:
        factor = left.speed_rad_s[wheel] / asked[wheel]
        assert left.speed_rad_s == pytest.approx([factor * one for one in asked])


@pytest.mark.parametrize("law", ["profile", "pid", "dsc", "afdsc"])
def test_no_law_drives_the_robot_into_its_overspeed_on_a_floor_that_gives_half_of_the_grip(law: str):
    sets = {**SLIPPERY, "controller.law": law}
    free = hil.run("compare_circle", set={**sets, **OFF})
    assert "OVERSPEED" in str(free.failure), "the case is hard enough"
    kept = hil.run("compare_circle", set=sets)
    assert kept.failure is None
    assert max(np.abs(kept.signals[f"wheel.{wheel}.speed_rad_s"]).max() for wheel in WHEEL_NAMES) < 40.0


@pytest.mark.parametrize(
    ("law", "grip", "mass_kg", "way_ms", "start"),
    [
        ("dsc", 0.345, 21.9, (10, 7), (1.2, -0.3, 2.9)),
        ("computed_torque", 0.573, 12.0, (9, 6), (-0.2, 1.1, -2.0)),
        ("pid", 0.301, 22.4, (12, 8), (0.9, 0.9, 3.5)),
        ("profile", 0.478, 26.6, (8, 5), (0.3, -1.3, 2.4)),
    ],
)
def test_wheels_that_were_let_go_do_not_spin_again_with_torque_that_was_on_its_way(
    law: str, grip: float, mass_kg: float, way_ms: tuple[int, int], start: tuple[float, float, float]
):
    """5 N·m and a long way: what is commanded now shows in the measured speed 30 to 40 ms later."""
    sets = {
        **SLIPPERY,
        "plant.start.grip_coefficient": grip,
        "controller.law": law,
        "plant.start.mass_kg": mass_kg,
        "robot.torque_limit_n_m": 5.0,
        "firmware.torque_limit_n_m": 5.0,
        **{f"link.{name}_latency_s": ms * 1e-3 for name, ms in zip(("command", "feedback"), way_ms, strict=True)},
        **dict(zip((f"plant.start.start_{one}" for one in ("x_m", "y_m", "heading_rad")), start, strict=True)),
    }
    assert hil.run("compare_circle", set=sets).failure is None


def test_with_a_limit_of_slip_a_law_is_on_the_path_where_it_was_not_in_4_s():
    kept, gripping = (
        hil.run("compare_circle", set={**SLIPPERY, "controller.law": "lqi", **more})
        for more in ({"limiter.slip_m_s": math.inf}, {})
    )
    assert kept.metrics["t10_s"] is None
    assert gripping.metrics["t10_s"] < 3.7


def test_wheels_that_roll_keep_their_torque_whatever_the_age_of_each_measured_speed():
    """A VESC over a line answers in turn: at 100 Hz three of the four speeds are up to 30 ms old.

    Compared with the robot's motion now they looked like wheels that slip, and the brakes were taken from a robot of
    half its believed mass at 4 m/s: it missed the circle by 1.5 m to 2.5 m.
    """
    sets = {
        "device.driver": "vesc",
        "loop.rate_hz": 100,
        "loop.duration_s": 1.5,
        "link.command_latency_s": 0.004,
        "link.feedback_latency_s": 0.004,
        "robot.torque_limit_n_m": 4.4,
        "firmware.torque_limit_n_m": 4.4,
        "plant.start.mass_kg": 11.7,
        "plant.start.inertia_kg_m2": 0.33,
        "plant.start.start_x_m": -1.45,
        "plant.start.start_heading_rad": 2.2,
        "controller.command": "torque",
        "controller.gains.keeps_speed_limit": False,
        "expect": [],
    }
    rolls = hil.run("compare_circle", law="profile", set=sets, lenient=True)
    assert rolls.failure is None
    assert not rolls.signals["guard.saturated"].any()
    assert rolls.metrics["t10_s"] < 1.0
    assert rolls.metrics["overshoot_m"] < 0.05
    floor = {"plant.start.contact": "slip", "plant.start.grip_coefficient": 0.35}
    slips = hil.run("compare_circle", law="profile", set=sets | floor, lenient=True)
    assert slips.signals["guard.saturated"].sum() > 50


def test_where_nothing_is_near_a_limit_not_a_byte_changes():
    runs = [hil.run("compare_circle", set={**limiter, "loop.duration_s": 1.0, "expect": []}) for limiter in (OFF, {})]
    assert runs[0].metrics["wire_sha256"] == runs[1].metrics["wire_sha256"]


def twist_on(bench: PilotBench) -> None:
    for _ in range(20):
        bench.pilot.active().twist(BodyTwist(5.0, 3.0, 9.0))
        bench.run(0.1)


def go(bench: PilotBench) -> None:
    bench.pilot.active().go(Pose(1.2, 0.4, 2.0))
    bench.run(4.0)


def track(bench: PilotBench) -> None:
    path = make_reference("circle", {"radius_m": 0.5, "period_s": 6.4, "ramp_s": 1.0}, None)
    bench.pilot.active().track(path, here=True)
    bench.run(4.0)


def track_too_fast(bench: PilotBench) -> None:
    """By a path of 5 m/s, as if it had not been refused."""
    bench.pilot.active().track(make_reference("circle", {"radius_m": 8.0, "period_s": 10.0}, None), here=True)
    bench.run(1.0)


@pytest.mark.parametrize("move", [twist_on, go, track, track_too_fast])
@pytest.mark.parametrize("law", ["dsc speed", "profile speed", "profile torque", "dsc torque"])
def test_every_way_to_move_keeps_the_limits_of_the_service(law: str, move: Callable[[PilotBench], None]):
    name, command = law.split()
    changes: dict[str, Any] = {"controller.law": name, "controller.command": command, "controller.gains": {}}
    with armed_pilot(**changes) as bench:
        move(bench)
        places, headings = bench.pairs("truth.x_m", "truth.y_m"), bench.series("truth.heading_rad")
        rate_hz, over = 100.0, 4
        speed = [math.dist(*pair) * rate_hz / over for pair in zip(places[over:], places, strict=False)]
        turn = [abs(math.remainder(b - a, math.tau)) for a, b in zip(headings, headings[over:], strict=False)]
        assert 0.1 < np.nanmax(speed) < 1.1 * OPTIONS.speed_m_s
        assert np.nanmax(turn) * rate_hz / over < 1.1 * OPTIONS.yaw_rate_rad_s


@pytest.mark.parametrize(
    ("kind", "options", "why"),
    [
        ("circle", {"radius_m": 50.0, "period_s": 1.0}, r"reaches 314 m/s at t = .*, and service.speed_m_s is 0.5"),
        ("figure_eight", {}, r"reaches 0.592 m/s .*, and service.speed_m_s is 0.5; make it slower"),
        ("spin", {"yaw_rate_rad_s": 2.0}, r"reaches 2 rad/s .*, and service.yaw_rate_rad_s is 1;"),
        ("circle", {"radius_m": 0.1, "period_s": 1.5}, r"reaches 1.75 m/s² .*, and service.acceleration_m_s2 is 1;"),
    ],
)
def test_a_path_that_is_faster_than_the_service_is_refused_with_its_figure(
    kind: str, options: dict[str, Any], why: str
):
    with pytest.raises(BadInputError, match=why):
        check_path(make_reference(kind, options, None), ServiceTable())
