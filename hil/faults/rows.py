"""A row of ``[[fault]]`` as numbers for the code that applies it, its chance, and the scenario's time on a clock."""

import math
import random
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hil.core.errors import nearest
from hil.core.ports import Clock

NS_PER_S = 1_000_000_000
NEVER_NS = 2**62
REST_RAD_S = 0.2
"""The default speed of a wheel below which a robot is at rest: 15 mm/s at the rim of a wheel of 75 mm."""


class FaultRow(NamedTuple):
    """A row of ``[[fault]]`` as numbers; those that its kind does not have are 0.

    It is in force while start_ns <= t < end_ns, in the scenario's time.
    """

    kind: str
    acts_on: str
    target: str
    start_ns: int
    end_ns: int
    value: float = 0.0
    burst_frames: float = 0.0
    x_m: float = 0.0
    y_m: float = 0.0
    radius_m: float = 0.0

    def is_in_force(self, t_ns: int) -> bool:
        """Return whether the row is in force at this time."""
        return self.start_ns <= t_ns < self.end_ns


class ScenarioTime:
    """The scenario's time [ns] on a clock, from the first ACTIVE tick; it is None before ``begin``.

    ``offset_ns`` is the clock's time when the scenario's is 0; 0 before ``begin``.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._origin_ns: int | None = None
        self.offset_ns = 0

    def begin(self, origin_ns: int) -> None:
        """Set the clock time at which the scenario's time began."""
        self._origin_ns = self.offset_ns = origin_ns

    def now_ns(self) -> int | None:
        """Return the scenario's time, or None before it has begun."""
        return self.at(self._clock.now_ns())

    def at(self, clock_ns: int) -> int | None:
        """Return the scenario's time at a time of the clock, or None before it has begun."""
        return None if self._origin_ns is None else clock_ns - self._origin_ns


def claimed_span_s(claim: Mapping[str, Any], faults: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Return from when to when a row of ``[[expect]]`` is judged; both tables as plain values, None or left out alike.

    ``after_fault`` names a fault by its name, by its kind if only one row has that, or by its row, from 1. A robot that
    is at rest while a fault lasts may drive again after it, so ``at_rest`` ends with a fault that still lasts when the
    claim begins. A claim that the robot ``stops`` is from the fault's begin on, for ``within_s``. Raises
    ValueError, with part of a message, when there is no such fault or more than one.
    """
    which, to_s = claim.get("after_fault"), float(claim.get("to_s", math.inf))
    if which is None:
        return float(claim.get("from_s", 0.0)), to_s
    fault = _named(which, faults)
    start_s = float(fault.get("start_s", 0.0))
    from_s = start_s + float(claim.get("within_s") or 0.0)
    if claim.get("stops"):
        return start_s, min(to_s, from_s)
    end_s = float(fault.get("end_s", math.inf))
    return from_s, min(to_s, end_s) if claim.get("at_rest") and end_s > from_s else to_s


def _named(which: int | str, faults: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    if not faults:
        raise ValueError("the scenario has no fault; add a row of [[fault]], or give from_s")
    if isinstance(which, int):
        if not 1 <= which <= len(faults):
            raise ValueError(f"expected a row from 1 to {len(faults)}: the scenario has {len(faults)} of them")
        return faults[which - 1]
    found = [row for row in faults if row.get("name") == which] or [row for row in faults if row["kind"] == which]
    if not found:
        known = [row.get("name") or row["kind"] for row in faults]
        raise ValueError(f"no fault has this name or kind{nearest(which, known)}")
    if len(found) > 1:
        raise ValueError(f'{len(found)} faults are of this kind; name one of them, as in name = "first {which}"')
    return found[0]


def generators(rows: Sequence[FaultRow], seed: int) -> list[random.Random]:
    """Return a random generator for each row, seeded by ``seed`` and by what the row says.

    So removing a row does not change the random numbers of the others. Equal rows get different generators.
    """
    seen: dict[FaultRow, int] = {}
    sources = []
    for row in rows:
        seen[row] = seen.get(row, -1) + 1
        sources.append(random.Random(f"{seed} {tuple(row)} {seen[row]}"))
    return sources
