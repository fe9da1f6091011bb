"""The limiter of a moving robot: speeds of wheels, slip, and the body's speed and yaw rate."""

import math

import pytest

from hil.addons.service.motions import check_path
from hil.core.errors import BadInputError
from hil.core.guard import Guard
from hil.core.kinematics import body_twist, body_wrench, wheel_speeds
from hil.core.model import RobotModel
from hil.core.motion_limits import BodyLimits, MotionLimits, TorqueSpeed
from hil.core.types import ZERO_WHEELS, CommandMode, Pose, State, Twist, WheelCommand, Wheels
from hil.references import make_reference
from hil.scenario import ServiceTable

MODEL = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=20.0)
GEOMETRY = MODEL.wheel_radius_m, MODEL.lever_m
PERIOD_S, LATENCY_S = 0.005, 0.005
AT_REST = State(Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0))
PUSH = Wheels(1.0, 1.0, 1.0, 1.0)


def guard(kept: TorqueSpeed = "protection", slip_m_s: float = math.inf) -> Guard:
    made = Guard(64.0, 5.0, MotionLimits(MODEL, PERIOD_S, slip_m_s, kept))
    made.limit_to(32.0, 40.0)
    return made


def left_of(made: Guard, torque: Wheels, *measured: Wheels, state: State = AT_REST) -> Wheels:
    """Return what is left of the torques when these speeds were measured, a tick apart."""
    begin_ns = 0 if made._motion is None else made._motion.time_ns
    command = WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, torque)
    left = torque
    for tick, speed in enumerate(measured, start=1):
        at_ns = begin_ns + tick * round(PERIOD_S * 1e9)
        left = made.fade(command, False, speed, at_ns, state, LATENCY_S)[0].torque_n_m
    return left


def even(speed_rad_s: float) -> Wheels:
    return Wheels(speed_rad_s, speed_rad_s, speed_rad_s, speed_rad_s)


@pytest.mark.parametrize(("kept", "begin", "end"), [("protection", 32.0, 36.0), ("limit", 30.4, 32.0)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_torque_fades_over_its_band_and_braking_passes(kept: TorqueSpeed, begin: float, end: float, way: float) -> None:
    model = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, torque_limit_n_m=5.0, speed_limit_rad_s=50.0)
    for part in (-0.1, 0.25, 0.75, 1.1):
        made = Guard(64.0, 5.0, MotionLimits(model, PERIOD_S, math.inf, kept))
        made.limit_to(32.0, 40.0)
        now = even(way * (begin + part * (end - begin)))
        push, brake = Wheels(*(way * one for one in PUSH)), Wheels(*(-way * one for one in PUSH))
        assert left_of(made, brake, now, now) == brake
        share = min(max(1.0 - part, 0.0), 1.0)
        assert max(map(abs, left_of(made, push, now, now))) <= share + 1e-9
        assert share < 1.0 or left_of(made, push, now, now) == push
    assert left_of(guard("off"), Wheels(*(way * one for one in PUSH)), even(way * 60.0)) != ZERO_WHEELS


def test_what_counts_is_the_speed_that_will_be_there_when_the_command_acts() -> None:
    left = left_of(guard(), PUSH, even(27.0), Wheels(29.0, 27.0, 27.0, 27.0))
    ahead_s = PERIOD_S + 0.0133 + LATENCY_S
    assert left[0] < 1.0
    assert 29.0 + 400.0 * ahead_s > 36.0
    assert left_of(guard(), PUSH, even(30.0), even(30.0)) == PUSH


def test_a_wheel_that_was_let_go_gets_its_torque_back_slowly() -> None:
    made = guard()
    spins, rolls = Wheels(37.0, 10.0, 10.0, 10.0), even(10.0)
    assert left_of(made, PUSH, spins, spins)[0] == 0.0
    brake = Wheels(-1.0, -1.0, -1.0, -1.0)
    assert left_of(made, brake, spins) == brake
    ticks_s, last = 0.0, 0.0
    while last < 1.0:
        fl, *others = left_of(made, PUSH, rolls)
        ticks_s += PERIOD_S
        assert last < fl <= 1.0
        assert others == [1.0, 1.0, 1.0]
        assert ticks_s < 1.0
        last = fl
    assert ticks_s == pytest.approx(12.0 * (PERIOD_S + 0.0133 + LATENCY_S), abs=2.0 * PERIOD_S)
    assert left_of(made, PUSH, even(1.0), even(1.0)) == PUSH


def test_slip_is_limited_by_the_speed_of_the_rim_over_the_floor() -> None:
    rolling = State(Pose(0.0, 0.0, 0.0), Twist(0.75, 0.0, 0.0))  # 10 rad/s each
    measured = Wheels(13.0, 10.0, 10.0, 10.0)  # 0.225 m/s of 0.3: half of its band
    left = left_of(guard("off", slip_m_s=0.3), PUSH, measured, measured, state=rolling)
    assert left == pytest.approx((0.5, 1.0, 1.0, 1.0))
    assert left_of(guard("off"), PUSH, measured, measured, state=rolling) == PUSH


@pytest.mark.parametrize("twist", [(0.6, 0.0, 0.0), (0.0, -0.6, 0.0), (0.4, 0.4, 0.0), (0.0, 0.0, 1.2), (0, 0, -1.2)])
def test_a_body_beyond_its_limits_is_driven_on_by_nothing(twist: tuple[float, float, float]) -> None:
    made = guard("off")
    made.keep_body(BodyLimits(0.5, 1.0))
    now = Wheels(*wheel_speeds(twist, *GEOMETRY))
    drive = Wheels(*(math.copysign(1.0, one) if one else 0.0 for one in now))
    left = body_wrench(left_of(made, drive, now, now), *GEOMETRY)
    assert left == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    slow = Wheels(*(0.7 * one for one in now))
    fresh = guard("off")
    fresh.keep_body(BodyLimits(0.5, 1.0))
    assert left_of(fresh, drive, slow, slow) == drive


@pytest.mark.parametrize("twist", [(3.0, 0.0, 0.0), (0.0, -3.0, 0.0), (1.0, 1.0, 0.0), (0.0, 0.0, 4.0), (0.3, 0, -2)])
def test_set_points_of_a_body_are_scaled_to_its_limits(twist: tuple[float, float, float]) -> None:
    made = guard()
    made.limit_to(1000.0)
    made.keep_body(BodyLimits(0.5, 1.0))
    asked = WheelCommand(CommandMode.SPEED, Wheels(*wheel_speeds(twist, *GEOMETRY)), ZERO_WHEELS)
    command, limited = made.apply(asked)
    most = max(math.hypot(twist[0], twist[1]) / 0.525, abs(twist[2]) / 1.05)
    found = body_twist(command.speed_rad_s, *GEOMETRY)
    # The robot's own limit of the wheels (64 rad/s) is beyond all of these.
    assert found == pytest.approx(tuple(one / most for one in twist), abs=1e-9)
    assert limited


def test_a_path_faster_than_the_service_is_refused_with_its_figure() -> None:
    table = ServiceTable()
    check_path(make_reference("circle", {"radius_m": 0.5, "period_s": 7.0, "ramp_s": 2.0}), table)
    for options, why in (
        ({"radius_m": 0.5, "period_s": 6.0}, "0.524 m/s"),
        ({"radius_m": 0.1, "period_s": 1.5}, "1.75 m/s²"),
    ):
        with pytest.raises(BadInputError, match=f"the path reaches {why} at t = "):
            check_path(make_reference("circle", options), table)
    with pytest.raises(BadInputError, match="reaches 2 rad/s"):
        check_path(make_reference("spin", {"yaw_rate_rad_s": 2.0}), table)
