"""What of a long run a page shows: extremes, gaps and every row that matters."""

import base64
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report import shown
from hil.addons.report.charts import Band, Chart, Lane, Line, Panel, figure_of
from hil.addons.report.panels import charts
from hil.addons.report.shown import FINE_ROWS, Shown, Stretches, _bands
from tests.support.examples import share_of_examples
from tests.support.made_runs import made_runs


@given(st.integers(0, 9000), st.integers(0, 2**32 - 1))
@share_of_examples(0.25)
def test_stretches_keep_extremes_gaps_and_every_row_that_matters(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    ticks = np.flatnonzero(rng.random(count + 1) > 1e-3) if count else np.empty(0)
    t_s, y = ticks / 1000.0, rng.normal(size=len(ticks))
    instant = float(t_s[-1] / 2) if len(t_s) else 0.0
    stretches = Stretches(t_s, [instant])
    drawn = stretches(y)
    assert drawn.shape == stretches.t_s.shape
    assert (np.diff(stretches.t_s) > 0).all()
    assert len(drawn) <= 3000 + FINE_ROWS + 2 * np.sum(np.diff(ticks) > 1) + 2
    if not count:
        return
    assert (np.nanmin(drawn), np.nanmax(drawn)) == (y.min(), y.max())
    assert np.isnan(drawn).sum() == np.sum(np.diff(ticks) > 1), "a gap where rows are missing, and nowhere else"
    near = np.searchsorted(t_s, instant)
    fine = slice(max(0, near - 400), near + 400)
    assert np.isin(t_s[fine], stretches.t_s).all()
    known = dict(zip(stretches.t_s.tolist(), drawn.tolist(), strict=True))
    assert [known[at_s] for at_s in t_s[fine].tolist()] == y[fine].tolist()


def test_a_line_without_a_value_and_one_of_infinity_still_make_json() -> None:
    x = np.arange(3.0)
    lines = [Line("a", x, np.array([np.nan, np.inf, 1.0]), (0, 0, 0)), Line("<b>", x, x * np.nan, (0, 0, 0))]
    chart = Chart("t", "c", [Panel("p", "", lines)], lanes=[Lane("<i>", [Band(0.0, 1.0, "held")])])
    figure = figure_of(chart, [])
    assert figure["data"][0]["x"] == figure["data"][1]["x"] == 0, "lines over one time share it"
    y = np.frombuffer(base64.b64decode(figure["data"][0]["y"]["bdata"]), "<f4")
    np.testing.assert_array_equal(y, lines[0].y.astype("f4"))
    assert "&lt;b&gt;" in figure["layout"]["annotations"][1]["text"]
    assert figure["layout"]["annotations"][0]["text"] == "&lt;i&gt;"


def test_twenty_minutes_at_1_khz_are_few_points_with_a_spike_of_one_row_among_them() -> None:
    t_s = np.arange(1_200_000) / 1000.0
    y = np.sin(t_s)
    y[777_777] = 50.0
    stretches = Stretches(t_s, [700.0, 700.5, 0.0])
    drawn = stretches(y)
    assert len(drawn) <= 2 * 1500 + 3 * FINE_ROWS
    assert drawn.max() == 50.0
    assert stretches.t_s[np.argmax(drawn)] == pytest.approx(777.777, abs=stretches.longest_s)
    assert stretches.longest_s == pytest.approx(0.8)
    assert np.isin(t_s[:400], stretches.t_s).all(), "the first instants, row by row"


@pytest.mark.parametrize(("rows", "size"), [(3000, 1), (3001, 3), (4501, 4)])
def test_up_to_3000_rows_are_shown_whole_and_more_in_1500_stretches(rows: int, size: int) -> None:
    t_s = np.arange(rows) / 1000.0
    shown_whole = Stretches(t_s)
    assert shown_whole.longest_s == pytest.approx(size / 1000)
    if size == 1:
        assert shown_whole.t_s.tolist() == t_s.tolist()
        return
    starts = list(range(0, rows, size))
    middles = {(begin + min(begin + size, rows)) // 2 for begin in starts}
    assert shown_whole.t_s.tolist() == (np.array(sorted({*starts, *middles})) / 1000.0).tolist()
    at_s = [0.5 + number / 2 for number in range(10)]
    fine = Stretches(t_s, at_s).t_s
    for number, instant in enumerate(at_s[:4]):
        near = round(1000 * instant)
        assert np.isin(t_s[max(0, near - 500) : near + 500], fine).all(), number


def test_a_path_has_at_most_2000_points() -> None:
    for rows, points in ((2000, 2000), (4000, 2000), (4001, 1334)):
        made, _ = made_runs()
        signals = {name: np.resize(values, rows) for name, values in made.run.signals.items()}
        signals["loop.t_s"] = np.arange(rows) / 100.0
        run = replace(made.run, signals=signals)
        (path,) = [chart for chart in charts([Shown("one", run, made.judged, (0, 0, 0))]) if chart.title == "Path"]
        assert {len(line.x) for line in path.panels[0].lines} == {points}
        assert path.panels[0].lines[0].x.tolist() == signals["reference.x_m"][:: -(-rows // 2000)].tolist()


def test_bands_are_where_flags_are_set_and_never_more_than_can_be_drawn() -> None:
    t_s = np.arange(10_000) / 100.0
    once = _bands(t_s, (t_s >= 3.0) & (t_s < 4.0), "violated")
    assert once == [Band(3.0, 4.0, "violated")]
    assert _bands(t_s, np.zeros(len(t_s), bool), "violated") == []
    assert _bands(t_s, np.ones(len(t_s), bool), "violated") == [Band(0.0, 99.99, "violated")]
    often = (np.arange(10_000) % 20 < 5) & ((t_s < 40.0) | (t_s > 60.0))
    bands = _bands(t_s, often, "violated")
    assert len(bands) == 60
    assert all(any(band.begin <= at_s <= band.end for band in bands) for at_s in t_s[often])
    assert not any(band.begin < 50.0 < band.end for band in bands), "the widest gap stays one"


def test_a_stretch_is_its_least_and_its_largest_value_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown, "_STRETCHES", 2)
    monkeypatch.setattr(shown, "FINE_ROWS", 4)
    values = np.array([1.0, 9.0, 3.0, 4.0, 2.0, 8.0, 7.0, np.nan, 5.0])
    stretches = Stretches(np.arange(9) / 4)
    assert (stretches.t_s.tolist(), stretches.longest_s) == ([0.0, 0.5, 1.25, 1.75], 1.25)
    assert stretches(values).tolist() == [1.0, 9.0, 8.0, 5.0]
    fine = Stretches(np.arange(9) / 4, [1.5])
    assert fine.t_s.tolist() == [0.0, 0.5, 1.0, 1.25, 1.5, 1.75, 2.0]
    assert fine(values).tolist() == [1.0, 9.0, 2.0, 8.0, 7.0, 5.0, 5.0]
    assert Stretches(np.arange(4) / 4)(values[:4]).tolist() == values[:4].tolist(), "four rows are shown whole"


def test_a_gap_is_more_than_one_and_a_half_periods() -> None:
    t_s = np.array([0.0, 0.25, 0.5, 0.875, 1.125, 2.0, 2.25])
    stretches = Stretches(t_s)
    assert stretches.t_s.tolist() == [0.0, 0.25, 0.5, 0.875, 1.125, 1.875, 2.0, 2.25]
    np.testing.assert_array_equal(stretches(np.arange(7.0)), [0, 1, 2, 3, 4, np.nan, 5, 6])


@share_of_examples(0.4)
@given(st.lists(st.booleans(), min_size=2, max_size=40), st.integers(2, 4))
def test_of_too_many_bands_the_nearest_are_one(flags: list[bool], most: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shown, "_MOST_BANDS", most)
        t_s = np.cumsum(np.arange(1.0, len(flags) + 1)) ** 2  # no two gaps are alike
        bands = _bands(t_s, np.array(flags), "held")
    begins = [n for n in range(len(flags)) if flags[n] and not (n and flags[n - 1])]
    ends = [
        min(n, len(flags) - 1) for n in range(1, len(flags) + 1) if flags[n - 1] and not (n < len(flags) and flags[n])
    ]
    each = [(t_s[begin], t_s[end]) for begin, end in zip(begins, ends, strict=True)]
    while len(each) > most:
        nearest = min(range(len(each) - 1), key=lambda n: each[n + 1][0] - each[n][1])
        each[nearest : nearest + 2] = [(each[nearest][0], each[nearest + 1][1])]
    assert bands == [Band(begin, end, "held") for begin, end in each]
    assert all(one.end < other.begin for one, other in pairwise(bands)) or len(bands) < 2
