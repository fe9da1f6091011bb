"""References: twist and acceleration are the derivatives of the pose; options are checked by name."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.errors import BadInputError
from hil.references import Circle, Hold, make_reference

times = st.floats(0.0, 100.0)
sources = st.one_of(
    st.builds(
        Circle,
        st.floats(0.1, 5.0),
        st.floats(2.0, 60.0),
        st.floats(-4.0, 4.0),
        st.floats(-5.0, 5.0),
        st.floats(-5.0, 5.0),
    ),
    st.builds(Hold, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), st.floats(-4.0, 4.0)),
)


@given(sources, times)
def test_twist_and_acceleration_are_derivatives(source, t):
    h = 1e-4
    before, now, after = source.at(t - h), source.at(t), source.at(t + h)
    slope = [(b - a) / (2 * h) for a, b in zip(before.pose, after.pose, strict=True)]
    curvature = [(b - a) / (2 * h) for a, b in zip(before.twist, after.twist, strict=True)]
    assert now.twist == pytest.approx(slope, abs=1e-5)
    assert now.acceleration == pytest.approx(curvature, abs=1e-5)


@given(times)
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


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        ("circel", {}, "reference.kind = 'circel': unknown; did you mean 'circle'?"),
        ("zigzag!", {}, "reference.kind = 'zigzag!': unknown; known: circle, hold"),
        ("circle", {"radus_m": 1.0}, "reference: unknown option 'radus_m'; did you mean 'radius_m'?"),
        ("circle", {"radius_m": "1"}, "reference.radius_m = '1': expected a number"),
        ("circle", {"radius_m": True}, "reference.radius_m = True: expected a number"),
        ("circle", {"radius_m": math.nan}, "reference.radius_m = nan: expected a finite number"),
        ("circle", {"period_s": 0.0}, "reference: period_s = 0.0: expected a finite number, more than zero"),
        ("hold", {"y_m": -math.inf}, "reference.y_m = -inf: expected a finite number"),
    ],
)
def test_bad_input_names_the_thing_and_the_remedy(kind, options, message):
    with pytest.raises(BadInputError) as caught:
        make_reference(kind, options)
    assert str(caught.value) == message
