"""A review as one self-contained HTML file: verdict, figures, plots, events, scenario; made to print."""

import math
from collections.abc import Iterable, Iterator, Sequence
from html import escape
from operator import itemgetter
from pathlib import Path

from hil.addons.report.charts import charts_script, place, policy
from hil.addons.report.difference import (
    Difference,
    SignalDifference,
    changes,
    differences,
    signal_differences,
    signal_rows,
)
from hil.addons.report.panels import charts
from hil.addons.report.shown import Shown
from hil.judge.figure_text import belief_rows, figure_rows, link_rows
from hil.judge.judged_run import JudgedRun, Verdict, in_order
from hil.judge.recorded import json_object, scenario_of
from hil.judge.run_text import applied_text, outcome_rows, timeline, verdict_word
from hil.pages.html_page import document, mark, table
from hil.pages.plots import colour_of
from hil.record.reader import RecordedRun

_COLOURS = {Verdict.PASSED: "passed", Verdict.NONE: "note", Verdict.FAILED: "failed"}
_BAD = ("failed", "ended", "allow", "moved", "no fault")
_FIRST_SHOWN = 12
_OUTCOMES = {True: "held", None: "not judged", False: "failed"}


def page(
    runs: Sequence[RecordedRun], judged: Sequence[JudgedRun], signals: Sequence[SignalDifference] | None = None
) -> str:
    """Return the page of one run, or of two, as HTML.

    ``judged`` has the runs as they were judged; ``signals`` how signals of two runs differ, by default their errors.
    """
    labels = _labels(judged)
    if signals is None:
        signals = signal_differences(runs[0], runs[1]) if len(runs) > 1 else []
    each = zip(labels, runs, judged, map(colour_of, (0, 1)), strict=False)
    shown = [Shown(*one) for one in each]
    title = " against ".join(dict.fromkeys(f"{one.identity.scenario}: {one.identity.law}" for one in judged))
    drawn = charts(shown, signals)
    first, *others = [list(place(chart, n)) for n, chart in enumerate(drawn)] or [[]]
    parts = [
        *_head(labels, judged),
        *_changes(labels, runs),
        *_signals(signals),
        *first,
        *(_figures(judged[0]) if len(runs) == 1 else _differences(labels, differences(*judged))),
        *(part for other in others for part in other),
        *(part for one in judged for part in _outcomes(one)),
        *_links(labels, judged),
        *_events(labels, judged),
        *_scenario(labels, runs),
        *charts_script(drawn),
    ]
    return document(title, parts, policy() if drawn else "")


def _labels(judged: Sequence[JudgedRun]) -> list[str]:
    """Return labels of the runs: by their law, else by their file, else by their order."""
    for labels in ([str(one.identity.law) for one in judged], [Path(str(one.recording)).stem for one in judged]):
        if len(set(labels)) == len(judged) and labels != ["None"]:
            return labels
    return ["first", "second"][: len(judged)]


def _head(labels: Sequence[str], judged: Sequence[JudgedRun]) -> Iterator[str]:
    """Yield for each run the verdict with what went wrong, in order of time, then what ran."""
    for label, one in zip(labels, judged, strict=True):
        name = f"{label}: " if len(judged) > 1 else ""
        yield f'<p class="verdict {_COLOURS[one.verdict]}">{escape(f"{name}{verdict_word(one)}{_when(one)}")}</p>'
        yield from _timeline(one)
        made, ran = one.made or {}, one.identity
        known = (("version", "mecanum_hil"), ("commit", "commit"), ("on", "machine"))
        by = " ".join(f"{word} {made[key]}" for word, key in known if key in made)
        about = (
            f"{ran.law} in {made.get('command', '?')} mode, {ran.mode} over {ran.link}, seed {ran.seed}; "
            f"{made.get('started', '')} {by}"
        )
        yield f'<p class="about">{escape(about)}</p><p class="about">{escape(str(one.recording))}</p>'
        yield from (f'<p class="note">{escape(sentence)}</p>' for sentence in one.notes)


def _signals(signals: Sequence[SignalDifference]) -> Iterator[str]:
    """Yield the differences of signals of two runs."""
    if signals:
        head, *rows = signal_rows(signals)
        yield from table(head, _escaped(rows), numbers=(1, 2, 3))


def _when(run: JudgedRun) -> str:
    """Return when a run failed first or ended, or what held in one that passed."""
    if run.passed:
        held = sum(row.passed is True for row in run.expect)
        return f": {held} of {len(run.expect)} expectations held" if run.expect else ": nothing was expected of it"
    times = [one.t_s for one in timeline(run) if one.kind in _BAD and math.isfinite(one.t_s)]
    word = ": it ended" if run.verdict is Verdict.NONE else ""
    return f"{word} at t = {min(times):.6g} s" if times else ""


def _timeline(run: JudgedRun) -> Iterator[str]:
    """Yield the problems of a run and their possible explanations, in order of time."""
    found, cells = [one for one in timeline(run) if one.kind != "state"], []  # the charts show that
    for one in found[:_FIRST_SHOWN]:
        kind = mark(one.kind, good=False) if one.kind in _BAD else f'<span class="note">{escape(one.kind)}</span>'
        t = f'<button class="at" data-t="{one.t_s}">{one.t_s:.6g} s</button>' if math.isfinite(one.t_s) else ""
        cells.append((t, kind, escape(one.text)))
    if cells:
        yield from table(("t", "", "what happened"), cells, numbers=(0,))
    if len(found) > _FIRST_SHOWN:
        yield f'<p class="about">{len(found) - _FIRST_SHOWN} more are below.</p>'


def _outcomes(run: JudgedRun) -> Iterator[str]:
    """Yield the expectations in the order of ``in_order``, then the faults, then everything else that happened."""
    if rows := in_order(run.expect):
        yield "<h2>Expectations</h2>"
        cells = [
            (_OUTCOMES[row.passed] if row.passed is None else mark(_OUTCOMES[row.passed], row.passed), escape(row.text))
            for row in rows
        ]
        yield from table(("", "expectation"), cells)
    if run.faults:
        yield "<h2>Faults</h2>"
        cells = [
            (mark("applied" if row.applied else "never applied", bool(row.applied)), escape(applied_text(row)))
            for row in run.faults
        ]
        yield from table(("", "fault"), cells)
    if others := _escaped(row for row in outcome_rows(run) if row[0] not in ("expect", "fault")):
        yield "<h2>What happened on the way</h2>"
        yield from table(("", ""), others)


def _figures(run: JudgedRun) -> Iterator[str]:
    yield "<h2>Figures</h2>"
    yield from table(("figure", "value"), _escaped((*figure_rows(run), *belief_rows(run))))


def _differences(labels: Sequence[str], rows: Sequence[Difference]) -> Iterator[str]:
    def number(value: float | None, form: str, row: Difference) -> str:
        return "-" if value is None else escape(f"{value * row.scale:{form}} {row.unit}".rstrip())

    def cells(row: Difference) -> tuple[str, ...]:
        numbers = (number(row.first, ".5g", row), number(row.second, ".5g", row), number(row.difference, "+.4g", row))
        return escape(row.label), *numbers, f'<span class="{row.verdict or ""}">{row.verdict or ""}</span>'

    head = ("figure", *map(escape, labels), "difference", f"{escape(labels[1])} is")
    told = [row for verdict in ("worse", "better", None) for row in rows if row.verdict == verdict]
    told = [row for row in told if not row.of_machine and (row.verdict or row.difference != 0)]
    yield "<h2>Figures</h2>"
    yield from table(head, map(cells, told), numbers=(1, 2, 3))
    notes = dict.fromkeys(f"{row.label}: {note}" for row in told for note in row.notes)
    yield from (f'<p class="note">{escape(note)}</p>' for note in notes)
    if rest := [row for row in rows if row not in told]:
        yield f"<details><summary>{len(rest)} that are the same, or of this machine</summary>"
        yield from table(head, map(cells, rest), numbers=(1, 2, 3))
        yield "</details>"


def _links(labels: Sequence[str], judged: Sequence[JudgedRun]) -> Iterator[str]:
    yield "<h2>Link statistics</h2>"
    each = [dict(link_rows(one)) for one in judged]
    names = dict.fromkeys(name for one in each for name in one)
    rows = _escaped((name, *(one.get(name, "-") for one in each)) for name in names)
    yield from table(("", *map(escape, labels)), rows) if rows else ["<p>The recording has none.</p>"]


def _events(labels: Sequence[str], judged: Sequence[JudgedRun]) -> Iterator[str]:
    yield "<h2>Events</h2>"
    events = [
        (event.t_s, label, event.level, event.text)
        for label, one in zip(labels, judged, strict=True)
        for event in one.events
    ]
    cells = [
        (f"{t_s:.3f}", escape(label), mark(level, level not in ("ERROR", "WARN")), escape(text))
        for t_s, label, level, text in sorted(events, key=itemgetter(0))
    ]
    yield from table(("t [s]", "run", "level", "event"), cells, numbers=(0,)) if cells else ["<p>None.</p>"]


def _changes(labels: Sequence[str], runs: Sequence[RecordedRun]) -> Iterator[str]:
    """Yield what was changed between two runs."""
    if len(runs) > 1:
        yield "<h2>What was changed</h2>"
        cells = _escaped(change.words() for change in changes(*runs))
        yield from table(("", *map(escape, labels)), cells) if cells else ["<p>Nothing.</p>"]


def _scenario(labels: Sequence[str], runs: Sequence[RecordedRun]) -> Iterator[str]:
    """Yield every value of the scenario with its source."""
    for label, run in zip(labels, runs, strict=True):
        name = f" of {label}" if len(runs) > 1 else ""
        yield f"<h2>Scenario{escape(name)}</h2>"
        sources = json_object(run, "scenario_sources")
        cells = _escaped((key, _value(value), str(sources.get(key, ""))) for key, value in scenario_of(run).items())
        yield from table(("key", "value", "given by"), cells) if cells else ["<p>The recording does not hold it.</p>"]


def _escaped(rows: Iterable[Sequence[str]]) -> list[tuple[str, ...]]:
    return [tuple(map(escape, row)) for row in rows]


def _value(value: object) -> str:
    return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
