"""Checks the claims of ``[[expect]]`` about signals on rows, for the lanes and the marks that a recording shows.

The judge of a run is ``hil.judge``: this decides nothing. Many rows are checked at once, in the recorder's process, by
the scenario's values alone.
"""

import math
import re
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.addons.report.entities import Entity
from hil.core.signals import TRUE_POSE, WHEEL_SPEEDS, unit_of
from hil.core.types import WHEEL_NAMES
from hil.record.properties import table_rows

Table = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Columns = Mapping[str, int]


class Standing(IntEnum):
    """How a claim stands: in its time, and after it."""

    WAITING = 0
    HOLDING = 1
    VIOLATED = 2
    SETTLING = 3
    HELD = 4
    FAILED = 5
    OPEN = 6


class Claim(NamedTuple):
    """A row of ``[[expect]]``: its place, its words, its time [s], and the limits of its value, None where it has none.

    A value at a limit holds if the claim ``includes`` its limits. ``signal`` is None for a claim about a figure, a stop
    or rest; ``of`` is the signal that is subtracted.
    """

    number: int
    words: str
    from_s: float
    to_s: float
    low: float | None = None
    high: float | None = None
    includes: bool = False
    signal: str | None = None
    of: str | None = None
    is_rest: bool = False
    is_stop: bool = False
    settles: bool = False

    @property
    def signals(self) -> tuple[str, ...]:
        """The signals whose plots show the claim."""
        return WHEEL_SPEEDS if self.is_rest else () if self.signal is None else (self.signal,)

    @property
    def needed(self) -> tuple[str, ...]:
        """The signals from which the claim is checked; none for a claim about a figure or a stop."""
        if self.is_rest:
            return (*WHEEL_SPEEDS, *TRUE_POSE)
        return tuple(name for name in (self.signal, self.of) if name is not None)

    @property
    def path(self) -> str:
        """The claim as the last part of an entity's path."""
        return re.sub(r"[^\w.-]+", "_", f"{self.number:02}_{self.words}").strip("_")


def claims(values: Mapping[str, Any]) -> list[Claim]:
    """Return the claims of a scenario, in their order; ``values`` are the scenario's, by dotted key."""
    faults = table_rows(values, "fault")
    rows = table_rows(values, "expect")
    if any(key.startswith("expect.0.") for key in values):  # an older recording, which counts rows from 0
        rows = [row | {"after_fault": row["after_fault"] + 1} if _is_row(row) else row for row in rows]
    return [_claim(number, row, faults) for number, row in enumerate(rows)]


def _is_row(claim: Mapping[str, Any]) -> bool:
    """Whether a claim names a fault by its row."""
    return isinstance(claim.get("after_fault"), int)


def _claim(number: int, row: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> Claim:
    span = (float(row.get("from_s", 0.0)), float(row.get("to_s", math.inf)))
    if "after_fault" in row:
        from hil.faults.rows import claimed_span_s  # only then: it imports the wire's protocol

        span = claimed_span_s(row, faults)
    if "stops" in row:
        return Claim(number, f"stops {row['stops']}", *span, is_stop=True)
    low, high, includes, said = _limits(row)
    subject = "at_rest" if row.get("at_rest") else str(row.get("figure") or row["signal"])
    less = f" minus {row['of']}" if "of" in row else ""
    claim = Claim(number, f"{subject}{less} {said}", *span, low, high, includes)
    if "figure" in row:
        return claim
    if row.get("at_rest"):
        return claim._replace(is_rest=True)
    return claim._replace(signal=row["signal"], of=row.get("of"), settles="settles_to" in row)


def _limits(row: Mapping[str, Any]) -> tuple[float | None, float | None, bool, str]:
    """Return the lowest and highest value, whether they hold themselves, and the claim in words."""
    if "within" in row:
        low, high = map(float, row["within"])
        return low, high, True, f"within {low:g} to {high:g}"
    for word in ("equals", "settles_to"):
        if word in row:
            target, tolerance = float(row[word]), float(row.get("tolerance", 0.0))
            return target - tolerance, target + tolerance, True, f"{word.replace('_', ' ')} {target:g}"
    above, below = (None if row.get(word) is None else float(row[word]) for word in ("above", "below"))
    words = [f"{word} {value:g}" for word, value in (("above", above), ("below", below)) if value is not None]
    return above, below, False, " ".join(words) or f"baseline {row.get('baseline')}"


class Checked(NamedTuple):
    """For each row of a piece: how the claim stands (a ``Standing``, NaN for unknown), and whether it is violated."""

    standing: Table
    violated: Flags


class ClaimWatch:
    """Checks a claim piece by piece; ``violation_s`` is from when to when it was violated first [s], or None.

    ``column`` says where each signal is in a row; ``values`` are the scenario's. A claim whose signals the rows do not
    have is never checked, and stands open.
    """

    def __init__(self, claim: Claim, column: Columns, values: Mapping[str, Any]) -> None:
        self.claim = claim
        self.violation_s: tuple[float, float] | None = None
        self._t = column["loop.t_s"]
        known = all(name in column for name in claim.needed)
        self._columns = [column[name] for name in claim.needed] if known else []
        self._is_angle = claim.of is not None and unit_of(str(claim.signal)) == "rad"
        sizes = [values.get(f"robot.{name}") for name in ("half_length_m", "half_width_m", "wheel_radius_m")]
        self._sizes = None if any(size is None for size in sizes) else [float(size) for size in sizes]  # type: ignore[arg-type]
        self._before: Table | None = None  # the last row of the time, for rest: t and the true pose
        self._samples = 0
        self._is_over = False  # whether the first violation is
        self._ends_good = False  # whether the newest sample holds

    def __call__(self, rows: Table) -> Checked:
        """Check rows of shape (n, signals), later than those before."""
        t_s, claim = rows[:, self._t], self.claim
        standing = np.full(len(rows), float(Standing.WAITING))
        inside = (t_s >= claim.from_s) & (t_s <= claim.to_s)
        violated = np.zeros(len(rows), bool)
        if not self._columns:
            standing[inside] = Standing.OPEN
            standing[t_s > claim.to_s] = Standing.OPEN
            return Checked(standing, violated)
        if inside.any():
            is_first = self._before is None
            value = self._values(rows[inside], t_s[inside])
            sampled = np.ones(len(value), bool)
            if claim.is_rest and is_first:  # there is no movement yet
                sampled[0] = not math.isnan(value[0])
            holds = self._holds(value)
            self._samples += int(sampled.sum())
            if sampled.any():
                self._ends_good = bool(holds[sampled][-1])
            bad = Standing.SETTLING if claim.settles else Standing.VIOLATED
            standing[inside] = np.where(holds, Standing.HOLDING, np.where(sampled, bad, Standing.WAITING))
            violated[inside] = ~holds & sampled & (not claim.settles)
            self._extend(t_s, violated)
        standing[t_s > claim.to_s] = Standing.HELD if self.has_held else Standing.FAILED
        return Checked(standing, violated)

    def _extend(self, t_s: Table, violated: Flags) -> None:
        """Find the first violation, or where it ends."""
        if self._is_over or not (violated.any() or self.violation_s):
            return
        first = 0 if self.violation_s else int(np.argmax(violated))
        good = np.flatnonzero(~violated[first:])
        last = first + int(good[0]) if len(good) else len(violated) - 1
        begin_s = self.violation_s[0] if self.violation_s else float(t_s[first])
        self.violation_s = begin_s, float(t_s[last])
        self._is_over = bool(len(good))

    @property
    def has_held(self) -> bool:
        """Whether the claim holds by the samples so far."""
        return self._samples > 0 and self.violation_s is None and self._ends_good

    def _values(self, rows: Table, t_s: Table) -> Table:
        columns = rows[:, self._columns]
        if self.claim.is_rest:
            return self._fastest(columns, t_s)
        if self.claim.of is None:
            return columns[:, 0]
        difference: Table = columns[:, 0] - columns[:, 1]
        return difference - math.tau * np.round(difference / math.tau) if self._is_angle else difference

    def _fastest(self, columns: Table, t_s: Table) -> Table:
        """Return the speed [rad/s] of the fastest wheel: as measured, or as the true movement between rows needs it."""
        speeds = np.abs(columns[:, : len(WHEEL_SPEEDS)])
        found: Table = np.fmax.reduce(speeds, axis=1)
        poses = np.column_stack([t_s, columns[:, len(WHEEL_SPEEDS) :]])
        before = np.full((1, poses.shape[1]), np.nan) if self._before is None else self._before
        dt_s, dx_m, dy_m, turn_rad = np.diff(np.vstack([before, poses]), axis=0).T
        self._before = poses[-1:]
        if self._sizes is None:
            return found
        half_length_m, half_width_m, radius_m = self._sizes
        turn_rad = np.abs(turn_rad - math.tau * np.round(turn_rad / math.tau))
        rim_m = np.hypot(dx_m, dy_m) + (half_length_m + half_width_m) * turn_rad
        rim = np.divide(rim_m, radius_m * dt_s, out=np.full(len(rim_m), np.nan), where=dt_s > 0.0)
        fastest: Table = np.fmax(found, rim)
        return fastest

    def _holds(self, value: Table) -> Flags:
        claim = self.claim
        low, high = (-math.inf if claim.low is None else claim.low), (math.inf if claim.high is None else claim.high)
        if claim.includes:
            within: Flags = (value >= low) & (value <= high)
            return within
        # A comparison with NaN is False, as it must be.
        inside: Flags = (value > low) & (value < high)
        return inside


LIMITS_PATH = "/limits"
"""Prefix of an entity's path: below it is an entity for each bound of its signals."""
VIOLATIONS_PATH = "/violations"
"""Prefix of an entity's path: there its signals are marked where they violate an expectation."""

_OF_WHEELS = (("torque_command_n_m", "robot.torque_limit_n_m"), ("current_a", "firmware.current_limit_a"))


class Limit(NamedTuple):
    """A line: a value in the unit of its signal, from one time to another, both included.

    The value is above the signal ``of``, if that is given.
    """

    label: str
    value: float
    from_s: float
    to_s: float
    of: str | None = None

    def inside(self, t_s: Table) -> Flags:
        """Return for times of shape (n,) whether the line is drawn there."""
        return (t_s >= self.from_s) & (t_s <= self.to_s)

    def values(self, column: Columns, rows: Table) -> Table:
        """Return the line at rows of shape (n, signals): shape (n,)."""
        base = np.zeros(len(rows)) if self.of is None else rows[:, column[self.of]]
        found: Table = base + self.value
        return found


def limits(
    values: Mapping[str, Any], claimed: Sequence[Claim], entities: Sequence[Entity]
) -> dict[str, tuple[Limit, ...]]:
    """Return the limits that a scenario sets on signals, by the path of the entity that shows them.

    ``values`` are the scenario's, by dotted key; ``claimed`` are its claims. Entities without a limit are left out.
    """
    of_signal: dict[str, list[Limit]] = {}
    for claim in claimed:
        for signal in claim.signals:
            of_signal.setdefault(signal, []).extend(_of_claim(claim))
    for quantity, key in _OF_WHEELS:
        if (size := values.get(key)) is not None:
            both = [Limit("limit", sign * float(size), -math.inf, math.inf) for sign in (1.0, -1.0)]
            for wheel in WHEEL_NAMES:
                of_signal.setdefault(f"wheel.{wheel}.{quantity}", []).extend(both)
    found = {}
    for entity in entities:
        # Four wheels have the same limit: one line.
        lines = dict.fromkeys(limit for series in entity.series for limit in of_signal.get(series.signal, ()))
        if lines:
            found[entity.path] = tuple(lines)
    return found


def _of_claim(claim: Claim) -> list[Limit]:
    if claim.is_rest:
        return [Limit("bound: at rest", side * float(claim.high or 0.0), *_span(claim)) for side in (1, -1)]
    sides = dict.fromkeys(value for value in (claim.low, claim.high) if value is not None)
    less = "" if claim.of is None else f" from {claim.of}"
    return [Limit(f"bound: {value:g}{less}", value, *_span(claim), claim.of) for value in sides]


def _span(claim: Claim) -> tuple[float, float]:
    return claim.from_s, claim.to_s
