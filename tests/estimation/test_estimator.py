"""Odometry against exact motion along arcs; truth against what it was given."""

import math
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.motors.makers_feedback import Angles
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, to_world, wheel_speeds
from hil.core.model import RobotModel
from hil.core.options import build
from hil.core.types import NAN, NAN_POSE, ZERO_WHEELS, Pose, PoseFix, Twist, Wheels
from hil.estimation.estimators import EstimatorOptions, OdometryEstimator, TruthEstimator, make_estimator
from hil.estimation.fused import FusedEstimator
from hil.estimation.measurement import Estimator
from hil.robot.driver import Sample

ROBOT = RobotModel(20.0, 0.56, 0.075, 0.3, 0.3, 0.005, 0.0, torque_limit_n_m=5.0, speed_limit_rad_s=60.0)
COUNTS = 4096
START = Pose(0.8, -0.2, 0.4)
TICK_NS = 5_000_000

body_twists = st.builds(BodyTwist, st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-3.0, 3.0))


class Measured(NamedTuple):
    robot_time_ns: int
    encoder_count: tuple[int, int, int, int] | None
    speed_rad_s: Wheels
    yaw_rate_rad_s: float = NAN
    acceleration_m_s2: tuple[float, float, float] = (NAN, NAN, NAN)


def arc(start: Pose, body: BodyTwist, t_s: float) -> Pose:
    """Return where a constant body twist leads: exact, by the screw motion about a fixed centre."""
    forward, left, rate = body
    turned = rate * t_s
    along = math.sin(turned) / rate if abs(rate) > 1e-9 else t_s
    aside = (1.0 - math.cos(turned)) / rate if abs(rate) > 1e-9 else 0.0
    dx, dy = forward * along - left * aside, forward * aside + left * along
    c, s = math.cos(start.heading_rad), math.sin(start.heading_rad)
    return Pose(start.x_m + c * dx - s * dy, start.y_m + s * dx + c * dy, start.heading_rad + turned)


def drive(body: BodyTwist, ticks: int, *, counts: bool = True, gyro: float = NAN, offset: int = 0) -> list[Measured]:
    """Return what ideal wheels measure at each tick; ``offset`` is where the encoders stand at the start."""
    speed = wheel_speeds(body, ROBOT.wheel_radius_m, ROBOT.lever_m)
    rows = []
    for n in range(ticks + 1):
        angles = [w * n * TICK_NS * 1e-9 for w in speed]
        fl, fr, rr, rl = ((offset + math.floor(a * COUNTS / math.tau)) & 0xFFFF for a in angles)
        rows.append(Measured(n * TICK_NS, (fl, fr, rr, rl) if counts else None, speed, gyro))
    return rows


def odometry() -> OdometryEstimator:
    return OdometryEstimator(ROBOT, START, COUNTS, slip_threshold_m_s=0.1)


@pytest.mark.proves("R-SNAP-12")
@given(body_twists, st.integers(0, 0xFFFF), st.booleans())
def test_odometry_follows_an_arc(body, offset, with_gyro):
    """Within the encoders' resolution (0.12 mm a count) and the midpoint rule's error at 200 Hz."""
    estimator = odometry()
    gyro = body.yaw_rate_rad_s if with_gyro else NAN
    for measured in drive(body, 200, gyro=gyro, offset=offset):
        state = estimator.update(measured, None)
    expected = arc(START, body, 1.0)
    assert state.pose[:2] == pytest.approx(expected[:2], abs=1e-3)
    assert state.pose.heading_rad == pytest.approx(expected.heading_rad, abs=1e-3)
    assert state.twist == pytest.approx(to_world(body, expected.heading_rad), abs=5e-3)


@given(body_twists)
def test_without_counts_the_speeds_are_integrated(body):
    estimator = odometry()
    for measured in drive(body, 200, counts=False):
        state = estimator.update(measured, None)
    assert state.pose == pytest.approx(arc(START, body, 1.0), abs=2e-4)


def test_the_midpoint_rule_is_of_second_order():
    body = BodyTwist(1.0, 0.5, 3.0)
    speed = wheel_speeds(body, ROBOT.wheel_radius_m, ROBOT.lever_m)
    error = []
    for ticks in (50, 100):
        estimator = odometry()
        for n in range(ticks + 1):
            state = estimator.update(Measured(n * 1_000_000_000 // ticks, None, speed), None)
        error.append(math.dist(state.pose, arc(START, body, 1.0)))
    assert error[0] / error[1] == pytest.approx(4.0, rel=0.02)


@given(body_twists, st.integers(1, 199))
def test_a_gap_in_the_counts_is_not_counted_twice(body, gap):
    estimator = odometry()
    for n, measured in enumerate(drive(body, 200)):
        state = estimator.update(measured._replace(encoder_count=None) if n == gap else measured, None)
    assert state.pose == pytest.approx(arc(START, body, 1.0), abs=2e-3)


def test_the_first_measurement_is_at_the_start_wherever_the_encoders_stand():
    state = odometry().update(Measured(7, (1, 2, 3, 65535), ZERO_WHEELS), None)
    assert state == (START, (0.0, 0.0, 0.0))


@given(body_twists)
def test_the_same_or_an_older_measurement_moves_nothing(body):
    estimator = odometry()
    first, second, third = drive(body, 2)
    estimator.update(first, None)
    state = estimator.update(third, None)
    assert estimator.update(third, None) == state
    assert estimator.update(second, None) == state


def test_the_gyro_decides_the_heading():
    """Wheels that slip in a turn: they claim 1 rad/s, the gyro says 0.8."""
    estimator = odometry()
    for measured in drive(BodyTwist(0.0, 0.0, 1.0), 200, gyro=0.8):
        state = estimator.update(measured, None)
    assert state.pose.heading_rad == pytest.approx(START.heading_rad + 0.8)
    assert state.twist.yaw_rate_rad_s == 0.8


def test_truth_is_unknown_until_the_first_fix_and_stands_until_the_next():
    estimator = TruthEstimator(ROBOT)
    measured = Measured(0, None, ZERO_WHEELS)
    fix = PoseFix(0, Pose(1.0, 2.0, 3.0), Twist(0.1, 0.2, 0.3))
    assert estimator.update(measured, None) is None
    assert estimator.update(measured, fix) == (fix.pose, fix.twist)
    assert estimator.update(measured, None) == (fix.pose, fix.twist)
    assert estimator.update(measured, fix._replace(pose=NAN_POSE)) == (fix.pose, fix.twist)


def test_a_fix_without_twist_takes_it_from_wheels_and_gyro():
    measured = drive(BodyTwist(1.0, 0.0, 0.5), 0, gyro=0.4)[0]
    fix = PoseFix(0, Pose(0.0, 0.0, math.pi / 2), Twist(NAN, NAN, NAN))
    state = TruthEstimator(ROBOT).update(measured, fix)
    assert state.twist == pytest.approx((0.0, 1.0, 0.4))


def by_name(source: str, twist: str = "source", counts: int = COUNTS) -> Estimator:
    return make_estimator(EstimatorOptions(source, twist), ROBOT, START, counts)


def test_with_the_twist_of_the_wheels_only_the_pose_is_the_truths():
    measured = drive(BodyTwist(1.0, 0.0, 0.5), 0, gyro=0.4)[0]
    fix = PoseFix(0, Pose(0.0, 0.0, math.pi / 2), Twist(9.0, 9.0, 9.0))
    state = by_name("truth", "wheels").update(measured, fix)
    assert state is not None
    assert state.pose == fix.pose
    assert state.twist == pytest.approx((0.0, 1.0, 0.4))


def test_sources_by_name():
    kinds = {"truth": TruthEstimator, "odometry": OdometryEstimator, "fused": FusedEstimator}
    for name, kind in kinds.items():
        assert isinstance(by_name(name), kind)
    for key, expected in (("source", '"truth", "odometry" or "fused"'), ("twist", '"source" or "wheels"')):
        with pytest.raises(BadInputError, match=f'estimator.{key} = "odometer"; expected {expected}'):
            build(EstimatorOptions, {key: "odometer"}, "estimator")
    for name in ("odometry", "fused"):
        with pytest.raises(BadInputError, match=r"firmware\.counts_per_revolution = 0: expected"):
            by_name(name, counts=0)


def test_only_where_the_pose_is_the_truths_an_old_truth_holds_the_robot():
    """The robot's clock leaps by half a second: every truth is that much older than the feedback."""
    fault = [{"kind": "bias", "target": "robot.time_s", "start_s": 0.2, "value": 0.5}]
    options = {"loop.duration_s": 0.4, "loop.rate_hz": 200, "expect": [], "fault": fault}
    stale = {
        source: hil.run("circle_speed", set=options | {"estimator.source": source}).metrics["stale_ticks"]
        for source in ("truth", "odometry")
    }
    assert stale == {"truth": 40, "odometry": 0}


@pytest.mark.parametrize("gap_s", [0.3, 3.0])
def test_over_a_gap_the_wheels_turn_the_robot_and_no_rate_is_integrated(gap_s):
    """The robot stopped just after the link was lost, and turns again when it is back: its rates were of both ends."""
    turning = drive(BodyTwist(0.0, 0.0, 0.8), 1, gyro=0.8)
    estimator = odometry()
    for measured in turning:
        estimator.update(measured, None)
    back = turning[-1]._replace(robot_time_ns=turning[-1].robot_time_ns + round(gap_s * 1e9))
    state = estimator.update(back, None)
    assert state.pose.heading_rad == pytest.approx(START.heading_rad + 0.8 * TICK_NS * 1e-9)
    speeds_alone = odometry()  # nobody knows when the robot stopped
    for measured in (*turning, back):
        state = speeds_alone.update(measured._replace(encoder_count=None, yaw_rate_rad_s=NAN), None)
    assert abs(state.pose.heading_rad - START.heading_rad) < 0.8 * 0.11


def test_a_spinning_robot_that_was_lost_for_three_seconds_knows_its_heading():
    """0.8 rad/s over 3 s without a link: the gyro integrated over the gap would be 1.1 rad wrong for good."""
    result = hil.run(
        "circle_speed",
        set={
            "reference": {"kind": "spin", "speed_m_s": 0.0, "x_m": 0.5, "y_m": 0.0, "heading_rad": 0.6},
            "estimator.source": "odometry",
            "loop.rearm": True,
            "loop.duration_s": 5.0,
            "fault": [{"kind": "disconnect", "start_s": 1.0, "end_s": 4.0}],
            "expect": [],
        },
    )
    (recovery,) = result.metrics["recoveries"]
    assert recovery["armed_s"] - recovery["lost_s"] > 3.0
    apart_rad = result.signals["pose.heading_rad"][-1] - result.signals["truth.heading_rad"][-1]
    assert abs(math.remainder(apart_rad, math.tau)) < 0.01


@pytest.mark.parametrize(("gap_s", "turned_rad"), [(0.2, 2.0), (0.3, 0.0), (3.0, 0.0)])
def test_of_controllers_that_tell_speeds_alone_the_angle_over_a_gap_is_not_known(gap_s, turned_rad):
    angles = Angles(COUNTS)
    first = Sample(0, (10.0,) * 4)
    before = angles.add(first)
    after = angles.add(first._replace(stamp_ns=round(gap_s * 1e9)))
    assert {(b - a) & 0xFFFF for a, b in zip(before, after, strict=True)} == {round(turned_rad * COUNTS / math.tau)}
    told = Angles(COUNTS)
    told.add(first._replace(position_rad=(0.0,) * 4))
    assert told.add(first._replace(stamp_ns=10**10, position_rad=(1.0,) * 4))[0] == round(COUNTS / math.tau)
