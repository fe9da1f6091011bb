"""The way to a reference that is far: times, the heading at which both axes need the same, friction on the way."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hil.laws.approach import directions, even_turn, friction_share, time_to_go

ERRORS = st.floats(-1.0, 1.0)
RATES = st.floats(-0.8, 0.8)
ACCELERATIONS = st.floats(2.0, 9.0)


def integrated_s(error: float, rate: float, acceleration: float, most: float) -> float:
    """Return the time until rest at the reference, in small steps: it brakes where it has to."""
    step, passed, left = 1e-4, 0.0, 0.008  # s: where it ends, at most 3.45 times ``left`` is left
    while (abs(error) > acceleration * left**2 or abs(rate) > acceleration * left) and passed < 10.0:
        ends_at = error + 0.5 * rate * abs(rate) / acceleration
        aimed = rate - math.copysign(acceleration * step, ends_at)
        rate = min(max(aimed, -max(most, abs(rate) - acceleration * step)), max(most, abs(rate) - acceleration * step))
        error, passed = error + step * rate, passed + step
    return passed


@given(ERRORS, RATES, ACCELERATIONS, st.floats(0.3, 1.5))
def test_the_time_to_go_is_that_of_accelerating_and_braking_in_small_steps(error, rate, acceleration, most):
    assume(abs(rate) < most)
    expected = integrated_s(error, rate, acceleration, most)
    assert time_to_go(error, rate, acceleration, -most, most) == pytest.approx(expected, abs=0.029)


@pytest.mark.parametrize(
    ("error", "rate", "seconds"),
    [
        (-0.55, 1.0, 2.0 * math.sqrt(1.05) - 1.0),  # it brakes in time
        (-0.45, 1.0, 1.0 + 2.0 * math.sqrt(0.05)),  # it does not, and comes back
        (2.0, 0.0, 0.5 + 1.75 / 0.5 + 0.5),
        (-6.0, 0.0, 1.5 + 3.75 / 1.5 + 1.5),  # the other limit
        (2.0, -0.3, 0.2 + 1.795 / 0.5 + 0.5),
        (2.0, 0.3, 0.8 + 1.795 / 0.5 + 0.5),  # it turns round first
        (2.0, -1.0, 0.5 + 1.5 / 0.5 + 0.5),  # faster than the limit, it slows down first
    ],
)
def test_the_time_to_go_is_that_of_its_phases(error, rate, seconds):
    assert time_to_go(error, rate, 1.0, -0.5, 1.5) == pytest.approx(seconds)
    assert time_to_go(-error, -rate, 1.0, -1.5, 0.5) == pytest.approx(seconds)


def test_an_axis_without_speed_left_takes_long_and_not_for_ever():
    assert time_to_go(1.0, 0.0, 1.0, 0.0, 9.0) == pytest.approx(0.05 + 0.9975 / 0.05 + 0.05)


@given(
    st.floats(-math.pi, math.pi),
    st.tuples(ERRORS, ERRORS),
    st.tuples(RATES, RATES),
    st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4)),
    ACCELERATIONS,
)
def test_beside_the_turn_one_axis_and_then_the_other_is_later_with_a_reference_that_moves(
    heading, error, rate, reference, acceleration
):
    """The limit is over the floor, so what the reference has of it is missing on one side of each axis."""
    turn = even_turn(heading, error, rate, reference, acceleration, 1.06)
    assert abs(turn) <= 0.25 * math.pi
    later = []
    for at in (turn - 0.004, turn + 0.004):
        x1, y1, x2, y2 = directions(heading + at)
        times = []
        for axis in ((x1, y1), (x2, y2)):
            e, w, along = (sum(a * b for a, b in zip(of, axis, strict=True)) for of in (error, rate, reference))
            times.append(time_to_go(e, w, acceleration, -1.06 - along, 1.06 - along))
        later.append(times[0] - times[1])
    assert later[0] * later[1] <= 0.0 or min(map(abs, later)) < 1e-3


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi), st.floats(0.1, 1.5), ACCELERATIONS)
def test_after_the_turn_both_axes_need_the_same_time(heading, way, distance, acceleration):
    error = distance * math.cos(way), distance * math.sin(way)
    turn = even_turn(heading, error, (0.0, 0.0), (0.0, 0.0), acceleration, 1.06)
    assert abs(turn) <= 0.25 * math.pi
    x1, y1, x2, y2 = directions(heading + turn)
    first, second = (abs(error[0] * x + error[1] * y) for x, y in ((x1, y1), (x2, y2)))
    assert first == pytest.approx(second, abs=0.01 * distance)


@given(st.floats(0.1, 2.0), st.floats(0.0, 1.0), st.floats(0.0, 0.3))
def test_friction_over_the_way_is_what_its_share_says(rate, part, friction):
    """Work against friction until the wheel turns round helps, work after it hinders; braking is 1 m/s² throughout."""
    along = part * rate
    before, after = (rate**2 - along**2) / 2.0, along**2 / 2.0  # way before and after the wheel stands [m]
    share = friction_share(1.0, -rate, along)
    assert friction * (before - after) == pytest.approx(friction * share * (before + after), abs=1e-9)
    assert friction_share(1.0, -rate, -along) == 1.0
