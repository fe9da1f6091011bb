"""A sentence that says that a value is beyond a limit shows so: its numbers are not rounded to the same text."""

import math
import re

import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from hil.core.errors import apart
from hil.judge.baselines import outside
from hil.judge.claims import Watch
from hil.judge.run_text import failed_text
from hil.scenario.trial import ExpectTable

NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
NEAR = st.floats(-1e-3, 1e-3)


@given(NUMBERS, NEAR, st.integers(1, 6))
@example(0.85, -4e-4 / 0.85, 2)
@example(0.0, 1e-3, 3)
def test_a_rounded_value_stays_on_its_side_of_a_limit(limit: float, away: float, digits: int) -> None:
    assume(abs(away) > 1e-10)
    value = limit + away * (abs(limit) or 1.0)
    text = apart(value, limit, digits=digits)
    assert ((float(text) < limit), (float(text) > limit)) == ((value < limit), (value > limit))
    short = f"{value:.{digits}g}"
    assert text == short or len(text) > len(short) or "e" in short


@given(st.integers(-10_000, 10_000), NEAR)
@example(1, 0.0)
@example(1, 1e-9)
def test_a_failed_expectation_shows_a_value_that_fails_it(thousandths: int, away: float) -> None:
    below = thousandths / 1000
    value = below + abs(away)
    watch = Watch(ExpectTable(signal="error.planar_m", below=below))
    watch.add(0.5, [value])
    outcome = watch.result()
    for text in (outcome.text, failed_text(outcome)):
        found = re.search(r"(?:failed,|first) (\S+)", text)
        assert found is not None, text
        assert float(found[1]) >= below, text


@given(st.floats(1e-3, 1e3), st.floats(1e-9, 1e-2), st.floats(1.0, 1.1))
@example(0.27862, 1e-9, 1.01)
def test_a_figure_that_has_moved_is_shown_outside_its_band(centre: float, band: float, times: float) -> None:
    value = centre + times * band
    assume(abs(value - centre) > band)
    found, accepted = outside(value, centre, band, 4)
    middle, _, width = accepted.partition(" ± ")
    assert abs(float(found) - float(middle)) > float(width)


@pytest.mark.parametrize(("value", "text"), [(math.inf, "inf"), (math.nan, "nan"), (0.85 + math.ulp(0.85), "0.85")])
def test_a_value_that_is_no_number_and_the_rounding_of_a_sum_take_no_digits(value: float, text: str) -> None:
    assert apart(value, 0.85) == text
