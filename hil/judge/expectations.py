"""Expectations: what a row of ``[[expect]]`` claims of a signal, and what became of it.

Pure: numbers in, plain numbers and sentences out. A run asks one sample after the other, in its ticks, so that it can
tell of an expectation when it is decided; a review asks of a whole recording.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from hil.core.errors import UnknownSignalError

Series = npt.NDArray[np.float64]


class Expect(Protocol):
    """A row of ``[[expect]]``: one claim of a signal from one time to another, both included."""

    @property
    def signal(self) -> str: ...
    @property
    def from_s(self) -> float: ...
    @property
    def to_s(self) -> float: ...
    @property
    def below(self) -> float | None: ...
    @property
    def above(self) -> float | None: ...
    @property
    def within(self) -> tuple[float, float] | None: ...
    @property
    def equals(self) -> float | None: ...
    @property
    def settles_to(self) -> float | None: ...
    @property
    def tolerance(self) -> float | None: ...


class Outcome(NamedTuple):
    """What became of an expectation.

    Attributes:
        passed: whether it held. False also when there was nothing to hold for; None when it is not judged, because the
            run ended before its time and nothing until then was a violation.
        at_s: time of the first violation, or None. Of one that did not settle: of the last sample, which was outside.
        value: the signal's value there (NaN for a gap), or None.
        worst_s: time of the worst violation, the value farthest from what was claimed, or None. One that did not
            settle has none, for to be outside at first is no violation.
        worst_value: the signal's value there.
        violated_s: how long it was violated in all [s]: each time from the first sample that violates it to the next
            one that does not, or to the last one of all. None where ``worst_s`` is.
        settled_s: of ``settles_to``: the first time from which it stayed within the tolerance.
        sentence: the whole story for a person.
    """

    passed: bool | None
    at_s: float | None
    value: float | None
    worst_s: float | None
    worst_value: float | None
    violated_s: float | None
    settled_s: float | None
    sentence: str


class _Violations:
    """The violations of a claim so far: the first, the worst and the last, and how long they were."""

    def __init__(self, t_s: float, value: float, distance: float) -> None:
        self.first = self.worst = self.last = (t_s, value)
        self.samples = 1
        self._farthest = -math.inf if math.isnan(distance) else distance
        self._since_s = t_s
        self._over_s = 0.0
        self._goes_on = True

    def add(self, t_s: float, value: float, distance: float) -> None:
        """Take a further sample that violates the claim."""
        if not self._goes_on:
            self._since_s, self._goes_on = t_s, True
        self.last = (t_s, value)
        self.samples += 1
        if distance > self._farthest:
            self.worst, self._farthest = self.last, distance

    def pause(self, t_s: float) -> None:
        """Take the first sample that holds after one that does not."""
        self._over_s += t_s - self._since_s
        self._goes_on = False

    def in_all_s(self) -> float:
        """Return how long they were."""
        return self._over_s + (self.last[0] - self._since_s if self._goes_on else 0.0)


class Watch:
    """One expectation that is checked sample by sample.

    It fails when there are no samples in its time, or when one that counts is NaN: nothing was shown then.
    """

    def __init__(self, expect: Expect) -> None:
        self.expect = expect
        self._holds = _predicate(expect)
        self._settles = expect.settles_to is not None
        self._samples = 0
        self._held = 0  # the samples of the end that held without a break
        self._held_since_s = 0.0
        self._violations: _Violations | None = None

    def take(self, t_s: float, value: float) -> bool:
        """Take a sample of the expectation's time; return whether it is the one by which the claim has failed."""
        self._samples += 1
        violations = self._violations
        if self._holds(value):
            if not self._held:
                self._held_since_s = t_s
                if violations is not None:
                    violations.pause(t_s)
            self._held += 1
            return False
        self._held = 0
        if violations is None:
            self._violations = _Violations(t_s, value, _distance(self.expect, value))
            return not self._settles
        violations.add(t_s, value, _distance(self.expect, value))
        return False

    def outcome(self, cut_s: float | None = None) -> Outcome:
        """Return what became of it with the samples so far.

        ``cut_s`` is the time at which the run ended before it should have; None for one that came to its end.
        """
        claim = f"{self.expect.signal} {_claim(self.expect)} {_span(self.expect)}"
        violations = self._violations
        if violations is not None and not self._settles:
            return _failed(claim, violations)
        if cut_s is not None and self.expect.to_s > cut_s:
            return _without_violation(None, f"{claim}: not judged, {self._until(cut_s)}")
        if not self._samples:
            return _without_violation(False, f"{claim}: failed, the run has no samples there")
        if not self._held:
            assert violations is not None, "a sample that did not hold"
            at_s, value = violations.last
            sentence = f"{claim}: failed at the end, {_found(value)} at t = {at_s:.6g} s"
            return _without_violation(False, sentence)._replace(at_s=at_s, value=value)
        if self._settles:
            settled_s, count = self._held_since_s, self._held
            sentence = f"{claim}: settled at t = {settled_s:.6g} s, over {count} samples"
            return _without_violation(True, sentence)._replace(settled_s=settled_s)
        return _without_violation(True, f"{claim}: held over {self._samples} samples")

    def _until(self, cut_s: float) -> str:
        """Return how it was when the run ended before its time."""
        ended = f"the run ended at t = {cut_s:.6g} s"
        if not self._samples:
            return f"{ended}, before there was a sample of it"
        if not self._held:
            return f"{ended}, and it had not settled until then"
        verb = f"settled since t = {self._held_since_s:.6g} s" if self._settles else "held"
        return f"{ended}; {verb} over {self._held} samples until then"


def _without_violation(passed: bool | None, sentence: str) -> Outcome:
    return Outcome(passed, None, None, None, None, None, None, sentence)


def _failed(claim: str, violations: _Violations) -> Outcome:
    at_s, value = violations.first
    worst_s, worst_value = violations.worst
    violated_s = violations.in_all_s()
    sentence = f"{claim}: failed, {_found(value)} at t = {at_s:.6g} s"
    if violations.samples > 1:
        sentence += f"; worst {_found(worst_value)} at t = {worst_s:.6g} s; {violated_s:.4g} s in all"
    return Outcome(False, at_s, value, worst_s, worst_value, violated_s, None, sentence)


def _found(value: float) -> str:
    return "no value" if math.isnan(value) else f"{value:.6g}"


def check_expectation(expect: Expect, signals: Mapping[str, Series], cut_s: float | None = None) -> Outcome:
    """Check one expectation against the signals of a run, ``loop.t_s`` among them.

    ``cut_s`` is the time at which the run ended before it should have, or None. Raises UnknownSignalError, with near
    names, for a signal that is not there.
    """
    if expect.signal not in signals:
        raise UnknownSignalError(expect.signal, signals)
    t_s, values = signals["loop.t_s"], signals[expect.signal]
    inside = (t_s >= expect.from_s) & (t_s <= expect.to_s)
    watch = Watch(expect)
    for at_s, value in zip(t_s[inside].tolist(), values[inside].tolist(), strict=True):
        watch.take(at_s, value)
    return watch.outcome(cut_s)


def outcome_figures(expect: Expect, outcome: Outcome) -> dict[str, Any]:
    """Return an expectation with how it went, in words and numbers, as the figures of a run have it."""
    return {
        "signal": expect.signal,
        "passed": outcome.passed,
        "violation_s": outcome.at_s,
        "violation_value": outcome.value,
        "worst_s": outcome.worst_s,
        "worst_value": outcome.worst_value,
        "violated_s": outcome.violated_s,
        "settled_s": outcome.settled_s,
        "text": outcome.sentence,
    }


def outcomes_of(
    rows: Sequence[Expect], signals: Mapping[str, Series], cut_s: float | None = None
) -> list[dict[str, Any]]:
    """Return the figures of each expectation, checked against the signals of a run; see ``check_expectation``."""
    return [outcome_figures(row, check_expectation(row, signals, cut_s)) for row in rows]


def _predicate(expect: Expect) -> Callable[[float], bool]:
    """Return what tells whether the claim holds of a value. A NaN compares false, and no claim holds of it."""
    above, below = expect.above, expect.below
    if expect.within is not None:
        low, high = expect.within
        return lambda value: low <= value <= high
    target = expect.equals if expect.settles_to is None else expect.settles_to
    if target is not None:
        centre, tolerance = target, expect.tolerance or 0.0
        return lambda value: abs(value - centre) <= tolerance
    if below is None:
        assert above is not None, "a scenario's expectation has one claim"
        return lambda value: value > above
    return (lambda value: value < below) if above is None else (lambda value: above < value < below)


def _distance(expect: Expect, value: float) -> float:
    """Return how far a value that violates the claim is from one that holds; NaN for one that is no number."""
    if expect.within is not None:
        low, high = expect.within
        return max(low - value, value - high)
    target = expect.equals if expect.settles_to is None else expect.settles_to
    if target is not None:
        return abs(value - target)
    above, below = expect.above, expect.below
    if above is None or (below is not None and value >= below):
        assert below is not None, "a scenario's expectation has one claim"
        return value - below
    return above - value


def _claim(expect: Expect) -> str:
    tolerance = f" ± {expect.tolerance:g}" if expect.tolerance else ""
    words = []
    if expect.above is not None:
        words.append(f"above {expect.above:g}")
    if expect.below is not None:
        words.append(f"below {expect.below:g}")
    if expect.within is not None:
        words.append(f"within {expect.within[0]:g} to {expect.within[1]:g}")
    if expect.equals is not None:
        words.append(f"equals {expect.equals:g}{tolerance}")
    if expect.settles_to is not None:
        words.append(f"settles to {expect.settles_to:g}{tolerance}")
    return " and ".join(words)


def _span(expect: Expect) -> str:
    stop = "to the end" if math.isinf(expect.to_s) else f"to {expect.to_s:g} s"
    return f"from {expect.from_s:g} s {stop}"
