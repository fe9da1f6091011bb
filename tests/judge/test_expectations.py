"""Expectations: each claim against a naive oracle, and what fails because nothing was shown."""

import math
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.judge.claims import Watch, check_expectation
from hil.judge.judged_run import in_order
from hil.scenario import load
from hil.scenario.trial import ExpectTable

NAN = float("nan")
VALUES = st.lists(st.one_of(st.integers(-3, 3).map(float), st.floats(-5, 5), st.just(NAN)), min_size=1, max_size=30)
LIMIT = st.integers(-3, 3).map(float)
TOLERANCE = st.sampled_from([0.5, 1.0, 2.0])


def claim(**given: Any) -> ExpectTable:
    return ExpectTable(signal="error.planar_m", **given)


def signals(values: list[float]) -> dict[str, np.ndarray]:
    return {"loop.t_s": np.arange(len(values), dtype=np.float64), "error.planar_m": np.array(values)}


def first_violation(values: list[float], from_s: float, to_s: float, holds) -> tuple[bool, int | None]:
    """The claim sample by sample."""
    samples = [(t, v) for t, v in enumerate(values) if from_s <= t <= to_s]
    for t, v in samples:
        if v != v or not holds(v):
            return False, t
    return bool(samples), None


CLAIMS = st.one_of(
    LIMIT.map(lambda b: (claim(below=b), lambda v: v < b)),
    LIMIT.map(lambda a: (claim(above=a), lambda v: v > a)),
    st.tuples(LIMIT, TOLERANCE).map(lambda p: (claim(above=p[0], below=p[0] + p[1]), lambda v: p[0] < v < sum(p))),
    st.tuples(LIMIT, LIMIT).map(lambda p: (claim(within=(min(p), max(p))), lambda v: min(p) <= v <= max(p))),
    LIMIT.map(lambda e: (claim(equals=e), lambda v: v == e)),
    st.tuples(LIMIT, TOLERANCE).map(lambda p: (claim(equals=p[0], tolerance=p[1]), lambda v: abs(v - p[0]) <= p[1])),
)


@given(VALUES, CLAIMS, st.integers(0, 10), st.integers(0, 30))
def test_a_claim_holds_when_it_holds_of_every_sample(values, claimed, from_s, span) -> None:
    row, holds = claimed
    passed, at = first_violation(values, from_s, from_s + span, holds)
    outcome = check_expectation(replace(row, from_s=float(from_s), to_s=float(from_s + span)), signals(values))
    assert (outcome.passed, outcome.violation_s) == (passed, at)
    assert (
        outcome.violation_value is None
        if at is None
        else (outcome.violation_value == values[at] or math.isnan(values[at]))
    )


@given(
    VALUES,
    st.one_of(
        CLAIMS.map(lambda pair: pair[0]),
        st.tuples(LIMIT, TOLERANCE).map(lambda p: claim(settles_to=p[0], tolerance=p[1])),
    ),
    st.integers(0, 10),
    st.integers(0, 30),
)
def test_the_margin_is_positive_exactly_where_a_claim_holds(values, row, from_s, span) -> None:
    outcome = check_expectation(replace(row, from_s=float(from_s), to_s=float(from_s + span)), signals(values))
    assert outcome.margin is not None
    assert math.isfinite(outcome.margin)
    assert outcome.passed == (outcome.margin > 0.0)


@given(st.lists(st.floats(-50, 50), min_size=1, max_size=9), CLAIMS, st.floats(-1e-3, 1e-3), st.floats(0.01, 100.0))
def test_the_margin_is_continuous_and_does_not_depend_on_the_unit(values, claimed, step, unit) -> None:
    row, _ = claimed
    limits = {
        name: value
        for name in ("below", "above", "equals", "tolerance", "within")
        if (value := getattr(row, name)) is not None
    }

    def found(values: list[float], by: float = 1.0) -> float:
        scaled = {
            name: tuple(by * one for one in value) if isinstance(value, tuple) else by * value
            for name, value in limits.items()
        }
        margin = check_expectation(claim(**scaled), signals([by * value for value in values])).margin
        assert margin is not None
        return margin

    flat = [limit for value in limits.values() for limit in (value if isinstance(value, tuple) else (value,))]
    is_exact = (row.equals is not None and not row.tolerance) or (row.within is not None and len(set(row.within)) == 1)
    if not is_exact:
        width = (
            abs(flat[-1] - flat[0]) / 2.0
            if len(flat) == 2 and row.equals is None
            else (row.tolerance or abs(flat[0]) or 1.0)
        )
        assert abs(found([value + step for value in values]) - found(values)) <= abs(step) / width * 1.001 + 1e-9
    if any(flat) and not (is_exact and not flat[0]):
        assert found(values, unit) == pytest.approx(found(values), rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("row", "values", "margin"),
    [
        (claim(below=4.0), [-9.0, 3.0], 0.25),
        (claim(below=-4.0), [-6.0, -3.0], -0.25),
        (claim(above=2.0), [3.0, 9.0], 0.5),
        (claim(above=0.0), [0.75, 9.0], 0.75),
        (claim(above=1.0, below=9.0), [2.0, 6.0], 0.25),
        (claim(above=1.0, below=9.0), [4.0, 7.0], 0.5),
        (claim(within=(1.0, 5.0)), [2.5, 3.0], 0.75),
        (claim(within=(1.0, 5.0)), [0.5, 3.0], -0.25),
        (claim(within=(8.0, 8.0)), [8.0], 1.0),
        (claim(within=(8.0, 8.0)), [10.0], -0.25),
        (claim(equals=5.0, tolerance=2.0), [4.0, 6.5], 0.25),
        (claim(equals=5.0, tolerance=2.0), [1.0, 6.5], -1.0),
        (claim(equals=5.0, tolerance=2.0), [4.0, 7.0], sys.float_info.min),  # at the end of its tolerance it holds
        (claim(equals=8.0), [8.0], 1.0),
        (claim(equals=8.0), [6.0], -0.25),
        (claim(equals=8.0), [8.125], -0.015625),
        (claim(equals=0.0), [0.25], -0.25),
        (claim(settles_to=5.0, tolerance=2.0), [4.5, 4.5], 0.75),
        (claim(below=1e-9), [-9.0], 1e6),
        (claim(below=1e-9), [9.0], -1e6),
        (claim(below=4.0), [1.0, NAN], -1.0),
        (claim(below=4.0), [1.0, 9.0, NAN], -1.25),
        (claim(below=4.0), [NAN], -1.0),
    ],
)
def test_a_margin_is_a_share_of_half_the_interval_or_of_the_limit(
    row: ExpectTable, values: list[float], margin: float
) -> None:
    outcome = check_expectation(row, signals(values))
    assert (outcome.margin, outcome.passed) == (margin, margin > 0.0)


@pytest.mark.parametrize(
    ("signal", "of", "both", "value"),
    [
        ("truth.x_m", "pose.x_m", (5.0, -1.5), 6.5),
        ("truth.heading_rad", "pose.heading_rad", (3.0, -2.5), 5.5 - 2.0 * math.pi),
        ("truth.heading_rad", "pose.heading_rad", (-2.5, 3.0), 2.0 * math.pi - 5.5),
        ("truth.heading_rad", "pose.heading_rad", (math.inf, 3.0), NAN),
    ],
)
def test_a_comparison_is_the_first_minus_the_other_and_of_headings_the_shorter_way_around(
    signal: str, of: str, both: tuple[float, float], value: float
) -> None:
    columns = {"loop.t_s": np.zeros(1), signal: np.array(both[:1]), of: np.array(both[1:])}
    outcome = check_expectation(ExpectTable(signal=signal, of=of, equals=99.0), columns)
    assert outcome.worst_value == pytest.approx(value, nan_ok=True)


def test_a_claim_has_just_failed_at_its_first_violation_and_one_that_settles_never() -> None:
    watch = Watch(claim(below=2.0))
    assert [watch.add(float(t), [value]) for t, value in enumerate([1.0, 2.0, 3.0, 1.0, 4.0])] == [
        False, True, False, False, False,
    ]  # fmt: skip
    settles = Watch(claim(settles_to=0.0, tolerance=2.0))
    assert [settles.add(float(t), [value]) for t, value in enumerate([1.0, 3.0, 1.0])] == [False] * 3


def test_a_claim_that_settles_late_has_less_margin_than_one_that_settles_early_at_the_same_value() -> None:
    row = claim(settles_to=0.0, tolerance=1.0)
    margins = [check_expectation(row, signals([2.0] * late + [0.0] * (10 - late))).margin for late in range(11)]
    assert margins == sorted(margins, reverse=True)
    assert margins[0] == 1.0
    assert margins[10] == -1.0
    assert margins[3] == pytest.approx(6 / 9)


@given(VALUES, LIMIT, TOLERANCE, st.integers(0, 10), st.integers(0, 30))
def test_settling_is_the_earliest_time_from_which_it_stays_near(values, target, tolerance, from_s, span) -> None:
    samples = [(t, v) for t, v in enumerate(values) if from_s <= t <= from_s + span]
    near = [abs(v - target) <= tolerance for _, v in samples]
    settled = next((t for n, (t, _) in enumerate(samples) if all(near[n:])), None)
    row = claim(settles_to=target, tolerance=tolerance, from_s=float(from_s), to_s=float(from_s + span))
    outcome = check_expectation(row, signals(values))
    assert (outcome.passed, outcome.settled_s) == (settled is not None, settled)
    assert outcome.violation_s == (None if settled is not None or not samples else samples[-1][0])


def test_the_first_violation_is_told_in_words() -> None:
    outcome = check_expectation(claim(below=0.5, to_s=2.0), signals([0.1, 0.7, 0.3]))
    assert outcome.text == "error.planar_m below 0.5 from 0 s to 2 s: failed, 0.7 at t = 1 s"


def test_what_settles_says_when() -> None:
    outcome = check_expectation(claim(settles_to=1.0, tolerance=0.1), signals([0.0, 1.05, 0.5, 0.95, 1.0]))
    assert outcome.text == ("error.planar_m settles to 1 ± 0.1 from 0 s to the end: settled at t = 3 s, over 2 samples")
    outcome = check_expectation(claim(settles_to=1.0, tolerance=0.1, from_s=1.0), signals([0.0, 1.05, 0.5]))
    assert outcome.text == "error.planar_m settles to 1 ± 0.1 from 1 s to the end: failed at the end, 0.5 at t = 2 s"
    assert (outcome.violation_s, outcome.violation_value, outcome.worst_s) == (2.0, 0.5, None)


def test_nothing_to_hold_for_fails() -> None:
    outcome = check_expectation(claim(from_s=10, to_s=15, below=1.0), signals([0.1, 0.1]))
    assert not outcome.passed
    assert outcome.text == "error.planar_m below 1 from 10 s to 15 s: failed, the run has no samples there"


@pytest.mark.parametrize(
    "row", [claim(below=math.inf), claim(above=-math.inf), claim(within=(-9, 9)), claim(equals=0.1)]
)
def test_a_gap_fails_whatever_the_bounds(row: ExpectTable) -> None:
    outcome = check_expectation(row, signals([0.1, NAN, 0.1]))
    assert not outcome.passed
    assert outcome.violation_s == 1.0
    assert "no value at t = 1 s" in outcome.text


@pytest.mark.parametrize(
    ("claim", "words"),
    [
        ("", "needs one claim"),
        ("below = 1.0\nequals = 1.0", "needs one claim"),
        ("within = [1.0, 2.0]\nsettles_to = 1.0\ntolerance = 1.0", "needs one claim"),
        ("within = [2.0, 1.0]", "give [low, high]"),
        ("within = [2.0]", "within"),
        ("above = 2.0\nbelow = 1.0", "no value can pass"),
        ("settles_to = 1.0", "needs a tolerance"),
        ("settles_to = 1.0\ntolerance = 0.0", "needs a tolerance"),
        ("below = 1.0\ntolerance = 0.1", "tolerance belongs to"),
        ("equals = 1.0\ntolerance = -0.1", "at least 0"),
        ("below = 1.0\nfrom_s = 2.0\nto_s = 1.0", "is before from_s"),
    ],
)
def test_a_wrong_expectation_is_refused_in_one_sentence(tmp_path, claim, words) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(f'extends = "paper_circle"\n[[expect]]\nsignal = "error.planar_m"\n{claim}\n')
    with pytest.raises(BadInputError) as error:
        load(str(path))
    assert words in str(error.value)
    assert "wrong.toml:" in str(error.value)


def test_all_claims_load(tmp_path) -> None:
    path = tmp_path / "right.toml"
    rows = ["within = [0.0, 1.0]", "equals = 1.0", "settles_to = 0.0\ntolerance = 0.01"]
    path.write_text(
        'extends = "paper_circle"\n' + "\n".join(f'[[expect]]\nsignal = "error.planar_m"\n{row}' for row in rows)
    )
    loaded = load(str(path)).expect
    assert all(isinstance(row, ExpectTable) for row in loaded)
    assert [loaded[-3].within, loaded[-2].equals, loaded[-1].settles_to] == [(0.0, 1.0), 1.0, 0.0]


def test_a_failure_tells_its_first_and_its_worst_violation_and_how_long_it_was_in_all() -> None:
    outcome = check_expectation(claim(below=5.0), signals([0.0, 5.5, 53.0, 6.0, 1.0, 7.0, 2.0]))
    assert (outcome.violation_s, outcome.violation_value) == (1.0, 5.5)
    assert (outcome.worst_s, outcome.worst_value, outcome.violated_s) == (2.0, 53.0, 4.0)
    assert outcome.text.endswith(": failed, 5.5 at t = 1 s; worst 53 at t = 2 s; 4 s in all")


@given(VALUES, LIMIT, LIMIT)
def test_the_worst_violation_is_the_farthest_from_what_was_claimed(
    values: list[float], low: float, high: float
) -> None:
    low, high = min(low, high), max(low, high)
    outcome = check_expectation(claim(within=(low, high)), signals(values))
    outside = [(max(low - v, v - high), -t) for t, v in enumerate(values) if not low <= v <= high and v == v]
    if outcome.worst_s is None or math.isnan(outcome.worst_value or 0.0):
        assert not outside
    else:
        assert outcome.worst_s == -max(outside)[1]
        assert outcome.worst_value == values[int(outcome.worst_s)]
    violating = [not low <= v <= high for v in values]
    assert outcome.violated_s in (None, sum(violating[:-1]))


@pytest.mark.parametrize(
    ("row", "passed", "told"),
    [
        (claim(below=9.0, from_s=5.0), None, "the run ended at t = 3 s"),
        (claim(below=9.0), None, "the run ended at t = 3 s"),
        (claim(below=9.0, to_s=2.0), True, "held over 3 samples"),
        (claim(below=2.0), False, "failed, 2 at t = 2 s; worst 3 at t = 3 s; 1 s in all"),
        (claim(settles_to=9.0, tolerance=1.0), None, "the run ended at t = 3 s"),
        (claim(settles_to=3.0, tolerance=0.5), None, "the run ended at t = 3 s"),
    ],
)
def test_what_a_run_that_ended_early_did_not_come_to_is_not_judged(
    row: ExpectTable, passed: bool | None, told: str
) -> None:
    outcome = check_expectation(row, signals([0.0, 1.0, 2.0, 3.0]), cut_s=3.0)
    assert outcome.passed is passed
    assert told in outcome.text
    assert ("not judged" in outcome.text) is (passed is None)


def test_failures_are_told_in_the_order_of_time() -> None:
    rows = [claim(below=9.0), claim(below=3.0), claim(below=9.0, from_s=9.0), claim(below=1.0)]
    values = signals([0.0, 1.0, 2.0, 3.0, 9.5])
    found = [check_expectation(row, values, cut_s=4.0) for row in rows]
    assert [row.violation_s for row in in_order(found)] == [1.0, 3.0, 4.0, None]
