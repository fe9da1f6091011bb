"""Waypoints and trajectories: limits are kept, and the mathematics agrees with libraries of others."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import make_smoothing_spline

from hil.references.curves import Bend
from hil.references.double_s import Limits, after, change_way, profile, reachable_speed
from hil.references.route import Waypoint, plan
from hil.references.trajectory import SmoothingSpline
from tests.references.test_references import limits, waypoints
from tests.support.examples import share_of_examples

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


TURN_RAD, SIDE_M = 1.2, 4.0
FREE = Limits(100.0, 1e4, 1e8)
EASED = np.polynomial.Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])


def corner(plane: Limits, yaw: Limits, turn_rad: float, blend_m: float = 0.5, corner_rad: float = math.pi / 2):
    """Return times and motion along two legs, the heading turning on the first, and by how much each second of it."""
    far = SIDE_M * (1.0 + math.cos(corner_rad)), SIDE_M * math.sin(corner_rad)
    points = [(0.0, 0.0, 0.0), (SIDE_M, 0.0, turn_rad), (*far, turn_rad)]
    route = plan([Waypoint(*point, math.inf, 0.0) for point in points], plane, yaw, blend_m)
    t_s = np.linspace(0.0, route.span_s, 4001)[:-1]
    return t_s, np.array([route.at(t) for t in t_s.tolist()])


@pytest.mark.parametrize(
    ("yaw", "share"),
    [((0.3, 1e4, 1e8), 1.0), ((1e3, 0.2, 1e8), 2.0), ((1e3, 1e4, 0.5), 3.0)],
    ids=["rate", "acceleration", "jerk"],
)
def test_a_leg_that_turns_has_the_speed_at_which_its_heading_is_at_its_share_of_a_limit(yaw, share):
    """Each term of a derivative of the heading has an equal share of its limit: θ' v, θ'' v² + θ' a, and three."""
    t_s, rows = corner(FREE, Limits(*yaw), TURN_RAD)
    whole = SIDE_M - 0.5 + Bend(0.0, 0.0, 0.0, math.pi / 2, 0.5).length / 2.0
    u = np.linspace(0.0, 1.0, 2001)
    slope, bend, twist = (TURN_RAD * np.abs(EASED.deriv(n)(u)).max() / whole**n for n in (1, 2, 3))
    speed, acceleration = (np.hypot(rows[:, k, 0], rows[:, k, 1]) for k in (1, 2))
    v = speed[rows[:, 0, 1] < 1e-9].max()
    order = 1 + [limit < 1.0 for limit in yaw].index(True)
    assert v**order * (slope, bend, twist)[order - 1] == pytest.approx(yaw[order - 1] / share, rel=1e-4)
    straight = rows[:, 0, 0] < SIDE_M - 0.5
    if order == 2:
        assert acceleration[straight].max() * slope == pytest.approx(yaw[1] / 2.0, rel=1e-3)
    if order == 3:
        assert 3.0 * bend * v * acceleration[straight].max() == pytest.approx(yaw[2] / 3.0, rel=1e-3)
        jerk = np.abs(np.diff(acceleration[straight])).max() / (t_s[1] - t_s[0])
        assert jerk * slope == pytest.approx(yaw[2] / 3.0, rel=1e-2)


@pytest.mark.parametrize(("yaw", "k"), [((0.3, 1e4, 1e8), 0), ((1e3, 0.2, 1e8), 1), ((1e3, 1e4, 0.5), 2)])
def test_a_leg_between_two_stops_turns_as_fast_as_its_heading_may(yaw, k):
    t_s, rows = corner(FREE, Limits(*yaw), TURN_RAD, blend_m=0.0)
    turning = (rows[:, 1, 2], rows[:, 2, 2], np.diff(rows[:, 2, 2]) / (t_s[1] - t_s[0]))[k]
    assert np.abs(turning[:2000]).max() == pytest.approx(yaw[k], rel=1e-2)


@pytest.mark.parametrize("plane", [(0.2, 1e4, 1e8), (100.0, 0.4, 1e8), (100.0, 1e4, 0.6)])
def test_a_bend_is_driven_as_fast_as_speed_acceleration_and_jerk_let_it(plane):
    """The curvature is 1 - cos: its peak is 2 φ / L, and that of its slope 2 π φ / L²."""
    _, rows = corner(Limits(*plane), FREE, 0.0)
    middle = np.abs(rows[:, 0, 0] - SIDE_M) + np.abs(rows[:, 0, 1]) < 0.4
    length = Bend(0.0, 0.0, 0.0, math.pi / 2, 0.5).length
    speed, acceleration = (np.hypot(rows[middle, k, 0], rows[middle, k, 1]).max() for k in (1, 2))
    assert acceleration == pytest.approx(speed**2 * math.pi / length, rel=1e-4)
    jerk = speed**3 * math.hypot((math.pi / length) ** 2, math.pi**2 / length**2)
    assert max(speed / plane[0], acceleration / plane[1], jerk / plane[2]) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(("corner_deg", "stops"), [(149.0, False), (151.0, True), (-149.0, False), (-151.0, True)])
def test_the_robot_stops_at_a_corner_of_more_than_150_degrees(corner_deg, stops):
    within = Limits(0.5, 2.0, 40.0)
    _, rows = corner(within, within, 0.0, corner_rad=math.radians(corner_deg))
    assert (np.hypot(*rows[200:-200, 1, :2].T).min() < 1e-2) == stops


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
