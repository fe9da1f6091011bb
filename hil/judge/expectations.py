"""Expectations and allowances: what ``[[expect]]`` claims of signals, what ``[allow]`` permits, and the outcomes.

No side effects. A run adds sample by sample, and so reports a failure at once; a review checks a whole recording.
"""

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hil.core.errors import UnknownSignalError
from hil.core.options import options_of
from hil.judge.measure import Series
from hil.scenario.trial import AllowTable, ExpectTable, most


class Outcome(NamedTuple):
    """The outcome of an expectation.

    Attributes:
        passed: whether it held. False also without any sample; None when it is not judged: the run ended early, without
            a violation until then.
        violation_s: time of the first violation, or None. For a ``settles_to`` that did not settle, the last sample's.
        violation_value: the signal's value there (NaN for a gap), or None.
        worst_s: time of the worst violation, the value farthest from the claim, or None. None also for a ``settles_to``
            that did not settle: being outside at first is not a violation.
        worst_value: the signal's value there.
        violated_s: total time of violation [s]: each violation lasts from its first sample to the next good one, or to
            the last sample. None where ``worst_s`` is None.
        settled_s: of ``settles_to``: the first time from which it stayed within the tolerance.
        margin: how far inside the claim the run was, as ``margin`` defines it; negative where it is broken, None when
            it is not judged.
        text: a sentence for the user with all of this.
    """

    passed: bool | None
    text: str
    violation_s: float | None = None
    violation_value: float | None = None
    worst_s: float | None = None
    worst_value: float | None = None
    violated_s: float | None = None
    settled_s: float | None = None
    margin: float | None = None


_WITHOUT_VALUE = -1.0
"""The margin of a gap, and of no sample at all."""
_LARGEST = 1e6


def margin(expect: ExpectTable, lowest: float, highest: float) -> float:
    """Return how far values from ``lowest`` to ``highest`` are inside a claim; negative: how far outside.

    It is a share of what the claim permits, so that claims about different signals compare: 1 stands for half the width
    of the permitted interval; with a single limit for its size, or for 1 if the limit is 0. It is continuous in the
    values, but for values that must be met exactly: 1 where they are. It is never 0.
    """
    above, below = expect.within or (expect.above, expect.below)
    centre = expect.equals if expect.settles_to is None else expect.settles_to
    is_open = expect.within is None and centre is None
    if centre is not None:
        scale = expect.tolerance or 0.0
        room = scale - max(abs(lowest - centre), abs(highest - centre))
    else:
        limits = [limit for limit in (above, below) if limit is not None]
        scale = (limits[-1] - limits[0]) / 2.0 if len(limits) == 2 else abs(limits[0]) or 1.0
        room = min(math.inf if below is None else below - highest, math.inf if above is None else lowest - above)
    if not scale:
        scale = abs(limits[0] if centre is None else centre) or 1.0
        room = room or scale
    holds = room > 0.0 or (room == 0.0 and not is_open)
    return math.copysign(min(max(abs(room) / scale, sys.float_info.min), _LARGEST), 1.0 if holds else -1.0)


class _Claim(NamedTuple):
    """A claim about a value: ``holds`` is False for NaN; ``distance`` is how far a violating value is from it."""

    holds: Callable[[float], bool]
    distance: Callable[[float], float]
    text: str


def _claim(expect: ExpectTable) -> _Claim:
    if expect.within is not None:
        low, high = expect.within
        text = f"within {low:g} to {high:g}"
        return _Claim(lambda value: low <= value <= high, lambda value: max(low - value, value - high), text)
    target = expect.equals if expect.settles_to is None else expect.settles_to
    if target is not None:
        centre, tolerance = target, expect.tolerance or 0.0
        word = "equals" if expect.settles_to is None else "settles to"
        text = f"{word} {centre:g}" + (f" ± {tolerance:g}" if tolerance else "")
        return _Claim(lambda value: abs(value - centre) <= tolerance, lambda value: abs(value - centre), text)
    above, below = expect.above, expect.below
    if below is None:
        assert above is not None, "a scenario's expectation has one claim"
        return _Claim(lambda value: value > above, lambda value: above - value, f"above {above:g}")
    if above is None:
        return _Claim(lambda value: value < below, lambda value: value - below, f"below {below:g}")
    return _Claim(
        lambda value: above < value < below,
        lambda value: max(above - value, value - below),
        f"above {above:g} and below {below:g}",
    )


class Watch:
    """Checks one expectation sample by sample.

    It fails when there are no samples in its time, or when one of them is NaN: neither shows that the claim holds.
    """

    def __init__(self, expect: ExpectTable) -> None:
        self.expect = expect
        self._claim = _claim(expect)
        self._settles = expect.settles_to is not None
        self._samples = 0
        self._held = 0  # number of newest samples in a row that hold
        self._held_since_s = 0.0
        self._first: tuple[float, float] | None = None  # violations, each with time and value
        self._worst = self._last = (math.nan, math.nan)
        self._worst_distance = -math.inf
        self._violations = 0
        self._since_s = 0.0  # start of the current violation
        self._violated_s = 0.0  # total of the violations that have ended
        self._lowest, self._highest = math.inf, -math.inf  # NaN is neither
        self._gaps = 0
        self._begin_s = 0.0
        self._newest = (math.nan, math.nan)

    def add(self, t_s: float, value: float) -> bool:
        """Add a sample in the expectation's time; return whether the claim has just failed because of it."""
        self._samples += 1
        self._newest = (t_s, value)
        if self._samples == 1:
            self._begin_s = t_s
        if value < self._lowest:
            self._lowest = value
        if value > self._highest:
            self._highest = value
        if self._claim.holds(value):
            if not self._held:
                self._held_since_s = t_s
                if self._violations:
                    self._violated_s += t_s - self._since_s
            self._held += 1
            return False
        if self._held or not self._violations:
            self._since_s = t_s
        self._held = 0
        self._violations += 1
        self._last = (t_s, value)
        self._gaps += value != value
        distance = self._claim.distance(value)
        if self._first is None or distance > self._worst_distance:
            self._worst, self._worst_distance = self._last, -math.inf if math.isnan(distance) else distance
        is_first = self._first is None
        self._first = self._first or self._last
        return is_first and not self._settles

    def outcome(self, cut_s: float | None = None) -> Outcome:
        """Return the outcome for the samples so far.

        ``cut_s`` is the time at which the run ended early; None for a complete run.
        """
        outcome = self._outcome(cut_s)
        return outcome if outcome.passed is None else outcome._replace(margin=self._margin())

    def _margin(self) -> float:
        """Return the margin of the samples so far.

        That of a ``settles_to`` is the last sample's, or, if less, the share of the time that was left when it settled.
        """
        if not self._samples:
            return _WITHOUT_VALUE
        if self._settles:
            t_s, value = self._newest
            found = _WITHOUT_VALUE if math.isnan(value) else margin(self.expect, value, value)
            if self._held == self._samples or not self._held:
                return found
            return min(found, (t_s - self._held_since_s) / (t_s - self._begin_s) or sys.float_info.min)
        if self._gaps == self._samples:
            return _WITHOUT_VALUE
        found = margin(self.expect, self._lowest, self._highest)
        return min(found, _WITHOUT_VALUE) if self._gaps else found

    def _outcome(self, cut_s: float | None) -> Outcome:
        until = "to the end" if math.isinf(self.expect.to_s) else f"to {self.expect.to_s:g} s"
        claim = f"{self.expect.signal} {self._claim.text} from {self.expect.from_s:g} s {until}"
        if self._first is not None and not self._settles:
            violated_s = self._violated_s + (0.0 if self._held else self._last[0] - self._since_s)
            text = f"{claim}: failed, {_found(self._first)}"
            if self._violations > 1:
                text += f"; worst {_found(self._worst)}; {violated_s:.4g} s in all"
            return Outcome(False, text, *self._first, *self._worst, violated_s)
        if cut_s is not None and self.expect.to_s > cut_s:
            return Outcome(None, f"{claim}: not judged, the run ended at t = {cut_s:.6g} s{self._until()}")
        if not self._samples:
            return Outcome(False, f"{claim}: failed, the run has no samples there")
        if not self._held:
            return Outcome(False, f"{claim}: failed at the end, {_found(self._last)}", *self._last)
        if self._settles:
            text = f"{claim}: settled at t = {self._held_since_s:.6g} s, over {self._held} samples"
            return Outcome(True, text, settled_s=self._held_since_s)
        return Outcome(True, f"{claim}: held over {self._samples} samples")

    def _until(self) -> str:
        """Return a phrase on how the claim stood when the run ended early."""
        if not self._samples:
            return ", before there was a sample of it"
        if not self._held:
            return ", and it had not settled until then"
        verb = f"settled since t = {self._held_since_s:.6g} s" if self._settles else "held"
        return f"; {verb} over {self._held} samples until then"


def _found(sample: tuple[float, float]) -> str:
    t_s, value = sample
    return f"{'no value' if math.isnan(value) else f'{value:.6g}'} at t = {t_s:.6g} s"


def check_expectation(expect: ExpectTable, signals: Mapping[str, Series], cut_s: float | None = None) -> Outcome:
    """Check one expectation against the signals of a run, ``loop.t_s`` among them.

    ``cut_s`` is the time at which the run ended early, or None. Raises UnknownSignalError, which suggests similar
    names, for a signal that is not there.
    """
    if expect.signal not in signals:
        raise UnknownSignalError(expect.signal, signals)
    t_s, values = signals["loop.t_s"], signals[expect.signal]
    inside = (t_s >= expect.from_s) & (t_s <= expect.to_s)
    watch = Watch(expect)
    for at_s, value in zip(t_s[inside].tolist(), values[inside].tolist(), strict=True):
        watch.add(at_s, value)
    return watch.outcome(cut_s)


def outcome_figures(expect: ExpectTable, outcome: Outcome) -> dict[str, Any]:
    """Return an expectation's outcome, in words and numbers, as a run's JSON has it."""
    fields = outcome._asdict()
    text = fields.pop("text")
    return {"signal": expect.signal, **fields, "text": text}


def outcomes_of(
    rows: Sequence[ExpectTable], signals: Mapping[str, Series], cut_s: float | None = None
) -> list[dict[str, Any]]:
    """Return the outcome of each expectation as a run's JSON has it, checked against the signals of a run."""
    return [outcome_figures(row, check_expectation(row, signals, cut_s)) for row in rows]


class TickCount(NamedTuple):
    """How many ticks of a kind a run had, and how many of them no fault of the scenario explains."""

    all: int
    unexplained: int


def allow_figures(allow: AllowTable, counts: Mapping[str, TickCount], ticks: int) -> list[dict[str, Any]]:
    """Return the outcome of each limit of ``[allow]``, in its order, in words and numbers, as a run's JSON has it.

    ``counts`` has an entry for each key of the table; ``ticks`` is the number of ticks of the run.
    """
    figures = []
    for name, option in options_of(AllowTable).items():
        limit, count = getattr(allow, name), counts[name]
        allowed = most(limit, ticks)
        passed = count.unexplained <= allowed
        share = f"{allowed}, {limit}" if isinstance(limit, str) else f"{allowed}"
        text = (
            f"{name}: {count.unexplained} of {ticks} {option.meaning}; no fault of the scenario explains them, and "
            f"allow.{name} permits {share}: {'as allowed' if passed else 'find the cause, or raise it'}"
        )
        found = 1.0 - count.unexplained / (allowed + 0.5)
        figures.append(
            {"name": name, "passed": passed, **count._asdict(), "limit": limit, "margin": found, "text": text}
        )
    return figures
