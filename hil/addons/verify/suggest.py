"""The expectation that would have noticed a survivor: on a figure or a signal's extreme, halfway to where it went."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.addons.batch.job import Outcome
from hil.judge.measure import Series

_LEAST_PART, _SPREADS, _LEAST = 0.02, 3.0, 1e-9
"""What counts as moved: more than this part of its size, and than so many spreads over healthy runs."""
_CLEAR = 0.05
"""A margin that is enough: among claims that have it, the one that reads best is taken."""
_FIGURE, _SIGNAL = "figure", "signal"
_PREFERRED = ("error.", "estimator.", "pose.", "twist.", "wheel.", "battery.", "guard.", "robot.", "link.")
"""The order in which signals are preferred, after figures: what is wrong with the motion is read first."""
_DIGITS = 4

Extremes = list[float | None]
"""Of a signal: least and greatest value in the whole run, then in its second half; None where one is not finite."""
_NOT_OF_THE_RUN = ("loop.", "link.clock")
_EXTREMES = (np.min, np.max)


class Suggestion(NamedTuple):
    """An expectation for a member of the suite.

    Attributes:
        member: its name. kind ("figure" or "signal"), name, from_s, side ("below" or "above"), bound: the claim.
        healthy: the worst value of the healthy runs. mutated: that of the mutant.
        margin: how far the bound is from the healthy value, as a part of the size of what is claimed.
    """

    member: str
    kind: str
    name: str
    from_s: float
    side: str
    bound: float
    healthy: float
    mutated: float
    margin: float

    @property
    def toml(self) -> str:
        """The rows to paste into the scenario."""
        since = f"from_s = {self.from_s:g}\n" if self.from_s else ""
        return f'[[expect]]\n{self.kind} = "{self.name}"\n{since}{self.side} = {self.bound!r}\n'


def extremes(signals: Mapping[str, Series], duration_s: float) -> dict[str, Extremes]:
    """Return least and greatest value of each signal, in the whole run and in its second half."""
    late = signals["loop.t_s"] >= _late_from_s(duration_s)
    found = {}
    for name, values in signals.items():
        if not name.startswith(_NOT_OF_THE_RUN):
            windows = (values, values[late])
            found[name] = [_finite(extreme(part)) if len(part) else None for part in windows for extreme in _EXTREMES]
    return found


def suggestion(member: str, duration_s: float, healthy: Sequence[Outcome], mutated: Outcome) -> Suggestion | None:
    """Return the expectation that reads best of those that hold in all healthy runs and not with the mutant.

    None if nothing moved by more than healthy runs differ.
    """
    now, half_s = mutated.details["extremes"], _late_from_s(duration_s)
    found: list[Suggestion] = []
    for name, value in mutated.figures.items():
        before = [run.figures[name] for run in healthy]
        if isinstance(value, int | float) and all(isinstance(one, int | float) for one in before):
            claim = _Claim(member, _FIGURE, name, 0.0, max(map(abs, before)))
            found += [*claim.made(before, value, is_most=True), *claim.made(before, value, is_most=False)]
    for name in now.keys() & healthy[0].details["extremes"].keys():
        runs: list[Any] = [run.details["extremes"][name] for run in healthy]
        size = max((abs(one) for run in runs for one in run if one is not None), default=0.0)
        for place, value in enumerate(now[name]):
            before = [run[place] for run in runs]
            if value is not None and None not in before:
                claim = _Claim(member, _SIGNAL, name, 0.0 if place < 2 else half_s, size)
                found += claim.made(before, value, is_most=place % 2 == 1)
    return max(found, key=_rank, default=None)


class _Claim(NamedTuple):
    """What could be claimed of a figure or a signal; ``size`` is its greatest healthy magnitude."""

    member: str
    kind: str
    name: str
    from_s: float
    size: float

    def made(self, healthy: Sequence[float], mutated: float, *, is_most: bool) -> Iterator[Suggestion]:
        """Yield the claim that the value is not greater (``is_most``) or less, if the mutant moved it that way."""
        worst, spread = (max if is_most else min)(healthy), max(healthy) - min(healthy)
        gap = mutated - worst if is_most else worst - mutated
        if gap > max(_LEAST_PART * self.size, _SPREADS * spread, _LEAST):
            bound = _short(worst, mutated)
            margin = abs(bound - worst) / max(self.size, abs(mutated))
            side = "below" if is_most else "above"
            yield Suggestion(self.member, self.kind, self.name, self.from_s, side, bound, worst, mutated, margin)


def _rank(one: Suggestion) -> tuple[object, ...]:
    """Return the place of a claim: first a clear margin, then what reads best."""
    places = (place for place, prefix in enumerate(_PREFERRED) if one.name.startswith(prefix))
    preference = 1 if one.kind == _FIGURE else -next(places, len(_PREFERRED))
    return one.margin >= _CLEAR, preference, one.margin, one.name, one.side


def _short(healthy: float, mutated: float) -> float:
    """Return a number of few digits about halfway between two."""
    middle = 0.5 * (healthy + mutated)
    low, high = sorted((healthy, mutated))
    for digits in range(1, _DIGITS + 1):
        short = float(f"{middle:.{digits}g}")
        if low + 0.25 * (high - low) <= short <= high - 0.25 * (high - low):
            return short
    return middle


def _late_from_s(duration_s: float) -> float:
    """Return the time from which on the second half of a run is [s]."""
    return round(0.5 * duration_s, 3)


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
