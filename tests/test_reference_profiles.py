"""Waypoints and trajectories: limits are kept, and the mathematics agrees with libraries of others."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_smoothing_spline

from hil.references.double_s import Limits, after, change_way, profile, reachable_speed
from hil.references.route import Waypoint, plan
from hil.references.smoothing import SmoothingSpline
from tests.examples import share_of_examples
from tests.test_references import limits, waypoints

blends = st.sampled_from([0.0, 0.1, 0.5])


@share_of_examples(0.6)
@given(st.floats(0.001, 5.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0), limits)
def test_a_profile_is_as_fast_as_the_fastest_of_ruckig(spare, first_share, last_share, within):
    ruckig = pytest.importorskip("ruckig", reason="it has no wheel for Linux on ARM")
    first, last = first_share * within.speed, last_share * within.speed
    way = change_way(first, last, within) + spare
    phases = profile(way, first, last, within)
    asked = ruckig.InputParameter(1)
    asked.current_velocity, asked.target_velocity, asked.target_position = [first], [last], [way]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = ([limit] for limit in within)
    best = ruckig.Trajectory(1)
    ruckig.Ruckig(1).calculate(asked, best)
    assert sum(phase.duration_s for phase in phases) == pytest.approx(best.duration, rel=1e-6, abs=1e-6)
    end = after(phases[-1], phases[-1].duration_s)
    assert end == pytest.approx((way, last, 0.0), abs=1e-7)


@given(st.floats(0.0, 2.0), st.floats(0.0, 5.0), limits)
def test_the_reachable_speed_is_reached_on_just_this_way(speed, way, within):
    reached = reachable_speed(min(speed, within.speed), way, within)
    assert min(speed, within.speed) <= reached <= within.speed
    phases = profile(way, min(speed, within.speed), reached, within)
    peak = max((phase.speed for phase in phases), default=reached)
    if reached < within.speed:
        assert peak <= reached + 1e-6  # nothing is left for a detour over a higher speed


@share_of_examples(0.15)
@given(waypoints, limits, limits, blends)
def test_waypoints_keep_the_limits_of_speed_acceleration_and_jerk(points, plane, yaw, blend_m):
    route = plan(points, plane, yaw, blend_m)
    h = min(route.span_s / 500.0, 0.02)
    rows = np.array([route.at(t) for t in np.arange(0.0, route.span_s + 5 * h, h)])
    assert np.linalg.norm(rows[:, 1, :2], axis=1).max() <= plane.speed * (1 + 1e-9)
    assert np.linalg.norm(rows[:, 2, :2], axis=1).max() <= plane.acceleration * (1 + 1e-9)
    assert abs(rows[:, 1, 2]).max() <= yaw.speed * (1 + 1e-9)
    assert abs(rows[:, 2, 2]).max() <= yaw.acceleration * (1 + 1e-9)
    # A limited derivative bounds each step; so do those of speed and jerk, also over all that does not show as a value.
    for order, (of_plane, of_yaw) in enumerate(zip(plane, yaw, strict=True)):
        steps = np.diff(rows[:, order], axis=0)
        assert np.linalg.norm(steps[:, :2], axis=1).max() <= of_plane * h * (1 + 1e-6) + 1e-9
        assert abs(steps[:, 2]).max() <= of_yaw * h * (1 + 1e-6) + 1e-9


@share_of_examples(0.2)
@given(waypoints, limits, limits, blends)
def test_waypoints_begin_at_the_first_pass_the_others_and_rest_at_the_last(points, plane, yaw, blend_m):
    route = plan(points, plane, yaw, blend_m)
    still = ((0.0,) * 3, (0.0,) * 3)
    first, last = route.at(0.0), route.at(route.span_s + 1e-9)
    assert first.pose == pytest.approx(points[0][:3])
    assert first.twist == pytest.approx(still[0], abs=1e-9)
    assert route.at(route.span_s - 1e-9).pose == pytest.approx(last.pose, abs=1e-6)
    assert last == route.at(route.span_s + 1000.0)
    assert last == (points[-1][:3], *still)
    path = np.array([route.at(t).pose[:2] for t in np.linspace(0.0, route.span_s, 500)])
    for point in points:
        # A bend stays within its triangle, so it misses the corner by less than what it takes of the legs.
        gap = np.linalg.norm(path - point[:2], axis=1).min()
        assert gap <= blend_m + plane.speed * route.span_s / 499


def test_a_dwell_rests_and_a_speed_of_the_file_holds_on_the_way_to_its_row():
    fast = Limits(1.0, 1.0, 5.0)
    points = [Waypoint(0, 0, 0, math.inf, 0.5), Waypoint(1, 0, 0, 0.2, 2.0), Waypoint(3, 0, 0, math.inf, 0.0)]
    route = plan(points, fast, fast, 0.3)
    rows = np.array([route.at(t) for t in np.arange(0.0, route.span_s, 0.01)])
    resting = np.abs(rows[:, 1]).max(axis=1) < 1e-9
    assert resting[:50].all()
    assert resting[(abs(rows[:, 0, 0] - 1.0) < 1e-9)].sum() == pytest.approx(200, abs=2)
    assert rows[rows[:, 0, 0] < 1.0 - 1e-9, 1, 0].max() == pytest.approx(0.2)
    assert rows[:, 1, 0].max() == pytest.approx(1.0)


def test_blended_corners_are_faster_than_stops_and_do_not_stop():
    fast = Limits(0.6, 0.6, 3.0)
    points = [Waypoint(x, y, 0.0, math.inf, 0.0) for x, y in ((0, 0), (2, 0), (2, 2), (0, 2))]
    stopping, blended = plan(points, fast, fast, 0.0), plan(points, fast, fast, 0.5)
    assert blended.span_s < stopping.span_s - 1.0
    inner = [math.hypot(*blended.at(t).twist[:2]) for t in np.linspace(1.5, blended.span_s - 1.5, 500)]
    assert min(inner) > 0.25


@share_of_examples(0.25)
@given(st.integers(0, 2**31), st.integers(5, 60), st.floats(0.001, 0.3))
def test_the_smoothing_spline_is_that_of_scipy(seed, count, smoothing_s):
    random = np.random.default_rng(seed)
    t = np.cumsum(random.uniform(0.02, 0.1, count))
    y = random.normal(size=count)
    stands = np.convolve(np.diff(t), (0.5, 0.5))
    oracle = make_smoothing_spline(t, y, w=stands, lam=smoothing_s**4)
    spline = SmoothingSpline(t.tolist(), [y.tolist()], smoothing_s)
    times = np.linspace(t[0], t[-1], 50)
    found = np.array([spline.at(one)[0] for one in times.tolist()])
    for order in range(3):
        np.testing.assert_allclose(found[:, order], oracle.derivative(order)(times), rtol=1e-6, atol=1e-7 * 50.0**order)


@pytest.mark.parametrize("period_s", [0.005, 0.02, 0.05])
def test_smoothing_lets_a_sine_pass_by_its_frequency_at_any_sampling_rate(period_s):
    t = np.arange(0.0, 20.0, period_s)
    spline = SmoothingSpline(t.tolist(), [np.sin(4.0 * t).tolist()], 0.2)
    peaks = [spline.at(float(one))[0][0] for one in np.arange(5.0, 15.0, 0.01)]
    assert max(peaks) == pytest.approx(1.0 / (1.0 + (4.0 * 0.2) ** 4), rel=0.01)
