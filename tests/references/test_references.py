"""References: twist and acceleration are the derivatives of the pose, nothing jumps, options are checked by name."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from hil.cli.list import listing
from hil.core.errors import BadInputError
from hil.core.types import Pose
from hil.references import make_reference, shipped_references
from hil.references.curves import Bend
from hil.references.double_s import Limits
from hil.references.multisine import Multisine
from hil.references.rounded_square import RoundedSquare
from hil.references.route import Waypoint, plan
from hil.references.shapes import Circle, FigureEight, Hold, Spin
from hil.references.source import at_rest
from hil.references.trajectory import Played, SmoothingSpline
from tests.support.documented import defaults, sections
from tests.support.examples import share_of_examples

PAGE = (Path(__file__).parents[2] / "hil" / "references" / "REFERENCES.md").read_text("utf-8")

lengths, periods, ramps = st.floats(0.3, 3.0), st.floats(4.0, 60.0), st.sampled_from([0.0, 0.7, 3.0])
places, angles = st.floats(-5.0, 5.0), st.floats(-4.0, 4.0)
headings, either = st.sampled_from(["fixed", "path"]), st.booleans()

circles = st.builds(Circle, lengths, periods, angles, places, places, headings, either, ramps)
eights = st.builds(
    FigureEight, lengths, periods, st.sampled_from(["gerono", "bernoulli"]), headings, angles, places, places, ramps
)
squares = st.builds(
    lambda side, share, *rest: RoundedSquare(side, side * share, *rest),
    lengths,
    st.floats(0.1, 0.5),
    st.floats(8.0, 60.0),
    headings,
    angles,
    places,
    places,
    either,
    ramps,
)
spins = st.builds(
    Spin,
    st.sampled_from(["line", "circle"]),
    st.floats(0.0, 1.0),
    angles,
    lengths,
    st.floats(-3.0, 3.0),
    places,
    places,
    angles,
    ramps,
    ramps,
)
waypoints = st.lists(
    st.builds(
        Waypoint,
        st.integers(-8, 8).map(lambda n: n / 4),
        st.integers(-8, 8).map(lambda n: n / 4),
        angles,
        st.sampled_from([math.inf, 0.2]),
        st.sampled_from([0.0, 0.0, 0.4]),
    ),
    min_size=2,
    max_size=6,
    unique_by=lambda waypoint: waypoint.heading_rad,
)
limits = st.builds(Limits, st.floats(0.1, 2.0), st.floats(0.1, 3.0), st.floats(0.5, 20.0))
routes = st.builds(plan, waypoints, limits, limits, st.sampled_from([0.0, 0.1, 0.5]))
playings = st.builds(
    lambda seed, ramp_s: Played(wandering(seed), 6.0, ramp_s), st.integers(0, 99), st.sampled_from([0.0, 0.5, 2.5])
)
closed = st.one_of(circles, eights, squares)
multisines = st.builds(
    lambda seed, ramp_s, room_m: Multisine(seed=seed, rest_s=0.0, ramp_s=ramp_s, room_m=room_m),
    st.integers(0, 99),
    st.sampled_from([0.7, 2.0]),
    st.floats(0.6, 6.0),
)
sources = st.one_of(closed, spins, multisines, st.builds(Hold, places, places, angles), routes, playings)


def wandering(seed: int) -> SmoothingSpline:
    """Return a spline through 13 random poses, which stands still at its end."""
    poses = np.random.default_rng(seed).normal(size=(3, 13)).cumsum(axis=1)
    return SmoothingSpline(np.linspace(0.0, 6.0, 13).tolist(), poses.tolist(), 0.3)


def one_sided(values, h: float):
    """Return the first derivative at the first of nine equally spaced values, within h⁸ (Fornberg 1988)."""
    weights = np.array([-761 / 280, 8, -14, 56 / 3, -35 / 2, 56 / 5, -14 / 3, 8 / 7, -1 / 8])
    return weights @ np.asarray(values) / h


@share_of_examples(1.2)
@given(sources, st.floats(0.0, 1.3))
def test_twist_and_acceleration_are_derivatives(source, share):
    h, t = 2e-3, 0.05 + share * min(source.span_s, 60.0)
    now = source.at(t)
    sides = []
    for step in (h, -h):
        beside = [source.at(t + k * step) for k in range(9)]
        for exact, name in ((now.twist, "pose"), (now.acceleration, "twist")):
            sides.append(np.abs(one_sided([getattr(one, name) for one in beside], step) - exact).max())
    # The jerk may jump on one side, and spoil the difference there.
    assert min(sides[0], sides[2]) < 1e-7
    assert min(sides[1], sides[3]) < 2e-6


@share_of_examples(0.3)
@given(st.one_of(closed, spins))
def test_neither_pose_nor_twist_nor_acceleration_jumps(source):
    def largest_steps(count):
        t = np.linspace(0.0, min(source.span_s, 30.0) * 1.05 + 0.1, count)
        rows = np.array([np.concatenate(source.at(one)) for one in t])
        return np.abs(np.diff(rows, axis=0)).max(axis=0)

    coarse, fine = largest_steps(501), largest_steps(2001)
    assert (fine <= 0.5 * coarse + 1e-9).all()  # a jump is as large at any resolution


@share_of_examples(0.6)
@given(closed, st.floats(0.0, 1.0))
def test_closed_paths_return(source, share):
    t = source.ramp_s + share * source.period_s
    first, later = source.at(t), source.at(t + source.period_s)
    assert later.pose[:2] == pytest.approx(first.pose[:2], abs=1e-9)
    turns = (later.pose.heading_rad - first.pose.heading_rad) / math.tau
    turning = source.heading == "path" and not isinstance(source, FigureEight)
    assert turns == pytest.approx((-1.0 if source.clockwise else 1.0) if turning else 0.0, abs=1e-9)
    assert later.twist == pytest.approx(first.twist, abs=1e-8)
    assert later.acceleration == pytest.approx(first.acceleration, abs=1e-8)


@share_of_examples(0.6)
@given(closed, st.floats(0.01, 30.0))
def test_a_heading_along_the_path_looks_where_the_robot_goes(source, t):
    pose, twist, _ = source.at(t)
    ahead = pose.heading_rad - source.heading_rad
    if source.heading == "fixed":
        assert ahead == 0.0
    else:
        assert math.remainder(ahead - math.atan2(twist.vy_m_s, twist.vx_m_s), math.tau) == pytest.approx(0.0, abs=1e-6)


@share_of_examples(0.4)
@given(st.one_of(closed, spins), st.floats(0.0, 1.0))
def test_a_ramp_starts_from_rest_and_then_goes_on_as_without_one(source, share):
    if source.ramp_s == 0.0 or getattr(source, "yaw_ramp_s", source.ramp_s) != source.ramp_s:
        return
    assert source.at(0.0)[1:] == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    options = {f.name: getattr(source, f.name) for f in dataclasses.fields(source) if f.init}
    steady = type(source)(**options | {name: 0.0 for name in options if name.endswith("ramp_s")})
    t = share * 20.0
    for one, other in zip(source.at(t + source.ramp_s), steady.at(t + 0.5 * source.ramp_s), strict=True):
        assert one == pytest.approx(other, abs=1e-9)


@given(st.floats(0.0, 100.0))
def test_the_circle_keeps_its_radius_period_and_heading(t):
    circle = Circle(2.0, 8.0, 0.3, centre_x_m=1.0, centre_y_m=-1.0)
    pose = circle.at(t).pose
    assert math.hypot(pose.x_m - 1.0, pose.y_m + 1.0) == pytest.approx(2.0)
    assert circle.at(t + 8.0).pose == pytest.approx(pose, abs=1e-9)
    assert pose.heading_rad == 0.3


def test_the_paper_s_circle():
    source = make_reference("circle", {"radius_m": 1, "period_s": 15.0, "heading_rad": math.pi / 4})
    assert source.at(0.0).pose == (1.0, 0.0, math.pi / 4)
    assert source.at(3.75).pose == pytest.approx((0.0, 1.0, math.pi / 4))
    assert source.at(0.0).twist == pytest.approx((0.0, math.tau / 15.0, 0.0))


def test_hold_rests_at_its_pose():
    rest = make_reference("hold", {"x_m": 1.5, "heading_rad": -1.0}).at(7.0)
    assert rest == ((1.5, 0.0, -1.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


@given(lengths, st.floats(0.0, 15.0))
def test_the_eights_are_the_lemniscates_of_gerono_and_bernoulli(a, t):
    x, y, _ = FigureEight(a, shape="gerono").at(t).pose
    assert x**4 == pytest.approx(a**2 * (x**2 - y**2), abs=1e-9)
    x, y, _ = FigureEight(a, shape="bernoulli").at(t).pose
    assert (x**2 + y**2) ** 2 == pytest.approx(a**2 * (x**2 - y**2), abs=1e-9)


def test_the_square_has_straight_sides_and_round_corners_at_one_speed():
    square = RoundedSquare(side_m=2.0, corner_m=0.4, period_s=20.0)
    rows = [square.at(t) for t in np.linspace(0.0, 20.0, 4001)]
    x, y, _ = np.array([row.pose for row in rows]).T
    speeds = np.hypot(*np.array([row.twist for row in rows]).T[:2])
    assert np.ptp(speeds) < 1e-12
    assert max(abs(x).max(), abs(y).max()) == pytest.approx(1.0, abs=1e-12)
    on_side = (np.abs(np.maximum(abs(x), abs(y)) - 1.0) < 1e-12).mean() * speeds[0] * 20.0
    assert on_side == pytest.approx(4 * (2.0 - 2 * 0.4), abs=0.01)
    assert np.minimum(abs(x), abs(y))[np.maximum(abs(x), abs(y)) > 1 - 1e-12].max() == pytest.approx(0.6, abs=0.003)
    assert rows[0].pose == (1.0, 0.0, 0.0)
    assert rows[0].twist == pytest.approx((0.0, speeds[0], 0.0))


@share_of_examples(0.3)
@given(st.floats(-2.6, 2.6), st.floats(0.05, 2.0), st.floats(0.0, 1.0), angles)
def test_a_bend_is_the_integral_of_its_direction_and_ends_on_the_other_leg(turn, tangent, share, direction):
    bend = Bend(0.5, -0.25, direction, turn, tangent)
    s = share * bend.length
    x, y, *_ = bend.plane(s)
    by_quadrature = [quad(lambda u, f=f: f(bend.angle(u)[0]), 0.0, s, epsabs=1e-12)[0] for f in (math.cos, math.sin)]
    assert (x - 0.5, y + 0.25) == pytest.approx(by_quadrature, abs=1e-10)
    corner = [0.5 + tangent * math.cos(direction), -0.25 + tangent * math.sin(direction)]
    end = [corner[0] + tangent * math.cos(direction + turn), corner[1] + tangent * math.sin(direction + turn)]
    assert bend.plane(bend.length)[:2] == pytest.approx(end, abs=1e-10)
    steps = np.linspace(0.0, bend.length, 1001)
    _, curvature, sharpness = np.array([bend.angle(u) for u in steps]).T
    assert abs(curvature).max() == pytest.approx(bend.peak_curvature)
    assert abs(sharpness).max() == pytest.approx(bend.peak_sharpness)


@share_of_examples(0.06)
@given(multisines)
def test_a_multisine_stays_in_its_room_and_within_its_limits_on_all_axes(source):
    poses, twists, accelerations = (
        np.array(part) for part in zip(*map(source.at, np.arange(0, 100, 0.05)), strict=True)
    )
    assert np.abs(poses[:, :2]).max() <= source.room_m / 2
    assert np.hypot(*twists[:, :2].T).max() <= source.speed_m_s
    assert np.abs(twists[:, 2]).max() <= source.yaw_rate_rad_s
    moving = np.arange(0, 100, 0.05) > source.ramp_s
    assert np.hypot(*accelerations[moving, :2].T).max() <= source.acceleration_m_s2
    assert np.abs(accelerations[moving, 2]).max() <= source.yaw_acceleration_rad_s2
    assert (accelerations.std(axis=0) > 0.05).all(), "each axis is driven"
    assert np.abs(np.corrcoef(accelerations.T) - np.eye(3)).max() < 0.3, "and by itself"


def test_a_multisine_rests_before_it_begins():
    source = Multisine(x_m=1.0, y_m=2.0, heading_rad=0.5, rest_s=3.0, ramp_s=0.0)
    assert source.at(2.9) == source.at(3.0) == at_rest(Pose(1.0, 2.0, 0.5))
    assert source.at(3.5).pose != source.at(3.0).pose
    for highest_hz in (0.05, 0.06):
        with pytest.raises(BadInputError, match=rf"highest_hz = {highest_hz}: expected more than lowest_hz = 0\.06"):
            Multisine(highest_hz=highest_hz)


def test_a_spin_turns_at_its_rate_while_the_path_goes_on():
    spin = make_reference("spin", {"path": "circle", "speed_m_s": 0.5, "radius_m": 2, "yaw_rate_rad_s": -1.5})
    pose, twist, acceleration = spin.at(4.0)
    assert pose == pytest.approx((2 * math.sin(1.0), 2 * (1 - math.cos(1.0)), -6.0))
    assert math.hypot(*twist[:2]) == pytest.approx(0.5)
    assert twist.yaw_rate_rad_s == -1.5
    assert math.hypot(*acceleration[:2]) == pytest.approx(0.125)
    ahead = math.cos(0.9), math.sin(0.9)
    assert Spin("line", 0.5, 0.9).at(4.0).pose == pytest.approx((2 * ahead[0], 2 * ahead[1], 3.2))
    turned = dataclasses.replace(spin, direction_rad=0.9).at(4.0).pose
    assert complex(*turned[:2]) == pytest.approx(complex(*pose[:2]) * complex(*ahead))


MOTIONS = [
    Circle(1.5, 9.0, ramp_s=1.0),
    FigureEight(1.2, 8.0, "gerono", "path"),
    FigureEight(1.2, 8.0, "bernoulli"),
    RoundedSquare(1.5, 0.3, 12.0, "path"),
    Spin("line", 0.4, 0.8),
    Spin("circle", 0.4, 0.8, 1.5),
    Multisine(rest_s=0.5),
]


@pytest.mark.parametrize("source", MOTIONS, ids=lambda source: type(source).__name__)
def test_a_motion_elsewhere_is_the_same_motion_moved(source):
    prefix = "centre_" if hasattr(source, "centre_x_m") else ""
    moved = dataclasses.replace(source, heading_rad=0.7, **{f"{prefix}x_m": 3.0, f"{prefix}y_m": -2.0})
    for t_s in (0.4, 2.0, 7.3):
        (pose, *rates), (there, *same) = source.at(t_s), moved.at(t_s)
        assert there == pytest.approx(np.add(pose, (3.0, -2.0, 0.7)), abs=1e-12)
        assert same == rates


def test_a_motion_goes_the_way_its_page_says():
    assert Circle(2.0, 8.0, clockwise=True).at(2.0).pose == pytest.approx((0.0, -2.0, 0.0))
    assert RoundedSquare(clockwise=True).at(0.1).twist.vy_m_s < 0.0 < RoundedSquare().at(0.1).twist.vy_m_s
    # An eighth of the period from the centre, up to the right: x and y of sin φ = cos φ = √½.
    gerono, bernoulli = (FigureEight(2.0, 8.0, shape).at(1.0).pose[:2] for shape in ("gerono", "bernoulli"))
    assert gerono == pytest.approx((math.sqrt(2.0), 1.0))
    assert bernoulli == pytest.approx((math.sqrt(2.0) / 1.5, 1.0 / 1.5))


def test_a_span_is_what_passes_until_nothing_is_new():
    assert Circle(period_s=9.0, ramp_s=2.0).span_s == 11.0
    assert Multisine(rest_s=2.0, ramp_s=0.5, lowest_hz=0.1).span_s == 12.5
    assert Spin("line", yaw_rate_rad_s=-0.5, ramp_s=3.0).span_s == pytest.approx(3.0 + 2.0 * math.tau)
    on_circle = Spin("circle", 0.5, radius_m=2.0, yaw_rate_rad_s=0.75, ramp_s=1.0, yaw_ramp_s=4.0)
    assert on_circle.span_s == pytest.approx(4.0 + 2.0 * math.tau)
    assert dataclasses.replace(on_circle, yaw_rate_rad_s=0.25).span_s == 4.0, "it looks along the circle"


SHARED = {"ramp_s": 0, "heading": "fixed", "heading_rad": 0, "centre_x_m": 0, "centre_y_m": 0, "clockwise": False}


@pytest.mark.parametrize(("name", "kind"), shipped_references().items())
def test_the_page_and_the_list_name_every_kind_and_option_with_its_default(name, kind):
    (line,) = [row[2] for row in listing("references")[1] if row[0] == name]
    assert 20 < len(line) < 120
    section = sections(PAGE)[name]
    own = {field.name: field.default for field in dataclasses.fields(kind) if field.init}
    assert not [option for option in own if f"`{option}`" not in section]
    documented = SHARED | ({"ramp_s": 1} if name == "multisine" else {}) | defaults(section)
    assert {option: value for option, value in own.items() if value is not dataclasses.MISSING} == {
        option: documented[option] for option in own if option != "file"
    }


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("circel", {}, "reference.kind = 'circel': unknown; did you mean 'circle'?"),
        (
            "zigzag!",
            {},
            "reference.kind = 'zigzag!': unknown; "
            "known: circle, figure_eight, hold, multisine, rounded_square, spin, trajectory, waypoints",
        ),
        ("circle", {"radus_m": 1.0}, "unknown key reference.radus_m; did you mean 'reference.radius_m'?"),
        ("circle", {"radius_m": "1"}, 'reference.radius_m = "1"; expected a number'),
        ("circle", {"radius_m": True}, "reference.radius_m = true; expected a number"),
        ("circle", {"radius_m": math.nan}, "reference.radius_m = nan; expected a finite number"),
        ("circle", {"period_s": 0.0}, "reference.period_s = 0.0; expected a number greater than 0"),
        ("circle", {"ramp_s": -1.0}, "reference.ramp_s = -1.0; expected a number of at least 0"),
        ("circle", {"heading": "north"}, 'reference.heading = "north"; expected "fixed" or "path"'),
        ("hold", {"y_m": -math.inf}, "reference.y_m = -inf; expected a finite number"),
        ("figure_eight", {"shape": "8"}, 'reference.shape = "8"; expected "gerono" or "bernoulli"'),
        (
            "figure_eight",
            {"half_length_m": 0.0},
            "reference.half_length_m = 0.0; expected a number greater than 0",
        ),
        ("rounded_square", {"corner_m": 1.5}, "reference: corner_m = 1.5: expected at most half of side_m, 1"),
        ("rounded_square", {"_starts": 1.0}, "unknown key reference._starts"),
        ("spin", {"speed_m_s": -1.0}, "reference.speed_m_s = -1.0; expected a number of at least 0"),
        ("waypoints", {}, "reference.file is missing; expected text in quotation marks"),
    ],
)
def test_bad_input_names_the_thing_and_the_remedy(kind, options, message):
    with pytest.raises(BadInputError) as caught:
        make_reference(kind, options)
    assert str(caught.value).startswith(message)
