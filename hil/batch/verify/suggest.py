"""The expectation that would have noticed a survivor: on a signal whose extremes moved, halfway to where they went."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hil.batch.verify.run import Extremes, late_from_s

_LEAST_PART, _SPREADS = 0.02, 3.0
"""What counts as moved: more than this part of the signal's size, and than so many spreads over healthy runs."""
_CLEAR = 0.05
"""A margin that is enough: among claims that have it, the one that reads best is taken."""
_PREFERRED = ("error.", "estimator.", "pose.", "twist.", "wheel.", "battery.", "guard.", "robot.", "link.")
"""The order in which signals are preferred: what is wrong with the motion is read first."""
_DIGITS = 4


class Suggestion(NamedTuple):
    """An expectation for a member of the suite.

    Attributes:
        member: its name. signal, from_s, side ("below" or "above"), bound: the claim.
        healthy: the worst value of the healthy runs. mutated: that of the mutant.
        margin: how far the bound is from the healthy value, as a part of the signal's size.
    """

    member: str
    signal: str
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
        return f'[[expect]]\nsignal = "{self.signal}"\n{since}{self.side} = {self.bound!r}\n'


def suggestion(
    member: str, duration_s: float, healthy: Sequence[Mapping[str, Extremes]], mutated: Mapping[str, Extremes]
) -> Suggestion | None:
    """Return the expectation with the greatest margin that holds in all healthy runs and not with the mutant.

    None if no signal moved by more than healthy runs differ.
    """
    found = [
        one
        for signal in mutated.keys() & healthy[0].keys()
        for one in _of_signal(member, signal, duration_s, [run[signal] for run in healthy], mutated[signal])
    ]
    return max(
        found,
        key=lambda one: (one.margin >= _CLEAR, _preference(one.signal), one.margin, one.signal, one.side),
        default=None,
    )


def _of_signal(
    member: str, signal: str, duration_s: float, healthy: Sequence[Extremes], mutated: Extremes
) -> list[Suggestion]:
    found = []
    known = [value for run in healthy for value in run if value is not None]
    size = max(map(abs, known), default=0.0)
    for place, from_s in enumerate((0.0, 0.0, late_from_s(duration_s), late_from_s(duration_s))):
        here: list[Any] = [run[place] for run in healthy]
        now = mutated[place]
        if now is None or None in here:
            continue
        is_most = place % 2 == 1
        worst, spread = (max(here) if is_most else min(here)), max(here) - min(here)
        gap = now - worst if is_most else worst - now
        if gap <= max(_LEAST_PART * size, _SPREADS * spread, 1e-9):
            continue
        bound = _short(worst, now)
        margin = abs(bound - worst) / max(size, abs(now))
        found.append(Suggestion(member, signal, from_s, "below" if is_most else "above", bound, worst, now, margin))
    return found


def _short(healthy: float, mutated: float) -> float:
    """Return a number of few digits about halfway between two."""
    middle = 0.5 * (healthy + mutated)
    low, high = sorted((healthy, mutated))
    for digits in range(1, _DIGITS + 1):
        short = float(f"{middle:.{digits}g}")
        if low + 0.25 * (high - low) <= short <= high - 0.25 * (high - low):
            return short
    return middle


def _preference(signal: str) -> int:
    return -next((place for place, prefix in enumerate(_PREFERRED) if signal.startswith(prefix)), len(_PREFERRED))
