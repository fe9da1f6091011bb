"""What was judged in a run, as a page shows it: lanes, bounds, marks, and the instants that matter."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.faults.kinds import is_instant
from hil.judge.words import urgency
from hil.record.claims import Claim, ClaimWatch, Standing, claims
from hil.record.layout import PLAIN_COLOUR, Entity
from hil.record.layout import Series as OneSeries
from hil.record.limits import limits
from hil.review.charts import Band, Lane, Mark
from hil.review.contents import Series
from hil.review.figures import scenario_number, scenario_of
from hil.review.reader import RecordedRun

Outcome = Mapping[str, Any]
"""An expectation's entry in a run's JSON; that of an older version lacks some keys."""
_MOST_BANDS = 60
_WORDS = {True: "held", False: "FAILED", None: "not judged"}


def planned_s(run: RecordedRun) -> tuple[float, float]:
    """Return from when to when a page shows a run: from t = 0, or later, to its end, or the planned one of one cut."""
    t_s = run.signals["loop.t_s"]
    first_s, last_s = (float(t_s[0]), float(t_s[-1])) if len(t_s) else (0.0, 0.0)
    end_s, rate_hz = (scenario_number(run, f"loop.{key}") or 0.0 for key in ("duration_s", "rate_hz"))
    is_cut = rate_hz > 0.0 and last_s < end_s - 2.0 / rate_hz
    return max(first_s, 0.0), end_s if is_cut else last_s


def claimed(run: RecordedRun) -> list[Claim]:
    """Return the claims of the run's scenario; none where this version does not understand them."""
    try:
        return claims(scenario_of(run))
    except (KeyError, ValueError):
        return []


def lanes(run: RecordedRun, found: Mapping[str, Any]) -> Iterator[Lane]:
    """Yield what ended the run, a lane for each expectation about a time, the failed ones first, and for each fault.

    ``found`` are the run's figures.
    """
    begin_s, end_s = planned_s(run)
    last_s = float(run.signals["loop.t_s"][-1])
    if found["failure"] is not None:
        yield Lane(f"ENDED at {last_s:.6g} s", [Band(last_s, end_s, "violated")])
    rows = [(claim, outcome) for claim, outcome in _judged(run, found) if outcome.get("figure") is None]
    for claim, outcome in sorted(rows, key=lambda pair: urgency(pair[1])):
        from_s, to_s = max(claim.from_s, begin_s), min(claim.to_s, last_s)
        bands = [Band(begin_s, min(from_s, end_s), "waiting")] if from_s > begin_s else []
        if from_s < to_s:
            bands += [Band(from_s, to_s, "held"), *_broken(run, claim, outcome, from_s, to_s)]
        bands += [Band(to_s, end_s, "waiting")] if to_s < end_s else []
        yield Lane(f"{_WORDS[outcome['passed']]}: {claim.words}", bands)
    for fault in faults(found):
        word = "" if fault["applied"] is not False and fault["applied"] != 0 else ", never applied"
        yield Lane(f"fault: {fault['text']}{word}", [fault_band(fault, end_s)])


def faults(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the faults of a run's figures, but for those of an older version, which did not say when they were."""
    return [fault for fault in found["fault"] or () if fault.get("start_s") is not None]


def fault_band(fault: Mapping[str, Any], end_s: float) -> Band:
    """Return the time during which a fault of a run's JSON was in force, until ``end_s`` at most.

    A fault that only happens does not last.
    """
    start_s = float(fault["start_s"])
    if is_instant(fault["kind"], fault["target"]):
        return Band(start_s, start_s, "fault")
    stop_s = end_s if fault["end_s"] is None else min(fault["end_s"], end_s)
    return Band(start_s, max(stop_s, start_s), "fault")


def _judged(run: RecordedRun, found: Mapping[str, Any]) -> list[tuple[Claim, Outcome]]:
    """Return the claims of the scenario, each with its outcome; both are in the order of the scenario."""
    left, pairs = claimed(run), []
    for outcome in found["expect"] or ():
        if (claim := next((claim for claim in left if _is_of(claim, outcome)), None)) is not None:
            left.remove(claim)
            pairs.append((claim, outcome))
    return pairs


def _is_of(claim: Claim, outcome: Outcome) -> bool:
    if outcome.get("signal") is not None:
        return claim.signal == str(outcome["signal"])
    figure, stops = outcome.get("figure"), outcome.get("stops")
    words = None if figure is None and stops is None else str(figure) if stops is None else f"stops {stops}"
    return claim.is_rest if words is None else claim.signal is None and claim.words.startswith(words)


def _broken(run: RecordedRun, claim: Claim, outcome: Outcome, from_s: float, to_s: float) -> list[Band]:
    """Return when a claim did not hold in its time: violated, or not yet settled."""
    names = ["loop.t_s", *claim.needed]
    if not claim.needed or any(name not in run.signals for name in names):  # a stop that did not come, for one
        since_s = outcome.get("violation_s")
        return [Band(from_s if since_s is None else since_s, to_s, "violated")] if outcome["passed"] is False else []
    watch = ClaimWatch(claim, {name: place for place, name in enumerate(names)}, scenario_of(run))
    standing = watch(np.column_stack([run.signals[name] for name in names])).standing
    kind = "violated" if outcome["passed"] is False else "waiting"  # what has settled in the end was not violated
    return _bands(run.signals["loop.t_s"], np.isin(standing, [Standing.VIOLATED, Standing.SETTLING]), kind)


def _bands(t_s: Series, flags: npt.NDArray[np.bool_], kind: str) -> list[Band]:
    """Return when flags are set; where this changes too often, what is nearest together is one band."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int))).reshape(-1, 2)
    if not len(edges):
        return []
    begins, ends = t_s[edges[:, 0]], t_s[np.minimum(edges[:, 1], len(t_s) - 1)]
    widest = np.sort(np.argsort(begins[1:] - ends[:-1])[1 - _MOST_BANDS :])
    begins, ends = begins[np.append(0, widest + 1)], ends[np.append(widest, len(ends) - 1)]
    return [Band(float(begin_s), float(end_s), kind) for begin_s, end_s in zip(begins, ends, strict=True)]


def violations(run: RecordedRun, found: Mapping[str, Any], name: str) -> list[Band]:
    """Return when the failed expectations about a signal were violated; not for one that never settled."""
    last_s = float(run.signals["loop.t_s"][-1])
    return [
        band
        for claim, outcome in _judged(run, found)
        if outcome["passed"] is False and claim.signal == name and not claim.settles
        for band in _broken(run, claim, outcome, claim.from_s, min(claim.to_s, last_s))
    ]


def bounds(run: RecordedRun, name: str) -> Iterator[tuple[str, Series]]:
    """Yield the limits of a signal, each as its label and its values of shape (rows,), NaN outside its time."""
    entity = Entity(name, (OneSeries(name, "", PLAIN_COLOUR),))
    t_s = run.signals["loop.t_s"]
    for line in limits(scenario_of(run), claimed(run), [entity]).get(name, ()):
        if line.of is None or line.of in run.signals:
            base = np.zeros((len(t_s), 1)) if line.of is None else run.signals[line.of][:, None]
            values = line.values({} if line.of is None else {line.of: 0}, base)
            yield line.label.partition(":")[0], np.where(line.inside(t_s), values, np.nan)


def marks(run: RecordedRun, found: Mapping[str, Any], name: str, scale: float = 1.0) -> list[Mark]:
    """Return the first violation of each failed expectation about a signal, where the signal was then."""
    t_s, values, made = run.signals["loop.t_s"], run.signals[name], []
    for claim, outcome in _judged(run, found):
        if outcome["passed"] is False and claim.signal == name and (at_s := outcome.get("violation_s")) is not None:
            # Where the violation is that the signal has no value, the mark is at its value before that.
            before = values[: int(np.searchsorted(t_s, at_s, "right"))]
            known = before[np.isfinite(before)][-1:]
            value = scale * float(known[0]) if len(known) else 0.0
            word = "not settled" if claim.settles else "violated"
            made.append(Mark(at_s, value, f"{word} at {at_s:.6g} s"))
    return made


def instants(found: Mapping[str, Any]) -> list[float]:
    """Return the times at which a reader will look, the most important first: violations, then the faults' edges."""
    failed = [row for row in found["expect"] or () if row["passed"] is False]
    times = [row.get(name) for name in ("violation_s", "worst_s") for row in failed]
    times += [fault.get(edge) for edge in ("start_s", "end_s") for fault in found["fault"] or ()]
    return list(dict.fromkeys([*(at_s for at_s in times if at_s is not None and math.isfinite(at_s)), 0.0]))
