"""What was judged in a run, as a page shows it: lanes, bounds, marks, and the instants that matter."""

import contextlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.core.options import plain
from hil.core.signals import unit_of
from hil.faults.kind import claimed_span_s
from hil.judge.claims import claim_of, signals_of
from hil.record.claims import claims
from hil.record.layout import PLAIN_COLOUR, Entity
from hil.record.layout import Series as OneSeries
from hil.record.limits import limits
from hil.record.properties import table_rows
from hil.review.charts import Band, Lane, Mark
from hil.review.contents import Series
from hil.review.figures import expected, scenario_number, scenario_of
from hil.review.reader import RecordedRun
from hil.scenario.trial import ExpectTable

_MOST_BANDS = 60
_CLOSE = 0.002


def planned_s(run: RecordedRun) -> tuple[float, float]:
    """Return from when to when a page shows a run: from t = 0, or later, to its end, or the planned one of one cut."""
    t_s = run.signals["loop.t_s"]
    first_s, last_s = (float(t_s[0]), float(t_s[-1])) if len(t_s) else (0.0, 0.0)
    end_s, rate_hz = (scenario_number(run, f"loop.{key}") or 0.0 for key in ("duration_s", "rate_hz"))
    is_cut = rate_hz > 0.0 and last_s < end_s - 2.0 / rate_hz
    return max(first_s, 0.0), end_s if is_cut else last_s


def lanes(run: RecordedRun, found: Mapping[str, Any]) -> Iterator[Lane]:
    """Yield what ended the run, a lane for each expectation about a time, the failed ones first, and for each fault.

    ``found`` are the run's figures.
    """
    begin_s, end_s = planned_s(run)
    last_s = float(run.signals["loop.t_s"][-1])
    if found["failure"] is not None:
        yield Lane(f"ENDED at {last_s:.4g} s", [Band(last_s, end_s, "violated")])
    rows = [(row, outcome) for row, outcome in judged_rows(run, found) if row.figure is None]
    for row, outcome in sorted(rows, key=lambda pair: _urgency(pair[1])):
        with contextlib.suppress(ValueError):  # a fault that this version does not understand
            from_s, to_s = _span(run, row)
            bands = [Band(begin_s, from_s, "waiting")] if from_s > begin_s else []
            bands += _judged_bands(run, row, outcome, (max(from_s, begin_s), min(to_s, last_s)))
            bands += [Band(min(to_s, last_s), end_s, "waiting")] if min(to_s, last_s) < end_s else []
            word = {True: "held", False: "FAILED", None: "not judged"}[outcome["passed"]]
            claim = f"stops because of {row.stops}" if row.stops is not None else claim_of(row).text
            yield Lane(f"{word}: {row.subject} {claim}", bands)
    for fault in found["fault"] or ():
        word = "" if fault["applied"] is not False and fault["applied"] != 0 else ", never applied"
        yield Lane(f"fault: {fault['text']}{word}", [fault_band(fault, end_s)])


def _span(run: RecordedRun, row: ExpectTable) -> tuple[float, float]:
    """Return from when to when a claim was judged. Raises ValueError for a fault that the scenario does not have."""
    return claimed_span_s(plain(row), table_rows(scenario_of(run), "fault"))


def fault_band(fault: Mapping[str, Any], end_s: float) -> Band:
    """Return the time during which a fault of a run's JSON was in force, until ``end_s`` at most."""
    stop_s = end_s if fault["end_s"] is None else min(fault["end_s"], end_s)
    return Band(fault["start_s"], max(stop_s, fault["start_s"]), "fault")


def judged_rows(run: RecordedRun, found: Mapping[str, Any]) -> list[tuple[ExpectTable, Mapping[str, Any]]]:
    """Return the scenario's expectations, each with its outcome."""
    left, found_rows = expected(run), []
    for outcome in found["expect"] or ():
        if (row := next((row for row in left if _is_of(row, outcome)), None)) is not None:
            left.remove(row)
            found_rows.append((row, outcome))
    return found_rows


def _is_of(row: ExpectTable, outcome: Mapping[str, Any]) -> bool:
    names = (row.signal, row.figure, row.stops)
    about = row.stops is not None or row.figure is not None or outcome["text"].startswith(row.subject)
    return about and names == tuple(outcome.get(name) for name in ("signal", "figure", "stops"))


def _urgency(outcome: Mapping[str, Any]) -> tuple[int, float]:
    at_s = outcome["violation_s"]
    return {False: 0, None: 1, True: 2}[outcome["passed"]], math.inf if at_s is None else at_s


def _judged_bands(
    run: RecordedRun, row: ExpectTable, outcome: Mapping[str, Any], judged_s: tuple[float, float]
) -> Iterator[Band]:
    """Yield the bands of the time in which an expectation was judged."""
    from_s, to_s = judged_s
    if from_s >= to_s:
        return
    begun_s = from_s if outcome.get("settled_s") is None else outcome["settled_s"]
    if begun_s > from_s:
        yield Band(from_s, begun_s, "waiting")
    if outcome["passed"] is not False:
        yield Band(begun_s, to_s, "held")
        return
    yield Band(from_s, to_s, "held")
    if row.signal is None:  # rest, or a stop that did not come
        since_s = outcome["violation_s"]
        yield Band(from_s if since_s is None else since_s, to_s, "violated")
        return
    yield from _violated(run, row, judged_s)


def _violated(run: RecordedRun, row: ExpectTable, judged_s: tuple[float, float]) -> list[Band]:
    """Return when a claim about a signal was violated; violations that are close together are one band."""
    values, t_s = _value(run, row), run.signals["loop.t_s"]
    if values is None:
        return []
    inside = (t_s >= judged_s[0]) & (t_s <= judged_s[1])
    t_s, claim = t_s[inside], claim_of(row)
    bad = ~np.fromiter(map(claim.holds, values[inside].tolist()), bool, int(inside.sum()))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    close_s = _CLOSE * (judged_s[1] - judged_s[0])
    found: list[Band] = []
    for begin, end in edges.reshape(-1, 2).tolist():
        begin_s, end_s = float(t_s[begin]), float(t_s[min(end, len(t_s) - 1)])
        if found and (begin_s - found[-1].end < close_s or len(found) >= _MOST_BANDS):
            found[-1] = found[-1]._replace(end=end_s)
        else:
            found.append(Band(begin_s, max(end_s, begin_s + close_s), "violated"))
    return found


def _value(run: RecordedRun, row: ExpectTable) -> Series | None:
    """Return the value that a claim about a signal is about, of shape (rows,); None if the recording lacks it."""
    if row.signal is None or any(name not in run.signals for name in signals_of(row)):
        return None
    values = run.signals[row.signal]
    if row.of is None:
        return values
    apart: Series = values - run.signals[row.of]
    return np.remainder(apart + np.pi, 2 * np.pi) - np.pi if unit_of(row.signal) == "rad" else apart


def bounds(run: RecordedRun, names: Sequence[str]) -> dict[str, list[tuple[str, Series]]]:
    """Return the limits of signals, each as its label and its values of shape (rows,), NaN outside its time."""
    entities = [Entity(name, (OneSeries(name, "", PLAIN_COLOUR),)) for name in names]
    try:
        scenario = scenario_of(run)
        found = limits(scenario, claims(scenario), entities)
    except ValueError:  # an expectation after a fault that this version does not understand
        return {}
    column = {name: place for place, name in enumerate(run.signals)}
    lines = {}
    for name, each in found.items():
        known = [line for line in each if line.of is None or line.of in column]
        rows = np.stack([run.signals[one] for one in column], axis=1) if any(line.of for line in known) else np.empty(0)
        t_s = run.signals["loop.t_s"]
        rows = rows if rows.size else np.empty((len(t_s), 0))
        lines[name] = [(line.label, np.where(line.inside(t_s), line.values(column, rows), np.nan)) for line in known]
    return lines


def marks(run: RecordedRun, found: Mapping[str, Any], name: str, scale: float = 1.0) -> list[Mark]:
    """Return the first violation of each failed expectation about a signal, where the signal was then."""
    t_s, values, made = run.signals["loop.t_s"], run.signals[name], []
    for row in found["expect"] or ():
        if row["passed"] is False and row["signal"] == name and row["violation_s"] is not None:
            # Where the violation is that the signal has no value, the mark is at its value before that.
            before = values[: int(np.searchsorted(t_s, row["violation_s"], "right"))]
            known = before[np.isfinite(before)][-1:]
            value = scale * float(known[0]) if len(known) else 0.0
            word = "not settled" if " settles to " in row["text"] else "violated"
            made.append(Mark(row["violation_s"], value, f"{word} at {row['violation_s']:.4g} s"))
    return made


def violations(run: RecordedRun, found: Mapping[str, Any], name: str) -> list[Band]:
    """Return when the failed expectations about a signal were violated; not for one that never settled."""
    bands = []
    for row, outcome in judged_rows(run, found):
        if outcome["passed"] is False and row.signal == name and row.settles_to is None:
            with contextlib.suppress(ValueError):
                from_s, to_s = _span(run, row)
                bands += _violated(run, row, (from_s, min(to_s, float(run.signals["loop.t_s"][-1]))))
    return bands


def instants(found: Mapping[str, Any]) -> list[float]:
    """Return the times at which a reader will look, the most important first: violations, then the faults' edges."""
    failed = [row for row in found["expect"] or () if row["passed"] is False]
    times = [row.get(name) for name in ("violation_s", "worst_s") for row in failed]
    times += [fault[edge] for edge in ("start_s", "end_s") for fault in found["fault"] or ()]
    return list(dict.fromkeys([*(at_s for at_s in times if at_s is not None and math.isfinite(at_s)), 0.0]))
