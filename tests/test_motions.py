"""Properties of the references that a service makes from orders."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.kinematics import BodyTwist
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references import make_reference
from hil.scenario import ServiceTable
from hil.service.motions import Drive, Follow, frame_at, way_to

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


@given(poses, st.lists(twists, min_size=1, max_size=5))
def test_a_drive_keeps_its_limits_and_its_derivatives_are_its_own(pose: Pose, wanted: list[BodyTwist]) -> None:
    drive = Drive(at_rest(pose), 0.0, OPTIONS)
    before = at_rest(pose)
    for number in range(1, 60 * len(wanted)):
        drive.set_target(wanted[number // 60])
        now = drive.at(number * DT_S, None)
        speed = math.hypot(now.twist.vx_m_s, now.twist.vy_m_s)
        assert speed <= OPTIONS.speed_m_s + 1e-9
        assert abs(now.twist.yaw_rate_rad_s) <= OPTIONS.yaw_rate_rad_s + 1e-9
        # The trapezoid of the twist is the way, to the third order of the step.
        for place, first, last in zip(zip(before.pose, now.pose, strict=True), before.twist, now.twist, strict=True):
            assert place[1] - place[0] == pytest.approx(0.5 * (first + last) * DT_S, abs=2e-5)
        before = now


@given(poses, twists)
def test_a_drive_without_a_twist_comes_to_rest_and_stays(pose: Pose, wanted: BodyTwist) -> None:
    drive = Drive(at_rest(pose), 0.0, OPTIONS)
    drive.set_target(wanted)
    for number in range(1, 100):
        drive.at(number * DT_S, None)
    drive.set_target(BodyTwist(0.0, 0.0, 0.0))
    for number in range(100, 200):
        drive.at(number * DT_S, None)
    assert drive.rests
    end = drive.at(2.0, None)
    assert drive.at(3.0, None) == end == at_rest(end.pose)


@given(poses, poses)
def test_a_held_robot_is_never_pulled_from_far(place: Pose, pose: Pose) -> None:
    reference = Drive(at_rest(place), 0.0, OPTIONS).at(DT_S, pose)
    assert math.dist(reference.pose[:2], pose[:2]) <= Drive.MOST_AHEAD_M + 1e-9
    assert abs(math.remainder(reference.pose.heading_rad - pose.heading_rad, math.tau)) <= Drive.MOST_AHEAD_RAD + 1e-9


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
