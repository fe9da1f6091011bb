"""Expectations: what a row of ``[[expect]]`` claims of a signal, and what became of it.

Pure: NumPy arrays in, plain numbers and sentences out.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


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


def check_expectation(expect: Expect, signals: Mapping[str, Series]) -> Outcome:
    """Check one expectation against the signals of a run, ``loop.t_s`` among them.

    It fails when there are no samples in its time, or when one that counts is NaN: nothing was shown then. Raises
    KeyError for a signal that is not there.
    """
    t_s, values = signals["loop.t_s"], signals[expect.signal]
    inside = (t_s >= expect.from_s) & (t_s <= expect.to_s)
    t_s, values = t_s[inside], values[inside]
    claim = f"{expect.signal} {_claim(expect)} {_span(expect)}"
    if not len(values):
        return Outcome(False, None, None, None, f"{claim}: failed, the run has no samples there")
    holds = _holds(expect, values)
    if expect.settles_to is not None:
        return _settling(claim, holds, t_s, values)
    if holds.all():
        return Outcome(True, None, None, None, f"{claim}: held over {len(values)} samples")
    return _failed(claim, "", t_s, values, int(np.argmin(holds)))


def outcomes_of(rows: Sequence[Expect], signals: Mapping[str, Series]) -> list[dict[str, Any]]:
    """Return each expectation with how it went, in words and numbers, as the figures of a run have it."""
    outcomes = []
    for row in rows:
        outcome = check_expectation(row, signals)
        outcomes.append(
            {
                "signal": row.signal,
                "passed": outcome.passed,
                "violation_s": outcome.at_s,
                "violation_value": outcome.value,
                "settled_s": outcome.settled_s,
                "text": outcome.sentence,
            }
        )
    return outcomes


def _settling(claim: str, holds: Mask, t_s: Series, values: Series) -> Outcome:
    outside = np.flatnonzero(~holds)
    first = int(outside[-1]) + 1 if len(outside) else 0
    if first == len(values):
        return _failed(claim, " at the end", t_s, values, len(values) - 1)
    settled_s = float(t_s[first])
    samples = len(values) - first
    return Outcome(True, None, None, settled_s, f"{claim}: settled at t = {settled_s:.6g} s, over {samples} samples")


def _failed(claim: str, where: str, t_s: Series, values: Series, place: int) -> Outcome:
    at_s, value = float(t_s[place]), float(values[place])
    found = "no value" if np.isnan(value) else f"{value:.6g}"
    return Outcome(False, at_s, value, None, f"{claim}: failed{where}, {found} at t = {at_s:.6g} s")


def _holds(expect: Expect, values: Series) -> Mask:
    """Tell for each value whether the claim holds of it. A NaN compares false, and no claim holds of it."""
    holds: Mask = ~np.isnan(values)
    if expect.below is not None:
        holds &= values < expect.below
    if expect.above is not None:
        holds &= values > expect.above
    if expect.within is not None:
        holds &= (values >= expect.within[0]) & (values <= expect.within[1])
    for target in (expect.equals, expect.settles_to):
        if target is not None:
            holds &= np.abs(values - target) <= (expect.tolerance or 0.0)
    return holds


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
    stop = "to the end" if np.isinf(expect.to_s) else f"to {expect.to_s:g} s"
    return f"from {expect.from_s:g} s {stop}"
