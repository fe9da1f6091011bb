"""Properties of the references that a service makes from orders."""

import cmath
import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.service.motions import Follow, TwistMotion, check_path, frame_at, way_to
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references import make_reference
from hil.scenario import ServiceTable

OPTIONS = ServiceTable()
DT_S = 0.01
lengths = st.floats(-3.0, 3.0)
angles = st.floats(-10.0, 10.0)
poses = st.builds(Pose, lengths, lengths, angles)
twists = st.builds(BodyTwist, st.floats(-2.0, 2.0), st.floats(-2.0, 2.0), st.floats(-4.0, 4.0))


def at_rest(pose: Pose) -> Reference:
    return Reference(pose, Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))


def close(one: tuple[float, ...], other: tuple[float, ...], tolerance: float) -> None:
    assert one == pytest.approx(other, abs=tolerance)


@given(poses, st.lists(twists, min_size=1, max_size=3))
def test_a_drive_keeps_its_limits_and_its_derivatives_are_its_own(pose: Pose, wanted: list[BodyTwist]) -> None:
    drive = TwistMotion(at_rest(pose), 0.0, OPTIONS)
    before = at_rest(pose)
    for number in range(1, 60 * len(wanted)):
        drive.set_target(wanted[number // 60])
        now = drive.at(number * DT_S, None)
        speed = math.hypot(now.twist.vx_m_s, now.twist.vy_m_s)
        assert speed <= OPTIONS.speed_m_s + 1e-9
        assert abs(now.twist.yaw_rate_rad_s) <= OPTIONS.yaw_rate_rad_s + 1e-9
        # The plane as complex numbers: in the robot's frame u = v exp(-ih), so that a = (u' + iωu) exp(ih).
        u, u_before = (complex(*one.twist[:2]) * cmath.exp(-1j * one.pose.heading_rad) for one in (now, before))
        rate, yaw_acceleration = (u - u_before) / DT_S, (now.twist[2] - before.twist[2]) / DT_S
        assert abs(rate) <= OPTIONS.acceleration_m_s2 + 1e-6
        assert abs(yaw_acceleration) <= OPTIONS.yaw_acceleration_rad_s2 + 1e-6
        if number % 60:  # a straight way to a twist that stays, as fast as may be
            wish = complex(*drive.target[:2])
            assert abs(abs(rate) - min(OPTIONS.acceleration_m_s2, abs(wish - u_before) / DT_S)) < 1e-6
        turned = (rate + 1j * now.twist[2] * u) * cmath.exp(1j * now.pose.heading_rad)
        assert math.dist(now.acceleration, (turned.real, turned.imag, yaw_acceleration)) < 1e-6
        # The trapezoid of the twist is the way, to the third order of the step.
        for place, first, last in zip(zip(before.pose, now.pose, strict=True), before.twist, now.twist, strict=True):
            assert abs(place[1] - place[0] - 0.5 * (first + last) * DT_S) < 2e-5
        before = now


@given(poses, twists)
def test_a_drive_without_a_twist_comes_to_rest_and_stays(pose: Pose, wanted: BodyTwist) -> None:
    drive = TwistMotion(at_rest(pose), 0.0, OPTIONS)
    drive.set_target(wanted)
    for number in range(1, 100):
        drive.at(number * DT_S, None)
    drive.set_target(BodyTwist(0.0, 0.0, 0.0))
    for number in range(100, 200):
        drive.at(number * DT_S, None)
    assert drive.rests
    end = drive.at(2.0, None)
    assert drive.at(3.0, None) == end == at_rest(end.pose)


@pytest.mark.parametrize(
    ("moved", "leaps"),
    [
        (Pose(0.0179, 0.0239, 0.0), False),  # 29.9 mm, of 20 mm and twice the speed
        (Pose(-0.0181, 0.0241, 0.0), True),
        (Pose(0.0, 0.0, 0.0599), False),
        (Pose(0.0, 0.0, -0.0601), True),
    ],
)
def test_a_drive_starts_anew_from_rest_where_the_pose_leaps_to(moved: Pose, leaps: bool) -> None:
    start, wanted = Pose(3.0, -2.0, 3.13), BodyTwist(0.3, 0.1, 0.2)
    drive = TwistMotion(at_rest(start), 0.0, OPTIONS)
    drive.set_target(wanted)
    for number in range(1, 50):
        drive.at(number * DT_S, start)
    there = Pose(3.0 + moved.x_m, -2.0 + moved.y_m, math.remainder(3.13 + moved.heading_rad, math.tau))
    now = drive.at(50 * DT_S, there)
    speed = math.hypot(*now.twist[:2])
    assert speed == pytest.approx(OPTIONS.acceleration_m_s2 * DT_S if leaps else math.hypot(0.3, 0.1))
    if leaps:
        assert math.dist(now.pose[:2], there[:2]) < 1e-4


def test_a_reference_ahead_of_its_robot_waits_on_the_way_between_them() -> None:
    ahead = TwistMotion(at_rest(Pose(1.3, 1.6, 0.5)), 0.0, OPTIONS).at(DT_S, Pose(1.0, 2.0, 0.1))
    assert ahead.pose == pytest.approx((1.06, 1.92, 0.3))
    near = Pose(1.03, 1.96, 0.25)
    assert TwistMotion(at_rest(near), 0.0, OPTIONS).at(DT_S, Pose(1.0, 2.0, 0.1)).pose == near
    turned = TwistMotion(at_rest(Pose(1.0, 2.0, -0.5)), 0.0, OPTIONS).at(DT_S, Pose(1.0, 2.0, 0.1 + math.tau))
    assert turned.pose == pytest.approx((1.0, 2.0, 0.1 + math.tau - 0.2))


@given(poses, poses)
def test_a_held_robot_is_never_pulled_from_far(place: Pose, pose: Pose) -> None:
    reference = TwistMotion(at_rest(place), 0.0, OPTIONS).at(DT_S, pose)
    assert math.dist(reference.pose[:2], pose[:2]) <= TwistMotion.MOST_AHEAD_M + 1e-9
    assert (
        abs(math.remainder(reference.pose.heading_rad - pose.heading_rad, math.tau))
        <= TwistMotion.MOST_AHEAD_RAD + 1e-9
    )


@given(poses, poses)
def test_a_way_leads_from_rest_to_rest_by_the_shorter_turn(start: Pose, end: Pose) -> None:
    way = way_to(start, end, OPTIONS)
    if way is None:
        assert math.dist(start[:2], end[:2]) < 0.001
        return
    close(way.at(0.0).pose, start, 1e-6)
    last = way.at(way.span_s)
    assert last.twist == (0.0, 0.0, 0.0)
    assert abs(last.pose.heading_rad - start.heading_rad) <= math.pi + 1e-9
    assert math.dist(last.pose[:2], end[:2]) < 0.001
    assert math.remainder(last.pose.heading_rad - end.heading_rad, math.tau) == pytest.approx(0.0, abs=1e-6)


@given(poses, st.floats(0.0, 20.0))
def test_a_path_that_is_moved_has_the_same_shape(pose: Pose, t_s: float) -> None:
    path = make_reference("figure_eight", {}, None)
    begin = path.at(0.0)
    moved = Follow(path, 0.0, frame=frame_at(pose, begin.pose))
    first, there, here = moved.at(0.0, None), path.at(t_s), moved.at(t_s, None)
    close(first.pose, pose, 1e-9)
    assert math.dist(first.pose[:2], here.pose[:2]) == pytest.approx(math.dist(begin.pose[:2], there.pose[:2]))
    turn = pose.heading_rad - begin.pose.heading_rad
    for one, other in ((here.twist, there.twist), (here.acceleration, there.acceleration)):
        assert complex(*one[:2]) == pytest.approx(complex(*other[:2]) * complex(math.cos(turn), math.sin(turn)))
        assert one[2] == other[2]


def test_a_path_waits_for_the_way_to_its_begin_and_then_runs_by_its_own_time() -> None:
    path = make_reference("circle", {"radius_m": 0.5, "period_s": 8.0}, None)
    begin = path.at(0.0).pose
    way = way_to(Pose(-1.0, 0.5, 0.3), begin, OPTIONS)
    assert way is not None
    follow = Follow(path, 2.0, way)
    assert follow.at(2.0, None).pose == pytest.approx((-1.0, 0.5, 0.3))
    assert follow.at(2.0 + 0.5 * way.span_s, None) == way.at(0.5 * way.span_s)
    assert follow.at(2.0 + way.span_s, None) == path.at(0.0)
    assert follow.at(3.5 + way.span_s, None).pose == pytest.approx(path.at(1.5).pose)
    assert Follow(path, 2.0).at(1.0, None) == path.at(0.0), "not before its begin"


def test_a_way_shorter_than_a_millimetre_is_a_turn_alone_and_a_shorter_turn_is_none() -> None:
    start = Pose(1.0, -2.0, 0.5)
    assert way_to(start, Pose(1.0006, -2.0007, 0.5009), OPTIONS) is None
    turn = way_to(start, Pose(1.0006, -2.0007, 0.5011), OPTIONS)
    assert turn is not None
    assert turn.at(turn.span_s).pose == pytest.approx((1.0, -2.0, 0.5011), abs=1e-9)
    for end in (Pose(0.001, 0.0, 0.0), Pose(0.0, 0.0, 0.001)):  # neither is less than what is too short
        whole = way_to(Pose(0.0, 0.0, 0.0), end, OPTIONS)
        assert whole is not None
        assert whole.at(whole.span_s).pose == pytest.approx(end, abs=1e-9)
    way = way_to(start, Pose(1.0007, -2.0008, 0.5), OPTIONS)
    assert way is not None
    assert way.at(way.span_s).pose == pytest.approx((1.0007, -2.0008, 0.5), abs=1e-9)


class Spike:
    """A path at rest in which one time has a speed."""

    span_s = 30.0

    def __init__(self, spike_s: float, **spike: float) -> None:
        self._spike_s = spike_s
        self._values = {"vx": 0.0, "vy": 0.0, "yaw_rate": 0.0, "ax": 0.0, "ay": 0.0, "yaw": 0.0, "x": 0.0} | spike

    def at(self, t_s: float) -> Reference:
        found = at_rest(Pose(0.0, 0.0, 0.0))
        if abs(t_s - self._spike_s) > 1e-9:
            return found
        vx, vy, yaw_rate, ax, ay, yaw, x = self._values.values()
        return Reference(Pose(x, 0.0, 0.0), Twist(vx, vy, yaw_rate), Acceleration(ax, ay, yaw))


@pytest.mark.parametrize(
    ("spike", "words"),
    [
        ({"vx": 0.3, "vy": -0.41}, "0.508 m/s at t = 6 s, and service.speed_m_s is 0.5; make it slower"),
        ({"yaw_rate": -1.25}, "1.25 rad/s at t = 6 s, and service.yaw_rate_rad_s is 1; make it slower"),
        ({"ax": -0.9, "ay": 0.9}, "1.27 m/s² at t = 6 s, and service.acceleration_m_s2 is 1; make it slower"),
        ({"yaw": -3.5}, "3.5 rad/s² at t = 6 s, and service.yaw_acceleration_rad_s2 is 3; make it slower"),
        ({"x": math.inf}, "the path has no finite pose at some time"),
        ({"ax": math.nan}, "the path has no finite pose at some time"),
    ],
)
def test_a_path_is_refused_for_its_worst_time(spike: dict[str, float], words: str) -> None:
    with pytest.raises(BadInputError, match=re.escape(words)):
        check_path(Spike(6.0, **spike), OPTIONS)  # the 400th of 2000 times of 15 ms
    check_path(Spike(6.0 + 0.0075, **spike), OPTIONS)  # it is not looked at
    with pytest.raises(BadInputError):
        check_path(Spike(300.0, **spike), OPTIONS)  # long after its end
    check_path(Spike(30.0, vx=0.3, vy=0.4, yaw_rate=1.0, ax=0.6, ay=-0.8, yaw=3.0), OPTIONS)
