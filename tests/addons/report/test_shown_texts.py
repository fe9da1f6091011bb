"""What a review shows of made-up runs: charts, page and terminal, compared with texts that a person has read."""

import base64
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.addons.report import charts as charts_module
from hil.addons.report.charts import Band, Chart, Lane, Line, Mark, Panel, figure_of
from hil.addons.report.difference import _head, changes, differences, pair_lines, signal_differences, signal_rows
from hil.addons.report.panels import charts
from hil.addons.report.review_page import page
from hil.addons.report.shown import Shown
from hil.judge.judged_run import Failure, JudgedRun, LimitResult, Recovered, Verdict
from hil.pages.plots import colour_of
from hil.record.contents import Series
from tests.support.golden import assert_golden
from tests.support.made_runs import MadeRun, made_runs

GOLDEN = Path(__file__).parent / "golden"
SCALES = (1.0, 1e3, 0.6, 2e3, -2e3)


class Sources:
    """Finds which signal a line shows, times what: no two signals of the made-up runs are alike."""

    def __init__(self, shown: Sequence[Shown]) -> None:
        self._known = {
            self._key(scale * one.series(name)): f"{scale:g} * {name} of {one.label}"
            for one in shown
            for name in one.run.signals
            for scale in SCALES
        }

    def __call__(self, values: Series) -> str:
        if (name := self._known.get(self._key(values))) is not None:
            return name
        known = values[np.isfinite(values)]
        return f"{len(known)} of {len(values)} values, {known[0]:.6g} to {known[-1]:.6g}, sum {known.sum():.6g}"

    def _key(self, values: Series) -> bytes:
        return (np.round(values, 6) + 0.0).tobytes()


def bands(some: Sequence[Band]) -> str:
    return ", ".join(f"{one.kind} {one.begin:.6g} to {one.end:.6g}" for one in some) or "none"


def told(chart: Chart, source: Sources) -> Iterator[str]:
    yield f"# {chart.title} over {chart.x_title}, {chart.x_range}, {chart.height_px} px: {chart.caption}"
    yield f"bands: {bands(chart.bands)}; instants: {list(chart.instants)}"
    for lane in chart.lanes:
        yield f"lane {lane.text}: {bands(lane.bands)}"
    for panel in chart.panels:
        low, high = panel.y_range or (np.nan, np.nan)
        opens = "" if panel.y_range is None else f", opens at {low:.6g} to {high:.6g}"
        yield f"{panel.title} [{panel.unit}] {panel.height_px} px{opens}"
        for one in panel.lines:
            style = f"{one.colour} {one.width_px:g} px {one.dash} {one.opacity:g}{' in title' * one.in_title}"
            over = "" if chart.is_over_time else f" over {source(one.x)}"
            yield f"  {one.label}: {source(one.y)}{over}; {style}"
        for mark in panel.marks:
            yield f"  mark {mark.x:g}, {mark.y:.6g}: {mark.text}"
        if panel.bands:
            yield f"  {bands(panel.bands)}"


def shown_of(*runs: MadeRun) -> list[Shown]:
    return [
        Shown(str(one.judged.identity.law), one.run, one.judged, colour_of(number)) for number, one in enumerate(runs)
    ]


@pytest.mark.parametrize("count", [1, 2])
def test_each_line_of_a_page_is_the_signal_that_its_label_says(count: int) -> None:
    runs = made_runs()[:count]
    shown = shown_of(*runs)
    compared = signal_differences(runs[0].run, runs[1].run, ["error.y_m", "truth.heading_rad"]) if count == 2 else ()
    source = Sources(shown)
    lines = [line for chart in charts(shown, compared) for line in told(chart, source)]
    assert_golden(GOLDEN / f"charts_of_{count}.txt", "\n".join(lines) + "\n")


def test_a_chart_is_drawn_with_these_axes_shapes_and_words() -> None:
    t_s = np.array([0.0, 1.0, 2.0])
    lines = [
        Line("a", t_s, t_s + 1.0, (1, 2, 3)),
        Line("b", t_s, -t_s, (4, 5, 6), 3.0, "dash", 0.5),
        Line("bound", t_s + 0.0, t_s, (7, 8, 9), dash="dot", in_title=False),
    ]
    chart = Chart(
        "A chart", "Its caption.",
        [
            Panel("first", "mm", lines, [Mark(0.5, 1.5, "early"), Mark(1.75, 2.5, "late")],
                  [Band(0.5, 1.0, "violated")], (-1.0, 4.0)),
            Panel("second", "", lines[:1], height_px=200),
        ],
        lanes=[Lane("lane 1", [Band(0.0, 0.5, "waiting"), Band(0.5, 2.0, "held")]), Lane("lane 2", [])],
        bands=[Band(1.0, 1.5, "fault"), Band(1.75, 2.0, "not run")], instants=[1.25], x_range=(0.0, 2.0),
    )  # fmt: skip
    xs: list[Series] = []
    figure = figure_of(chart, xs)
    path = Chart("Path", "", [Panel("y", "m", lines[:2], height_px=380, is_true_to_scale=True)], "x [m]")
    figures = [figure, figure_of(path, xs)]

    def plain(value: Any) -> Any:
        """Return JSON with the numbers in place of their bytes."""
        if isinstance(value, dict) and value.keys() == {"dtype", "bdata"}:
            return [value["dtype"], *np.frombuffer(base64.b64decode(value["bdata"]), f"<{value['dtype']}").tolist()]
        if isinstance(value, dict):
            return {name: plain(inner) for name, inner in value.items()}
        return [plain(inner) for inner in value] if isinstance(value, list) else value

    held = {"xs": [x.tolist() for x in xs], "figures": [plain(one) for one in figures]}
    text = json.dumps(held, indent=1, ensure_ascii=False)
    text = re.sub(r"(-?\d+\.\d{6})\d+", r"\1", text)
    text = re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda found: f"[{' '.join(found[1].split())}]", text)
    assert_golden(GOLDEN / "chart.json", f"{text}\n")


@pytest.mark.parametrize("count", [1, 2])
def test_a_page_says_this(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts_module, "_plotly", lambda: "")
    runs = made_runs()[:count]
    text = page([one.run for one in runs], [one.judged for one in runs])
    text = re.sub(r"<(script|style).*?</\1>", "", text, flags=re.DOTALL)
    text = re.sub(r"</(tr|p|h\d|figure|summary|table|title|figcaption)>", "\n", text)
    text = re.sub(r"</t[dh]>", " | ", text)
    text = re.sub(r'<(?:p|span|div)[^>]* ?class="([^"]*)"[^>]*>', r"[\1] ", text)
    lines = (unescape(re.sub(r"<[^>]+>", "", line)).strip() for line in text.splitlines())
    assert_golden(GOLDEN / f"page_of_{count}.txt", "\n".join(line for line in lines if line) + "\n")


def test_of_much_that_happened_a_page_shows_the_first_twelve(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(charts_module, "_plotly", lambda: "")
    (run, judged), _ = made_runs()
    others = 5  # two faults, an expectation, the end and a limit
    for count, more in ((12, None), (13, 1), (15, 3)):
        lost = [Recovered(0.1 + n / 100, 0.2, f"loss {n}") for n in range(count - others)]
        text = page([run], [replace(judged, events=(), recoveries=lost)])
        assert ("more are below" in text) is (more is not None), count
        if more is not None:
            assert f"{more} more are below." in text


@pytest.mark.parametrize(
    ("expect", "held"), [(3, "INCOMPLETE: 2 of 3 expectations held"), (0, "INCOMPLETE: nothing was expected of it")]
)
def test_a_page_of_a_run_that_passed_begins_with_what_held(
    expect: int, held: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(charts_module, "_plotly", lambda: "")
    run, judged = made_runs()[1]
    rows = [row._replace(passed=number > 0) for number, row in enumerate(judged.expect)][:expect]
    assert f", {held}</p>" in page([run], [replace(judged, expect=tuple(rows))])


def test_a_page_of_a_long_run_says_how_much_one_point_stands_for(monkeypatch: pytest.MonkeyPatch) -> None:
    made, _ = made_runs()
    signals = {name: np.resize(values, 6002) for name, values in made.run.signals.items()}
    signals["loop.t_s"] = (np.arange(6002) - 2) / 100.0
    run = replace(made.run, signals=signals)
    chart = charts([Shown("one", run, made.judged, (0, 0, 0))])[0]
    assert chart.caption.endswith(" one: minimum and maximum of each 0.04 s; all rows around what happened.")


@pytest.mark.parametrize("everything", [False, True])
def test_the_terminal_says_this_of_two_runs(everything: bool) -> None:
    first, second = made_runs()
    ended = first._replace(judged=replace(first.judged, failure=None))
    lines: list[str] = []
    for one, other in ((first, second), (second, ended)):
        found, changed = differences(one.judged, other.judged), changes(one.run, other.run)
        lines += [*pair_lines([one.judged, other.judged], found, changed, everything=everything), "-" * 40]
    lines += map(" | ".join, signal_rows(signal_differences(first.run, second.run)))
    assert_golden(GOLDEN / f"pair_{'all' if everything else 'short'}.txt", "\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("failures", "why"), [(1, "gone"), (2, "gone; and one more reason"), (3, "gone; and 2 more reasons")]
)
def test_a_run_beside_another_has_its_first_reason_and_the_number_of_the_others(failures: int, why: str) -> None:
    allow = [LimitResult(f"limit {i}", False, 1, 1, 0, -2.0, f"limit {i}") for i in range(1, failures)]
    run = JudgedRun(verdict=Verdict.FAILED, failure=Failure("gone", "LinkError", 0.5), allow=allow)
    assert dict(_head(run))["why"] == why
