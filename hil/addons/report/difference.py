"""Comparison of two runs: figures, which is better, scenarios and code, lines for a terminal, and signals."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.addons.report.verdict_text import HASHES, PROPERTY_WORDS, hash_text
from hil.core.errors import UnknownSignalError
from hil.core.signals import unit_of
from hil.judge.figures import figures
from hil.judge.judged_run import ExpectationResult, JudgedRun
from hil.judge.measure import Figure
from hil.judge.recorded import json_object, scenario_of
from hil.judge.run_text import COLUMNS, failed_text, head_rows, row_lines, timeline, wrapped
from hil.record.contents import Series
from hil.record.reader import RecordedRun

_SAME = 1e-9


class Difference(NamedTuple):
    """A figure of both runs; ``difference`` is second minus first, in the unit in which the figure is stored.

    ``verdict`` says whether the second run is better, worse or the same. It is None for a figure of which neither more
    nor less is better, when a run ended early, and when a run lacks the figure (``notes`` has the reason). Runs that
    differ by less than the figure's resolution are the same. ``of_machine``: whether it depends on how fast this
    machine is.
    """

    label: str
    name: str
    unit: str
    scale: float
    first: float | None
    second: float | None
    difference: float | None
    verdict: str | None
    notes: tuple[str, ...]
    of_machine: bool = False


class Change(NamedTuple):
    """A value of the scenario, or a property of the run, that differs; None where a run lacks it."""

    key: str
    first: object
    second: object

    def words(self) -> tuple[str, str, str]:
        """Return the key and both values as text; of a hash a label and the first digits.

        Older recordings lack some hashes: they are "not recorded".
        """
        is_hash = self.key in HASHES
        nothing, text = ("not recorded", hash_text) if is_hash else ("not given", str)
        first, second = (nothing if value is None else text(str(value)) for value in (self.first, self.second))
        return PROPERTY_WORDS[self.key] if is_hash else self.key, first, second


def differences(first: JudgedRun, second: JudgedRun) -> list[Difference]:
    """Return every figure that one of two runs has."""
    both_ended = all(run.failure is None for run in (first, second))
    rows = []
    for figure in figures():
        name, label, unit, scale = figure[:4]
        one, other = first.number(name), second.number(name)
        if one is None and other is None:
            continue
        notes = tuple(
            f"{which} has none: {reason}"
            for which, value, run in (("the first", one, first), ("the second", other, second))
            if value is None and (reason := run.why_none(name)) is not None
        )
        difference = verdict = None
        if one is not None and other is not None:
            difference = other - one
            verdict = _verdict(figure, one, other) if both_ended else None
        rows.append(Difference(label, name, unit, scale, one, other, difference, verdict, notes, figure.of_machine))
    return rows


def changes(first: RecordedRun, second: RecordedRun) -> list[Change]:
    """Return what differs between the two runs.

    First come the law's code and gains, the FMU, the firmware, the map, the seed and the link; then the other values of
    the scenario; then versions, commit and machine. Code and files go by their hashes. What only follows from another
    change is left out.
    """
    left_out = {"scenario", "scenario_sources", "started", "gains", *HASHES}
    scenarios, others = [], []
    for run in (first, second):
        gains = {f"controller.gains.{name}": value for name, value in json_object(run, "gains").items()}
        scenarios.append(gains | scenario_of(run))
        others.append({name: text for name, text in run.properties.items() if name not in left_out})
    if all(scenarios):
        others = [{name: text for name, text in one.items() if name not in _IN_SCENARIO} for one in others]
    hashes = [one for one in _unequal(first.properties, second.properties, HASHES) if not _follows(one, first, second)]
    found = [*hashes, *_unequal(scenarios[0], scenarios[1])]
    return [*sorted(found, key=_group), *_unequal(others[0], others[1])]


_IN_SCENARIO = ("scenario_sha256", "seed", "law", "mode", "link", "command")
_GROUPS = (
    ("law_", "controller."),
    ("fmu_", "cosim_", "plant.fmu"),
    ("wheel_host_", "motors_file_", "firmware."),
    ("map_", "plant.map."),
    ("loop.seed",),
    ("link.",),
)
"""What is told first of the changes, by how their keys begin."""


def _group(change: Change) -> int:
    return next((place for place, begins in enumerate(_GROUPS) if change.key.startswith(begins)), len(_GROUPS))


def _follows(change: Change, first: RecordedRun, second: RecordedRun) -> bool:
    """Whether a native library is another one because its sources are."""
    sources = change.key.replace("_sha256", "_sources_sha256")
    hashes = {run.properties.get(sources) for run in (first, second)}
    return sources != change.key and None not in hashes and len(hashes) == 2


def _verdict(figure: Figure, first: float, second: float) -> str | None:
    if figure.better is None:
        return None
    if abs(second - first) < figure.resolution or math.isclose(first, second, rel_tol=_SAME):
        return "same"
    return "better" if (second < first) == (figure.better == "less") else "worse"


def _unequal(first: Mapping[str, Any], second: Mapping[str, Any], keys: Sequence[str] = ()) -> Iterator[Change]:
    for key in keys or dict.fromkeys([*first, *second]):
        if first.get(key) != second.get(key):
            yield Change(key, first.get(key), second.get(key))


_CHANGES_SHOWN = 20
_LONGEST_VALUE = 52
_COUNTS = ("frames.sent", "frames.received")


def pair_lines(
    runs: Sequence[JudgedRun],
    differences: Sequence[Difference],
    changes: Sequence[Change],
    *,
    everything: bool = False,
) -> Iterator[str]:
    """Yield the lines about two runs.

    ``everything``: also figures that are the same, and those of the machine.
    """
    for which, run in zip(("first", "second"), runs, strict=True):
        yield from wrapped(f"{which:<6}  ", str(run.recording))
        yield from row_lines(_head(run))
    yield from ("", "What was changed:" if changes else "Nothing was changed in scenario, code and versions.")
    for change in changes[: None if everything else _CHANGES_SHOWN]:
        yield from _change_lines(change)
    if len(changes) > _CHANGES_SHOWN and not everything:
        yield f"  {len(changes) - _CHANGES_SHOWN} more; --all, --json and --html have them"
    yield from _claims(*runs)
    shown = [row for row in differences if everything or not row.of_machine]
    for verdict, title in (("worse", "Worse in the second run:"), ("better", "Better in the second run:")):
        if rows := sorted((row for row in shown if row.verdict == verdict), key=_share, reverse=True):
            yield from ("", title, *map(_difference_line, rows))
    same = [row for row in shown if row.verdict == "same"]
    others = [row for row in shown if row.verdict is None and (everything or row.difference != 0)]
    if others := [row for row in others if everything or row.name not in _COUNTS]:
        has_ended = any(run.failure is not None for run in runs)
        title = "Not judged, because a run ended early:" if has_ended else "Other figures that differ:"
        yield from ("", title, *map(_difference_line, others))
    if same and everything:
        yield from ("", "The same:", *map(_difference_line, same))
    elif same:
        yield from ("", *wrapped("The same: ", f"{len(same)} figures (--all lists them)"))
    notes = dict.fromkeys(note for row in shown for note in row.notes)
    for note in notes:
        labels = ", ".join(row.label for row in shown if note in row.notes)
        yield from wrapped("  ", f"{labels}: {note}")


def _head(run: JudgedRun) -> Iterator[tuple[str, str]]:
    """Yield the verdict of a run, and the first reason that it has."""
    yield from (row for row in head_rows(run) if row[0] != "given")
    told = [one for one in timeline(run) if one.kind in ("failed", "ended", "allow", "moved", "no fault")]
    if told and not run.passed:
        more = f"; and {len(told) - 1} more reasons" if len(told) > 2 else "; and one more reason" if told[1:] else ""
        yield "why", f"{told[0].text}{more}"


def _change_lines(change: Change) -> Iterator[str]:
    key, *values = change.words()
    first, second = (text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…" for text in values)
    line = f"  {key}: {first} -> {second}"
    if len(line) <= COLUMNS:
        yield line
    else:
        yield from (f"  {key}:", f"    {first}", f"    -> {second}")


def _claims(first: JudgedRun, second: JudgedRun) -> Iterator[str]:
    """Yield the expectations that hold in one run and fail in the other."""

    def rows(run: JudgedRun) -> dict[str, ExpectationResult]:
        return {row.claim: row for row in run.expect}

    before, after = rows(first), rows(second)
    moved = [(claim, before[claim].passed, row) for claim, row in after.items() if claim in before]
    fails = [failed_text(row) for _, passed, row in moved if passed and row.passed is False]
    holds = [claim for claim, passed, row in moved if passed is False and row.passed]
    for title, texts in (("Fails in the second run:", fails), ("Holds in the second run:", holds)):
        if texts:
            yield from ("", title)
            for text in texts:
                yield from wrapped("  ", text)


def _share(row: Difference) -> float:
    """Return the size of a difference by that of the larger value."""
    assert row.first is not None, "it has a verdict"
    assert row.second is not None, "it has a verdict"
    return abs(row.second - row.first) / max(abs(row.first), abs(row.second), 1e-300)


def _difference_line(row: Difference) -> str:
    first, second = ("-" if one is None else f"{one * row.scale:.5g}" for one in (row.first, row.second))
    ratio = f"{100 * row.difference / abs(row.first):+.3g} %" if row.first and row.difference else ""
    return f"  {row.label:<22} {first:>9} -> {second:<9} {row.unit:<14} {ratio}".rstrip()


COMPARED = ("error.planar_m", "error.x_m", "error.y_m", "error.heading_rad")
"""The signals that are compared where none is named."""


class SignalDifference(NamedTuple):
    """A signal of the second run minus that of the first, at the times of the first.

    Attributes:
        name: the signal's.
        unit: its unit.
        t_s: the times [s] at which both runs have a value, of shape (n,).
        values: the differences there; of headings the shorter way around.
    """

    name: str
    unit: str
    t_s: Series
    values: Series

    def figures(self) -> dict[str, Any]:
        """Return what ``hil review --json`` says; None without a time at which both runs have a value."""
        apart = np.abs(self.values)
        known = len(apart) > 0
        most = int(np.argmax(apart)) if known else 0
        return {
            "name": self.name,
            "unit": self.unit,
            "samples": len(apart),
            "rms": float(np.sqrt(np.mean(apart**2))) if known else None,
            "max": float(apart[most]) if known else None,
            "max_s": float(self.t_s[most]) if known else None,
        }


def signal_differences(first: RecordedRun, second: RecordedRun, asked: Sequence[str] = ()) -> list[SignalDifference]:
    """Return how signals of the second run differ from those of the first, at the first's times; by default the errors.

    The values of the second run are interpolated; where it has none, or lacks rows, there is no difference. Raises
    UnknownSignalError for a signal that a run lacks.
    """
    for name in asked:
        for run in (first, second):
            if name not in run.signals:
                raise UnknownSignalError(name, run.held or run.signals)
    usual = [name for name in COMPARED if name in first.signals and name in second.signals]
    return [_difference(first, second, name) for name in asked or usual]


def _difference(first: RecordedRun, second: RecordedRun, name: str) -> SignalDifference:
    t_s, other_s = first.signals["loop.t_s"], second.signals["loop.t_s"]
    values, others = first.signals[name], second.signals[name]
    unit = unit_of(name)
    is_angle = unit == "rad"
    if is_angle:  # between two samples the shorter way around
        known = np.isfinite(others)
        others = others.copy()
        others[known] = np.unwrap(others[known])
    beside = np.interp(t_s, other_s, others, left=np.nan, right=np.nan) if len(other_s) else np.full(len(t_s), np.nan)
    if len(other_s) > 1:
        gap_s = 1.5 * float(np.median(np.diff(other_s)))
        after = np.clip(np.searchsorted(other_s, t_s), 1, len(other_s) - 1)
        beside[(other_s[after] - other_s[after - 1] > gap_s) & ~np.isin(t_s, other_s)] = np.nan
    apart = beside - values
    if is_angle:
        apart = np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi
    known = np.isfinite(apart)
    return SignalDifference(name, unit, t_s[known], apart[known])


def signal_rows(differences: Sequence[SignalDifference]) -> list[tuple[str, ...]]:
    """Return differences of signals as a table of texts, with its head."""
    return [("difference of", "rms", "largest", "at"), *map(_row, differences)]


def _row(one: SignalDifference) -> tuple[str, ...]:
    found = one.figures()
    rms, most = ("-" if found[name] is None else f"{found[name]:.4g} {one.unit}".rstrip() for name in ("rms", "max"))
    return one.name, rms, most, "-" if found["max_s"] is None else f"{found['max_s']:.4g} s"
