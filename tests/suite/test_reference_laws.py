"""What every reference must be: speed the derivative of pose, acceleration that of speed, and the shape as described.

REFERENCES.md has the shapes and their limits.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from hil.core.types import WHEEL_NAMES
from hil.references import make_reference
from hil.references.feasibility import feasibility
from hil.references.source import ReferenceSource
from hil.scenario import load

Series = npt.NDArray[np.float64]
Options = dict[str, Any]

POSES = "x_m,y_m,heading_rad,speed_m_s,dwell_s\n"
LIMITS: Options = {"max_speed_m_s": 0.5, "max_acceleration_m_s2": 0.5, "max_jerk_m_s3": 2.0}
YAW_LIMITS: Options = {"max_yaw_rate_rad_s": 1.0, "max_yaw_acceleration_rad_s2": 2.0, "max_yaw_jerk_rad_s3": 10.0}
RAMP: Options = {"ramp_s": 1.5}
PLACE: Options = {"centre_x_m": 0.4, "centre_y_m": -0.3, "heading_rad": 0.5}
PATH: Options = {"heading": "path"}
BACK: Options = {"clockwise": True}
ROUTE = POSES + "0,0,0,1,0\n2,0,1,1,0.5\n2,1.5,1,1,0\n2,1.5,-2,1,0\n0,1.5,-2,0.2,0\n0,0,0.5,1,0.3\n"
CORNERS = POSES + "0,0,0,1,0\n2,0,1,1,0\n2,1.5,-0.4,0.3,0\n0.5,2.5,2,1,0\n0.7,1.1,2,1,0\n0.7,2.4,2,1,0\n"
BLEND: Options = {"rows": CORNERS, "corners": "blend", "blend_m": 0.3} | LIMITS | YAW_LIMITS

KINDS: Sequence[tuple[str, Options]] = (
    *(("circle", {"period_s": 7.0, "radius_m": 0.8} | PLACE | more) for more in ({}, RAMP | PATH, BACK | RAMP | PATH)),
    ("figure_eight", {"period_s": 9.0, "shape": "gerono"} | PLACE | RAMP | PATH),
    ("figure_eight", {"period_s": 9.0, "shape": "bernoulli"} | PLACE | RAMP | PATH),
    ("rounded_square", {"period_s": 9.0} | PLACE | RAMP | PATH),
    ("rounded_square", {"period_s": 9.0} | PLACE | RAMP | PATH | BACK),
    ("rounded_square", {"period_s": 9.0, "corner_m": 1.0} | BACK),
    ("spin", {"direction_rad": 0.7, "yaw_rate_rad_s": -0.9, "heading_rad": 0.3, "yaw_ramp_s": 0.7} | RAMP),
    ("spin", {"path": "circle", "direction_rad": 0.7, "radius_m": 0.6, "y_m": 0.1, "yaw_ramp_s": 2.0} | RAMP),
    ("hold", {"x_m": 0.3, "y_m": -0.2, "heading_rad": 1.0}),
    ("waypoints", {"rows": ROUTE} | LIMITS | YAW_LIMITS),
    ("waypoints", BLEND),
    ("multisine", {"rest_s": 0.5, "tones": 3, "x_m": 0.1, "y_m": 0.2, "heading_rad": 0.3, "lowest_hz": 0.2} | RAMP),
)  # fmt: skip


def made(kind: str, options: Options, folder: Path) -> ReferenceSource:
    """Return the reference; ``rows`` are the text of its file."""
    options = dict(options)
    if rows := options.pop("rows", None):
        (folder / "rows.csv").write_text(rows)
        options["file"] = "rows.csv"
    return make_reference(kind, options, folder)


def motion(source: ReferenceSource, times_s: Sequence[float] | Series) -> tuple[Series, Series, Series]:
    """Return poses, twists and accelerations, one row for each time."""
    rows = np.array([[list(part) for part in source.at(float(t))] for t in times_s])
    return rows[:, 0], rows[:, 1], rows[:, 2]


def recorded(folder: Path, rows: Series, **options: float) -> ReferenceSource:
    lines = "\n".join(",".join(f"{value:.9f}" for value in row) for row in rows)
    text = f"t_s,x_m,y_m,heading_rad\n{lines}\n"
    return made("trajectory", {"rows": text} | options, folder)


def drive(folder: Path, **options: float) -> tuple[Series, ReferenceSource]:
    """Return the rows of a recorded drive, which turns past half a turn, and their reference."""
    t = np.linspace(0.0, 5.0, 251)
    heading = np.mod(0.9 * t + 2.0 + math.pi, math.tau) - math.pi
    rows = np.stack([t + 3.0, np.sin(t), 0.5 * np.cos(0.7 * t), heading], axis=1)
    return rows, recorded(folder, rows, **options)


def is_derivative(source: ReferenceSource, until_s: float) -> None:
    h = 1e-4
    t = np.linspace(0.0, until_s, 501) + 2.7 * h
    (before, v_before, _), (after, v_after, _), (_, v, a) = (motion(source, t + d) for d in (-h, h, 0.0))
    # Where the jerk jumps, a difference of speeds is off by up to half a jerk times the step.
    np.testing.assert_allclose((after - before) / (2.0 * h), v, atol=2e-4)
    np.testing.assert_allclose((v_after - v_before) / (2.0 * h), a, atol=3e-3)


@pytest.mark.parametrize(("kind", "options"), KINDS)
def test_speed_is_the_derivative_of_pose_and_acceleration_of_speed(kind: str, options: Options, tmp_path: Path) -> None:
    source = made(kind, options, tmp_path)
    assert source.ends is (kind == "waypoints")
    is_derivative(source, source.span_s * 1.02 + 0.5)


@pytest.mark.parametrize("options", [{"smoothing_s": 0.1, "ramp_s": 0.8}, {"smoothing_s": 0.0}])
def test_so_it_is_for_a_recorded_drive(options: Options, tmp_path: Path) -> None:
    _, source = drive(tmp_path, **options)
    is_derivative(source, source.span_s - 0.01)


@pytest.mark.parametrize(("kind", "options"), [one for one in KINDS if "ramp_s" in one[1] and one[0] != "multisine"])
def test_a_ramp_begins_at_rest_and_gives_half_of_its_time_away(kind: str, options: Options, tmp_path: Path) -> None:
    smooth = made(kind, options, tmp_path)
    at_once = made(kind, {**options, "ramp_s": 0.0}, tmp_path)
    ramp_s = float(options["ramp_s"])
    begin = smooth.at(0.0)
    assert math.hypot(*begin.twist[:2]) < 1e-9
    assert math.hypot(*begin.acceleration[:2]) < 1e-6
    for t_s in (ramp_s, ramp_s + 1.3, ramp_s + 4.9):
        late, early = smooth.at(t_s), at_once.at(t_s - 0.5 * ramp_s)
        planes = ((late.pose[:2], early.pose[:2]), (late.twist[:2], early.twist[:2]))
        assert all(math.dist(*both) < 1e-9 for both in planes)
    assert smooth.span_s == pytest.approx(at_once.span_s + ramp_s) or kind == "spin"


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("kind", ["circle", "rounded_square"])
def test_a_closed_path_keeps_its_direction_place_and_heading(kind: str, clockwise: bool) -> None:
    turn = -1.0 if clockwise else 1.0
    source = make_reference(kind, {"period_s": 8.0, "clockwise": clockwise} | PLACE | PATH)
    poses, twists, _ = motion(source, np.linspace(0.01, 16.0, 1600))
    x, y = poses[:, 0] - 0.4, poses[:, 1] + 0.3
    assert (x[0], y[0]) == pytest.approx((1.0, 0.0), abs=0.02)
    assert np.all(turn * (x * twists[:, 1] - y * twists[:, 0]) > 0.0), "it goes round the centre"
    speed = np.hypot(twists[:, 0], twists[:, 1])
    np.testing.assert_allclose(speed, speed[0], rtol=1e-9)
    np.testing.assert_allclose(poses[800:, :2], poses[:800, :2], atol=1e-9)
    np.testing.assert_allclose(poses[800:, 2] - poses[:800, 2], turn * math.tau, atol=1e-9)
    ahead = np.stack([np.cos(poses[:, 2] - 0.5), np.sin(poses[:, 2] - 0.5)], axis=1)
    np.testing.assert_allclose(np.sum(ahead * twists[:, :2], axis=1), speed, rtol=1e-6)
    first = source.at(0.0).pose.heading_rad - 0.5
    assert first == pytest.approx(turn * math.pi / 2), "it begins within half a turn"
    fixed = make_reference(kind, {"period_s": 8.0, "clockwise": clockwise} | PLACE)
    assert {fixed.at(t).pose.heading_rad for t in (0.0, 3.0, 9.0)} == {0.5}
    if kind == "circle":
        np.testing.assert_allclose(np.hypot(x, y), 1.0)
    else:
        assert (x.max(), -x.min(), y.max(), -y.min()) == pytest.approx((1.0,) * 4, abs=1e-9)
        straight = np.abs(np.minimum(np.abs(x), np.abs(y))) <= 0.59
        np.testing.assert_allclose(np.maximum(np.abs(x), np.abs(y))[straight], 1.0)
        assert np.hypot(x, y).max() < math.hypot(1.0, 1.0) - 0.1, "its corners are round"


@pytest.mark.parametrize(("shape", "height"), [("gerono", 0.5), ("bernoulli", math.sqrt(2) / 4)])
def test_an_eight_has_its_size_crosses_its_centre_and_begins_up_to_the_right(shape: str, height: float) -> None:
    source = make_reference("figure_eight", {"shape": shape, "half_length_m": 0.8, "period_s": 8.0} | PLACE | PATH)
    poses, twists, _ = motion(source, np.linspace(0.0, 8.0, 1601))
    x, y = poses[:, 0] - 0.4, poses[:, 1] + 0.3
    assert (x.max(), -x.min()) == pytest.approx((0.8, 0.8), abs=1e-5)
    assert (y.max(), -y.min()) == pytest.approx((0.8 * height,) * 2, abs=1e-5)
    assert np.hypot(x, y)[[0, 800, 1600]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert min(twists[0, :2]) > 0.0
    assert poses[-1, 2] == pytest.approx(poses[0, 2])
    direction = np.arctan2(twists[:, 1], twists[:, 0])
    assert np.abs(np.sin(direction + 0.5 - poses[:, 2])).max() < 1e-9
    assert np.cos(direction + 0.5 - poses[:, 2]).min() > 0.0
    fixed = make_reference("figure_eight", {"shape": shape} | PLACE)
    assert {fixed.at(t).pose.heading_rad for t in (0.0, 3.0)} == {0.5}
    assert {fixed.at(t).twist.yaw_rate_rad_s for t in (0.0, 3.0)} == {0.0}


def test_a_spin_turns_at_a_rate_of_its_own() -> None:
    line = make_reference("spin", {"speed_m_s": 0.4, "direction_rad": 0.7, "yaw_rate_rad_s": -0.9, "x_m": 1.0})
    pose, twist, acceleration = line.at(2.0)
    assert pose == pytest.approx((1.0 + 0.8 * math.cos(0.7), 0.8 * math.sin(0.7), -1.8))
    assert twist == pytest.approx((0.4 * math.cos(0.7), 0.4 * math.sin(0.7), -0.9))
    assert tuple(acceleration) == pytest.approx((0.0, 0.0, 0.0))
    options = {"path": "circle", "speed_m_s": 0.4, "radius_m": 0.5, "direction_rad": 0.7, "y_m": 1.0}
    circle = make_reference("spin", options)
    poses, twists, accelerations = motion(circle, np.linspace(0.0, 9.0, 200))
    centre = (-0.5 * math.sin(0.7), 1.0 + 0.5 * math.cos(0.7))  # to the left of where it begins
    out = poses[:, :2] - centre
    np.testing.assert_allclose(np.hypot(*out.T), 0.5)
    np.testing.assert_allclose(accelerations[:, :2], -out * (0.4 / 0.5) ** 2, atol=1e-9)
    np.testing.assert_allclose(twists[:, 2], 0.8)
    assert line.span_s == pytest.approx(math.tau / 0.9)
    slow = make_reference("spin", {"path": "circle", "yaw_rate_rad_s": 0.8, "ramp_s": 1.0, "yaw_ramp_s": 2.0})
    assert slow.span_s == pytest.approx(2.0 + math.tau / 0.5)


def rest_to_rest_s(way: float, speed: float, acceleration: float, jerk: float) -> float:
    """Return the shortest time over a way that is long enough for all three limits."""
    return way / speed + speed / acceleration + acceleration / jerk


def test_waypoints_are_passed_at_rest_as_fast_as_the_limits_allow(tmp_path: Path) -> None:
    source = made("waypoints", {"rows": ROUTE} | LIMITS | YAW_LIMITS, tmp_path)
    straight, turn = (0.5, 0.5, 2.0), (1.0, 2.0, 10.0)
    # Where its heading changes by 1 rad as well, the plane's limits are the lower ones.
    first, side = rest_to_rest_s(2.0, *straight), rest_to_rest_s(1.5, *straight)
    turning, slow = rest_to_rest_s(3.0, *turn), rest_to_rest_s(2.0, 0.2, 0.5, 2.0)
    stops = np.cumsum([0.0, first, 0.5, side, turning, slow, side, 0.3])
    wanted = [(0, 0, 0), (2, 0, 1), (2, 0, 1), (2, 1.5, 1), (2, 1.5, -2), (0, 1.5, -2), (0, 0, 0.5), (0, 0, 0.5)]
    for t_s, pose in zip(stops, wanted, strict=True):
        there = source.at(float(t_s))
        assert tuple(there.pose) == pytest.approx(pose, abs=1e-5)
        assert tuple(there.twist) == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert source.span_s == pytest.approx(float(stops[-1]))
    assert source.at(source.span_s + 9.0) == source.at(source.span_s)


def test_a_short_way_has_no_time_at_its_top_speed(tmp_path: Path) -> None:
    rows = POSES + "0,0,0,1,0\n0.05,0,0,1,0\n0.35,0,0,1,0\n"
    source = made("waypoints", {"rows": rows} | LIMITS | YAW_LIMITS, tmp_path)
    first = 4.0 * (0.05 / (2.0 * 2.0)) ** (1 / 3)  # four phases of jerk
    even = 0.5 / 2.0  # time of a phase of jerk in the second leg, which reaches its acceleration
    peak = 0.5 * (math.sqrt((0.5 * even) ** 2 + 4.0 * 0.3 * 0.5) - 0.5 * even)
    second = 2.0 * (peak / 0.5 + even)
    assert source.span_s == pytest.approx(first + second)
    assert source.at(first).pose.x_m == pytest.approx(0.05)
    assert source.at(first + 0.5 * second).twist.vx_m_s == pytest.approx(peak)


LOWER: Sequence[Options] = (
    *({}, {"max_jerk_m_s3": 0.6}, {"max_yaw_rate_rad_s": 0.3}, {"max_yaw_acceleration_rad_s2": 0.15}),
    *({"max_yaw_jerk_rad_s3": 0.2}, {"rows": ROUTE, "max_yaw_rate_rad_s": 0.2}),
)


@pytest.mark.parametrize("lower", LOWER)
def test_bends_keep_every_limit_and_use_one_of_them(lower: Options, tmp_path: Path) -> None:
    limits = BLEND | lower
    source = made("waypoints", limits, tmp_path)
    t, step_s = np.linspace(0.0, source.span_s, 3001, retstep=True)
    _, twists, accelerations = motion(source, t)
    jerks = np.diff(accelerations, axis=0) / step_s
    kept = {
        "max_speed_m_s": np.hypot(twists[:, 0], twists[:, 1]),
        "max_acceleration_m_s2": np.hypot(accelerations[:, 0], accelerations[:, 1]),
        "max_jerk_m_s3": np.hypot(jerks[:, 0], jerks[:, 1]),
        "max_yaw_rate_rad_s": np.abs(twists[:, 2]),
        "max_yaw_acceleration_rad_s2": np.abs(accelerations[:, 2]),
        "max_yaw_jerk_rad_s3": np.abs(jerks[:, 2]),
    }
    used = {name: float(series.max() / limits[name]) for name, series in kept.items()}
    assert max(used.values()) < 1.001, used
    assert max(used["max_speed_m_s"], used["max_acceleration_m_s2"]) > 0.5
    assert used["max_jerk_m_s3"] > 0.3


def test_a_bend_rounds_its_corner_and_a_sharp_one_is_a_stop(tmp_path: Path) -> None:
    source = made("waypoints", BLEND, tmp_path)
    t = np.linspace(0.0, source.span_s, 4001)
    poses, twists, _ = motion(source, t)
    speed = np.hypot(twists[:, 0], twists[:, 1])
    corners = np.array([[2.0, 0.0], [2.0, 1.5], [0.5, 2.5], [0.7, 1.1]])
    off = [np.hypot(*(poses[:, :2] - corner).T) for corner in corners]
    nearest = [int(one.argmin()) for one in off]
    assert [one.min() > 0.02 for one in off] == [True, True, True, False]
    assert all(one.min() < 0.3 for one in off)
    assert [speed[place] > 0.02 for place in nearest] == [True, True, True, False]
    leg = (t > t[nearest[0]]) & (t < t[nearest[1]])
    assert speed[leg].max() <= 0.3 + 1e-9, "the row's own speed"
    assert speed[leg].max() > 0.29
    assert poses[-1] == pytest.approx([0.7, 2.4, 2.0])
    assert poses[nearest[1], 2] == pytest.approx(-0.4, abs=0.01), "the heading of a row is reached in its bend"


def test_a_recorded_drive_goes_through_its_rows_and_comes_to_rest(tmp_path: Path) -> None:
    rows, source = drive(tmp_path, smoothing_s=0.0)
    poses, _, _ = motion(source, rows[:-1, 0] - 3.0)
    np.testing.assert_allclose(poses[:, :2], rows[:-1, 1:3], atol=1e-6)
    np.testing.assert_allclose(poses[:, 2], np.unwrap(rows[:-1, 3]), atol=1e-6)
    assert source.span_s == pytest.approx(5.0)
    last = source.at(7.0)
    assert tuple(last.twist) == (0.0, 0.0, 0.0)
    ramped = recorded(tmp_path, rows, smoothing_s=0.0, ramp_s=1.0)
    assert ramped.span_s == pytest.approx(6.0)
    for t_s in (0.0, 6.0 - 1e-9):
        assert tuple(ramped.at(t_s).twist) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert ramped.at(3.0).pose == pytest.approx(source.at(2.5).pose)


def test_smoothing_lets_slow_motion_pass_and_stops_shaking(tmp_path: Path) -> None:
    """By 1 / (1 + (ω T)⁴), at any sampling rate."""
    smoothing_s = 0.1
    for step_s in (0.01, 0.004):
        t = np.arange(0.0, 8.0, step_s)
        for w in (2.0, 10.0, 20.0):
            rows = np.stack([t, np.sin(w * t), np.cos(w * t), 0.3 * np.sin(w * t)], axis=1)
            source = recorded(tmp_path, rows, smoothing_s=smoothing_s)
            poses, _, _ = motion(source, np.linspace(3.0, 5.0, 500))
            share = 1.0 / (1.0 + (w * smoothing_s) ** 4)
            assert np.hypot(poses[:, 0], poses[:, 1]).mean() == pytest.approx(share, rel=0.01)


def test_a_multisine_begins_late_and_keeps_its_limits() -> None:
    source = make_reference("multisine", {"rest_s": 0.5, "tones": 5, "x_m": 0.1, "y_m": 0.2, "heading_rad": 0.3} | RAMP)
    assert tuple(source.at(0.5).pose) == pytest.approx((0.1, 0.2, 0.3))
    poses, twists, accelerations = motion(source, np.arange(2.0, 60.0, 0.01))
    speed, acceleration = (float(np.hypot(*samples[:, :2].T).max()) for samples in (twists, accelerations))
    assert speed <= 0.8
    assert acceleration <= 2.5
    assert speed > 0.4 or acceleration > 1.2, "it uses what it may"
    assert np.abs(poses[:, :2] - (0.1, 0.2)).max() <= 1.5
    assert np.abs(twists[:, 2]).max() <= 2.0
    assert np.abs(accelerations[:, 2]).max() <= 8.0


def test_what_the_wheels_need_is_found_with_its_wheel_and_time() -> None:
    """A line at 0.6 m/s to the left forward: by ω = (x ± y ± L yaw) / r two wheels turn, two stand still."""
    robot = load("paper_circle").robot
    options = {"speed_m_s": 0.6, "direction_rad": math.pi / 4, "yaw_rate_rad_s": 0.0, "ramp_s": 1.0}
    line = make_reference("spin", options)
    needs = feasibility(line, robot, 4.0, 0.01)
    fast = 0.6 * math.sqrt(2.0) / robot.wheel_radius_m
    assert needs.speed.worst == pytest.approx(fast, rel=1e-6)
    assert needs.speed.worst_wheel in ("fr", "rl")
    assert needs.speed.worst_s == pytest.approx(1.0, abs=0.011)
    assert needs.speed.first is None
    assert needs.sentences == ()
    beyond = feasibility(line, replace(robot, speed_limit_rad_s=0.5 * fast), 4.0, 0.01).speed
    assert beyond.first_s == pytest.approx(0.51, abs=0.011), "half of the speed is reached in the middle of the ramp"
    assert beyond.first_wheel in WHEEL_NAMES
    circle = make_reference("circle", {"period_s": 3.0})
    once, often = (feasibility(circle, robot, until_s, 0.01).torque.worst for until_s in (3.0, 30.0))
    assert often == pytest.approx(once), "one period tells all"
