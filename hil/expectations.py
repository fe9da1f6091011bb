"""Expectations: what a row of ``[[expect]]`` claims of a signal, and what became of it.

Pure: numbers in, plain numbers and sentences out. A run asks one sample after the other, in its ticks, so that it can
tell of an expectation when it is decided; a review asks of a whole recording.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

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
        passed: whether it held; False also when there was nothing to hold for.
        at_s: time of the first violation, or None. Of one that did not settle: of the last sample, which was outside.
        value: the signal's value there (NaN for a gap), or None.
        settled_s: of ``settles_to``: the first time from which it stayed within the tolerance.
        sentence: the whole story for a person.
    """

    passed: bool
    at_s: float | None
    value: float | None
    settled_s: float | None
    sentence: str


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
        self._place = (0.0, 0.0)  # time and value of the sample that tells of a failure

    def take(self, t_s: float, value: float) -> bool:
        """Take a sample of the expectation's time; return whether it decides that the claim failed."""
        self._samples += 1
        if self._holds(value):
            if not self._held:
                self._held_since_s = t_s
            self._held += 1
            return False
        self._held = 0
        self._place = (t_s, value)
        return not self._settles

    def outcome(self) -> Outcome:
        """Return what became of it with the samples so far. After one that decides, no more may be taken."""
        expect, samples = self.expect, self._samples
        claim = f"{expect.signal} {_claim(expect)} {_span(expect)}"
        if not samples:
            return Outcome(False, None, None, None, f"{claim}: failed, the run has no samples there")
        if not self._held:
            at_s, value = self._place
            found = "no value" if math.isnan(value) else f"{value:.6g}"
            where = " at the end" if self._settles else ""
            return Outcome(False, at_s, value, None, f"{claim}: failed{where}, {found} at t = {at_s:.6g} s")
        if self._settles:
            settled_s, count = self._held_since_s, self._held
            return Outcome(
                True, None, None, settled_s, f"{claim}: settled at t = {settled_s:.6g} s, over {count} samples"
            )
        return Outcome(True, None, None, None, f"{claim}: held over {samples} samples")


def check_expectation(expect: Expect, signals: Mapping[str, Series]) -> Outcome:
    """Check one expectation against the signals of a run, ``loop.t_s`` among them.

    Raises KeyError for a signal that is not there.
    """
    t_s, values = signals["loop.t_s"], signals[expect.signal]
    inside = (t_s >= expect.from_s) & (t_s <= expect.to_s)
    watch = Watch(expect)
    for at_s, value in zip(t_s[inside].tolist(), values[inside].tolist(), strict=True):
        if watch.take(at_s, value):
            break
    return watch.outcome()


def outcome_figures(expect: Expect, outcome: Outcome) -> dict[str, Any]:
    """Return an expectation with how it went, in words and numbers, as the figures of a run have it."""
    return {
        "signal": expect.signal,
        "passed": outcome.passed,
        "violation_s": outcome.at_s,
        "violation_value": outcome.value,
        "settled_s": outcome.settled_s,
        "text": outcome.sentence,
    }


def outcomes_of(rows: Sequence[Expect], signals: Mapping[str, Series]) -> list[dict[str, Any]]:
    """Return the figures of each expectation, checked against the signals of a run."""
    return [outcome_figures(row, check_expectation(row, signals)) for row in rows]


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
