"""Two runs over one time, and how a signal of the second differs from that of the first."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.errors import BadInputError, UnknownSignalError
from hil.core.signals import WHEEL_SPEEDS, unit_of
from hil.faults.kind import REST_RAD_S
from hil.review.contents import Series
from hil.review.reader import RecordedRun

COMPARED = ("error.planar_m", "error.x_m", "error.y_m", "error.heading_rad")
"""The signals that are compared where none is named."""


class Asked(NamedTuple):
    """A signal to compare, and how far it may differ, in its unit; None if that is not judged."""

    name: str
    tolerance: float | None = None


class SignalDifference(NamedTuple):
    """A signal of the second run minus that of the first, at the times of the first.

    Attributes:
        name: the signal's.
        unit: its unit.
        t_s: the times [s] at which both runs have a value, of shape (n,).
        values: the differences there; of headings the shorter way around.
        tolerance: as it was asked for.
    """

    name: str
    unit: str
    t_s: Series
    values: Series
    tolerance: float | None

    def figures(self) -> dict[str, Any]:
        """Return what ``hil review --json`` says: rms, the largest difference, and when it was out of tolerance.

        All are None without a time at which both runs have a value; the last three also without a tolerance.
        """
        apart = np.abs(self.values)
        known = len(apart) > 0
        most = int(np.argmax(apart)) if known else 0
        out = apart > self.tolerance if known and self.tolerance is not None else None
        return {
            "name": self.name,
            "unit": self.unit,
            "samples": len(apart),
            "rms": float(np.sqrt(np.mean(apart**2))) if known else None,
            "max": float(apart[most]) if known else None,
            "max_s": float(self.t_s[most]) if known else None,
            "tolerance": self.tolerance,
            "within": None if out is None else not out.any(),
            "first_outside_s": float(self.t_s[np.argmax(out)]) if out is not None and out.any() else None,
            "outside_percent": None if out is None else 100.0 * float(out.mean()),
        }


def asked_for(texts: Sequence[str]) -> list[Asked]:
    """Return the signals that a user asks for as NAME or NAME=TOLERANCE. Raises BadInputError."""
    found = []
    for text in texts:
        name, equals, tolerance = text.partition("=")
        try:
            size = float(tolerance) if equals else None
        except ValueError:
            size = np.nan
        if not name or (size is not None and not 0.0 <= size < np.inf):
            raise BadInputError(
                f"--difference {text}: expected the name of a signal, or with a tolerance of at least 0 in its unit, "
                "as in error.planar_m=0.005"
            )
        found.append(Asked(name, size))
    return found


def shift_s(first: RecordedRun, second: RecordedRun, by: str) -> float:
    """Return what to add to the times of the second run [s], so that both are aligned.

    ``by`` is "t" for the scenario's time; "motion" for the instant at which the first wheel turns; or a part of the
    text of an event, of which the first counts. Raises BadInputError when a run has no such instant.
    """
    if by == "t":
        return 0.0
    return _instant_s(first, by) - _instant_s(second, by)


def _instant_s(run: RecordedRun, by: str) -> float:
    if by != "motion":
        for event in run.events:
            if by in event.text:
                return event.t_s
        texts = "; ".join(dict.fromkeys(event.text for event in run.events)) or "it has none"
        raise BadInputError(f"--align {by!r}: {run.path} has no event with this text; its events: {texts}")
    speeds = [run.signals[name] for name in WHEEL_SPEEDS if name in run.signals]
    turning = np.any([np.abs(speed) > REST_RAD_S for speed in speeds], axis=0) if speeds else np.empty(0)
    if not np.any(turning):
        raise BadInputError(
            f"--align motion: in {run.path} no wheel turns faster than {REST_RAD_S:g} rad/s; align by t, or an event"
        )
    return float(run.signals["loop.t_s"][np.argmax(turning)])


def signal_differences(
    first: RecordedRun, second: RecordedRun, asked: Sequence[Asked], shift: float = 0.0
) -> list[SignalDifference]:
    """Return how signals of the second run differ from those of the first, at the first's times.

    ``shift`` [s] is added to the times of the second run, whose values are interpolated; where it has none, or lacks
    rows, there is no difference. Raises UnknownSignalError for a signal that a run lacks.
    """
    for one in asked:
        for run in (first, second):
            if one.name not in run.signals:
                raise UnknownSignalError(one.name, run.held or run.signals)
    return [_difference(first, second, one, shift) for one in asked]


def _difference(first: RecordedRun, second: RecordedRun, asked: Asked, shift: float) -> SignalDifference:
    t_s, other_s = first.signals["loop.t_s"], second.signals["loop.t_s"] + shift
    values, others = first.signals[asked.name], second.signals[asked.name]
    unit = unit_of(asked.name)
    is_angle = unit == "rad"
    if is_angle:  # between two samples the shorter way around
        known = np.isfinite(others)
        others = others.copy()
        others[known] = np.unwrap(others[known])
    beside = np.interp(t_s, other_s, others, left=np.nan, right=np.nan) if len(other_s) else np.full(len(t_s), np.nan)
    if len(other_s) > 1:
        gap_s = 1.5 * float(np.median(np.diff(other_s)))
        after = np.clip(np.searchsorted(other_s, t_s), 1, len(other_s) - 1)
        beside[(other_s[after] - other_s[after - 1] > gap_s) & ~np.isin(t_s, other_s)] = np.nan
    apart = beside - values
    if is_angle:
        apart = np.remainder(apart + np.pi, 2.0 * np.pi) - np.pi
    known = np.isfinite(apart)
    return SignalDifference(asked.name, unit, t_s[known], apart[known], asked.tolerance)


class Aligned(NamedTuple):
    """Two runs over one time: by what, the shift of the second's times [s], and the differences of signals."""

    by: str
    shift_s: float
    signals: tuple[SignalDifference, ...]

    def figures(self) -> dict[str, Any]:
        """Return it as ``hil review --json`` has it."""
        return {"by": self.by, "shift_s": self.shift_s, "signals": [one.figures() for one in self.signals]}

    def rows(self) -> list[tuple[str, ...]]:
        """Return the differences as a table of texts, with its head."""
        return [("difference of", "rms", "largest", "at", "tolerance", "within"), *map(_row, self.signals)]


def _row(one: SignalDifference) -> tuple[str, ...]:
    found = one.figures()
    rms, most = ("-" if found[name] is None else f"{found[name]:.4g} {one.unit}".rstrip() for name in ("rms", "max"))
    at = "-" if found["max_s"] is None else f"{found['max_s']:.4g} s"
    limit = "-" if one.tolerance is None else f"±{one.tolerance:g}"
    within = {None: "-", True: "yes", False: "no"}[found["within"]]
    if found["within"] is False:
        within += f", from {found['first_outside_s']:.4g} s, {found['outside_percent']:.3g} % of the time"
    return one.name, rms, most, at, limit, within


def signals_for(asked: Sequence[Asked]) -> set[str]:
    """Return the names of the signals that ``aligned`` needs of both runs."""
    return {"loop.t_s", *(one.name for one in asked), *COMPARED, *WHEEL_SPEEDS}


def aligned(runs: Sequence[RecordedRun], by: str = "t", asked: Sequence[Asked] = ()) -> Aligned:
    """Align two runs and compare the signals that are asked for, or the errors if none is.

    Raises BadInputError as ``shift_s`` and ``signal_differences`` do.
    """
    first, second = runs
    shift = shift_s(first, second, by)
    usual = [Asked(name) for name in COMPARED if name in first.signals and name in second.signals]
    return Aligned(by, shift, tuple(signal_differences(first, second, asked or usual, shift)))
