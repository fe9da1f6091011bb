"""A run as a page shows it: its judgement as lanes, bounds and marks, and its signals with few points."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.addons.report.charts import Band, Lane, Line, Mark
from hil.addons.report.claim_watch import Claim, ClaimWatch, Standing, claims, limits
from hil.addons.report.entities import Entity
from hil.addons.report.entities import Series as OneSeries
from hil.judge.judged_run import ExpectationResult, FaultResult, JudgedRun, urgency
from hil.judge.recorded import fault_span_s, scenario_number, scenario_of
from hil.pages.plots import ALARM_COLOUR, PLAIN_COLOUR, Colour
from hil.record.contents import Series
from hil.record.reader import RecordedRun

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


def lanes(run: RecordedRun, found: JudgedRun) -> Iterator[Lane]:
    """Yield what ended the run, a lane for each expectation about a time, the failed ones first, and for each fault.

    ``found`` is the run as it was judged.
    """
    begin_s, end_s = planned_s(run)
    last_s = float(run.signals["loop.t_s"][-1])
    if found.failure is not None:
        yield Lane(f"ENDED at {last_s:.6g} s", [Band(last_s, end_s, "violated")])
    rows = [(claim, outcome) for claim, outcome in _judged(run, found) if outcome.figure is None]
    for claim, outcome in sorted(rows, key=lambda pair: urgency(pair[1])):
        from_s, to_s = max(claim.from_s, begin_s), min(claim.to_s, last_s)
        bands = [Band(begin_s, min(from_s, end_s), "waiting")] if from_s > begin_s else []
        if from_s < to_s:
            bands += [Band(from_s, to_s, "held"), *_broken(run, claim, outcome, from_s, to_s)]
        bands += [Band(to_s, end_s, "waiting")] if to_s < end_s else []
        yield Lane(f"{_WORDS[outcome.passed]}: {claim.words}", bands)
    for fault in faults(found):
        word = ", never applied" if fault.applied == 0 else ""
        yield Lane(f"fault: {fault.text}{word}", [Band(*fault_span_s(fault, end_s), "fault")])


def faults(found: JudgedRun) -> list[FaultResult]:
    """Return the faults of a run, but for those of an older version, which did not say when they were."""
    return [fault for fault in found.faults if fault.start_s is not None]


def _judged(run: RecordedRun, found: JudgedRun) -> list[tuple[Claim, ExpectationResult]]:
    """Return the claims of the scenario, each with its outcome; both are in the order of the scenario."""
    left, pairs = claimed(run), []
    for outcome in found.expect:
        if (claim := next((claim for claim in left if _is_of(claim, outcome)), None)) is not None:
            left.remove(claim)
            pairs.append((claim, outcome))
    return pairs


def _is_of(claim: Claim, outcome: ExpectationResult) -> bool:
    if outcome.signal is not None:
        return claim.signal == outcome.signal
    words = outcome.figure if outcome.stops is None else f"stops {outcome.stops}"
    return claim.is_rest if words is None else claim.signal is None and claim.words.startswith(words)


def _broken(run: RecordedRun, claim: Claim, outcome: ExpectationResult, from_s: float, to_s: float) -> list[Band]:
    """Return when a claim did not hold in its time: violated, or not yet settled."""
    names = ["loop.t_s", *claim.needed]
    if not claim.needed or any(name not in run.signals for name in names):  # a stop that did not come, for one
        since_s = outcome.violation_s
        return [Band(from_s if since_s is None else since_s, to_s, "violated")] if outcome.passed is False else []
    watch = ClaimWatch(claim, {name: place for place, name in enumerate(names)}, scenario_of(run))
    standing = watch(np.column_stack([run.signals[name] for name in names])).standing
    kind = "violated" if outcome.passed is False else "waiting"  # what has settled in the end was not violated
    return _bands(run.signals["loop.t_s"], np.isin(standing, [Standing.VIOLATED, Standing.SETTLING]), kind)


def _bands(t_s: Series, flags: npt.NDArray[np.bool_], kind: str) -> list[Band]:
    """Return when flags are set; if this changes too often, the nearest bands are merged."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int))).reshape(-1, 2)
    if not len(edges):
        return []
    begins, ends = t_s[edges[:, 0]], t_s[np.minimum(edges[:, 1], len(t_s) - 1)]
    widest = np.sort(np.argsort(begins[1:] - ends[:-1])[1 - _MOST_BANDS :])
    begins, ends = begins[np.append(0, widest + 1)], ends[np.append(widest, len(ends) - 1)]
    return [Band(float(begin_s), float(end_s), kind) for begin_s, end_s in zip(begins, ends, strict=True)]


def violations(run: RecordedRun, found: JudgedRun, name: str) -> list[Band]:
    """Return when the failed expectations about a signal were violated; not for one that never settled."""
    last_s = float(run.signals["loop.t_s"][-1])
    return [
        band
        for claim, outcome in _judged(run, found)
        if outcome.passed is False and claim.signal == name and not claim.settles
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


def marks(run: RecordedRun, found: JudgedRun, name: str, scale: float = 1.0) -> list[Mark]:
    """Return the first violation of each failed expectation about a signal, where the signal was then."""
    t_s, values, made = run.signals["loop.t_s"], run.signals[name], []
    for claim, outcome in _judged(run, found):
        if outcome.passed is False and claim.signal == name and (at_s := outcome.violation_s) is not None:
            # If the violation is a missing value, the mark is at the last value before.
            before = values[: int(np.searchsorted(t_s, at_s, "right"))]
            known = before[np.isfinite(before)][-1:]
            value = scale * float(known[0]) if len(known) else 0.0
            word = "not settled" if claim.settles else "violated"
            made.append(Mark(at_s, value, f"{word} at {at_s:.6g} s"))
    return made


def instants(found: JudgedRun) -> list[float]:
    """Return the times at which a reader will look, the most important first: violations, then the faults' edges."""
    failed = [row for row in found.expect if row.passed is False]
    times = [*(row.violation_s for row in failed), *(row.worst_s for row in failed)]
    times += [*(fault.start_s for fault in found.faults), *(fault.end_s for fault in found.faults)]
    return list(dict.fromkeys([*(at_s for at_s in times if at_s is not None and math.isfinite(at_s)), 0.0]))


FINE_ROWS = 1000
"""Rows that are shown one by one around each instant: one second at 1 kHz."""
_MOST_INSTANTS = 8
_STRETCHES = 1500


class Stretches:
    """Shows signals by the minimum and maximum of each stretch, and row by row around some instants.

    ``t_s`` are the times of all rows, ascending, of shape (rows,). Around each of the first 8 ``instants`` [s] 1000
    rows are shown one by one. The others are shown in at most 1500 stretches; a recording of up to 3000 rows is shown
    whole. Where rows are missing, lines have a gap.

    Attributes:
        t_s: the times at which signals are shown, of shape (n,).
        longest_s: the length of a stretch [s]; that of one row if the recording is shown whole.
    """

    def __init__(self, t_s: Series, instants: Sequence[float] = ()) -> None:
        count = len(t_s)
        size = -(-count // _STRETCHES) if count > 2 * _STRETCHES else 1
        is_start = np.zeros(count, dtype=bool)
        is_start[::size] = True
        if size > 1:
            for instant in instants[:_MOST_INSTANTS]:
                near = int(np.searchsorted(t_s, instant))
                is_start[max(0, near - FINE_ROWS // 2) : near + FINE_ROWS // 2] = True
        period_s = float(np.median(np.diff(t_s))) if count > 1 else 0.0
        is_gap = np.append(False, np.diff(t_s) > 1.5 * period_s) if count else is_start
        self._starts = np.flatnonzero(is_start | is_gap)
        self._ends = np.append(self._starts[1:], count)
        middle = (self._starts + self._ends) // 2
        # Of each stretch a point at its start and one in its middle; before them one without a value at a gap.
        self._kept = np.stack([is_gap[self._starts], np.ones(len(middle), bool), middle > self._starts], 1).ravel()
        times = np.stack([t_s[self._starts] - period_s / 2, t_s[self._starts], t_s[middle]], 1) if count else t_s
        self.t_s: Series = times.ravel()[self._kept]
        self.longest_s = size * period_s

    def __call__(self, values: Series) -> Series:
        """Return the values of a signal, of shape (rows,), at ``t_s``; NaN where a whole stretch has none."""
        if not len(self._starts):
            return values
        low = np.fmin.reduceat(values, self._starts)
        high = np.fmax.reduceat(values, self._starts)
        rises = values[self._ends - 1] >= values[self._starts]
        first, second = np.where(rises, low, high), np.where(rises, high, low)
        shown: Series = np.stack([np.full(len(low), np.nan), first, second], 1).ravel()[self._kept]
        return shown


class Shown:
    """A run on a page: its label and colour there, its recording from t = 0 on, and how it was judged.

    Stretches around what happened are shown row by row.
    """

    def __init__(self, label: str, run: RecordedRun, found: JudgedRun, colour: Colour) -> None:
        self.label, self.run, self.found, self.colour = label, run, found, colour
        self._kept = run.signals["loop.t_s"] >= 0.0
        self.all_t_s: Series = run.signals["loop.t_s"][self._kept]
        self._stretches = Stretches(self.all_t_s, instants(found))
        self.t_s: Series = self._stretches.t_s

    @property
    def longest_s(self) -> float:
        """The longest stretch of which only minimum and maximum are shown [s]."""
        return self._stretches.longest_s

    def series(self, name: str) -> Series:
        """Return a signal from t = 0 on; only NaN if the recording lacks it."""
        values = self.run.signals.get(name)
        return np.full(len(self.all_t_s), np.nan) if values is None else values[self._kept]

    def has(self, *names: str) -> bool:
        """Whether one of the signals has a value anywhere."""
        return any(bool(np.isfinite(self.series(name)).any()) for name in names)

    def line(self, name: str, label: str, colour: Colour, scale: float = 1.0, **style: Any) -> Line:
        """Return a signal over time as a page shows it."""
        return self.curve(scale * self.series(name), label, colour, **style)

    def curve(self, values: Series, label: str, colour: Colour, **style: Any) -> Line:
        """Return values at every row from t = 0 on as a page shows them."""
        return Line(label, self.t_s, self._stretches(values), colour, **style)

    def bounds(self, name: str, scale: float = 1.0) -> Iterator[Line]:
        """Yield the limits of a signal, each over its time."""
        for label, values in bounds(self.run, name):
            yield self.curve(scale * values[self._kept], label, ALARM_COLOUR, dash="dot", width_px=1.2, in_title=False)

    def limits(self, key: str) -> Iterator[Line]:
        """Yield a limit of the scenario in both directions, if it has that."""
        if (limit := scenario_number(self.run, key)) is not None:
            for sign in (-1.0, 1.0):
                values = np.full(len(self.all_t_s), sign * limit)
                yield self.curve(values, "limit", ALARM_COLOUR, dash="dot", width_px=1.0, in_title=False)

    def torque_n_m_a(self, wheel: str) -> float | None:
        """Return the torque constant of a wheel's motor; None if it, or the motor's current, is not known."""
        known = self.has(f"wheel.{wheel}.current_a")
        return scenario_number(self.run, "firmware.torque_constant_n_m_a") if known else None
