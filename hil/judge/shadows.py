"""How the set points of other laws, such as shadows, differ from the command, computed block by block."""

import math
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from hil.core.signals import unit_of
from hil.judge.measure import Series
from hil.laws.shadows import QUANTITY

_PREFIX = "shadow."


class CommandDifference(NamedTuple):
    """Set points of another law minus the recorded ones, of one wheel, in the unit of the signal.

    ``max`` is the largest absolute difference, at ``max_s`` of the run; ``recorded_rms`` is the size of the commands.
    """

    rms: float
    max: float
    max_s: float
    recorded_rms: float


class _Sums:
    """The sums from which one difference follows."""

    def __init__(self) -> None:
        self._count = 0
        self._squares = self._recorded_squares = 0.0
        self._max, self._max_s = -1.0, math.nan

    def add(self, t_s: Series, recorded: Series, other: Series) -> None:
        """Add times [s] and set points, each of shape (n,); ticks in which one of them has no value are left out."""
        apart = other - recorded
        known = np.isfinite(apart)
        if not known.all():
            t_s, recorded, apart = t_s[known], recorded[known], apart[known]
        if not len(apart):
            return
        apart = np.abs(apart)
        most = int(np.argmax(apart))
        if apart[most] > self._max:
            self._max, self._max_s = float(apart[most]), float(t_s[most])
        self._count += len(apart)
        self._squares += float(apart @ apart)
        self._recorded_squares += float(recorded @ recorded)

    def result(self) -> CommandDifference | None:
        """Return the difference, None without a tick in which both have a value."""
        if not self._count:
            return None
        rms, recorded_rms = (math.sqrt(one / self._count) for one in (self._squares, self._recorded_squares))
        return CommandDifference(rms, self._max, self._max_s, recorded_rms)


def command_difference(t_s: Series, recorded: Series, other: Series) -> CommandDifference:
    """Compare set points at the times ``t_s`` [s], all of shape (n,), with at least one tick where both have values."""
    sums = _Sums()
    sums.add(t_s, recorded, other)
    found = sums.result()
    assert found is not None, "there is a tick where both have values"
    return found


def shadow_signals(names: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return, of the names of a recording's signals, those of its shadows: by shadow, then by the command's signal."""
    found: dict[str, dict[str, str]] = {}
    for name in names:
        if name.startswith(_PREFIX) and name.endswith(tuple(QUANTITY.values())):
            shadow, _, command = name.removeprefix(_PREFIX).partition(".")
            found.setdefault(shadow, {})[command] = name
    return found


class ShadowDifferences:
    """The differences of a run's shadows to its command, from its rows in bounded memory.

    ``names`` are those of the run's signals; ``signals`` those that ``add`` needs, none for a run without shadows.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._of = shadow_signals(names)
        self._sums = {shadow: {command: _Sums() for command in pairs} for shadow, pairs in self._of.items()}
        needed = {name for pairs in self._of.values() for pair in pairs.items() for name in pair}
        self.signals = sorted(needed | {"loop.t_s"} if needed else needed)

    def add(self, signals: Mapping[str, Series]) -> None:
        """Add the next rows: each signal by name, of shape (n,), NaN for a gap."""
        for shadow, pairs in self._of.items():
            for command, name in pairs.items():
                self._sums[shadow][command].add(signals["loop.t_s"], signals[command], signals[name])

    def results(self) -> dict[str, dict[str, CommandDifference]]:
        """Return the differences by shadow and by the command's signal.

        A shadow that never had a value beside a command has no entry.
        """
        found: dict[str, dict[str, CommandDifference]] = {}
        for shadow, sums in self._sums.items():
            one = {command: result for command, each in sums.items() if (result := each.result()) is not None}
            if one:
                found[shadow] = one
        return found


def shadow_differences(signals: Mapping[str, Series]) -> dict[str, dict[str, CommandDifference]]:
    """Return how each shadow's set points differ from the command, by shadow and by the command's signal.

    ``signals`` are those of a whole run with the shadows' among them. Ticks without a command or without a value of the
    shadow are left out; a shadow that never had a value beside a command has no entry.
    """
    differences = ShadowDifferences(signals)
    if differences.signals:
        differences.add(signals)
    return differences.results()


def with_differences(
    shadows: Iterable[Mapping[str, Any]], differences: Mapping[str, Mapping[str, CommandDifference]]
) -> list[dict[str, Any]]:
    """Return the rows of a run's shadows with the ``difference`` of each: its numbers by the command's signal."""
    return [
        {**row, "difference": {name: one._asdict() for name, one in differences.get(row["name"], {}).items()}}
        for row in shadows
    ]


def difference_words(difference: Mapping[str, Mapping[str, float]]) -> str:
    """Return the difference of a shadow to the command in words: rms and largest of each wheel, and when."""
    unit = unit_of(next(iter(difference)))
    wheels = [name.split(".")[1].upper() for name in difference]
    rows = list(difference.values())
    rms = ", ".join(f"{wheel} {one['rms']:.3g}" for wheel, one in zip(wheels, rows, strict=True))
    most = ", ".join(
        f"{wheel} {one['max']:.3g} at {one['max_s']:.6g} s" for wheel, one in zip(wheels, rows, strict=True)
    )
    size = max(one["recorded_rms"] for one in rows)
    return f"apart from the command by {rms} {unit} rms (the command: up to {size:.3g}); at most {most}"
