"""Bounds as lines in the plots: those of expectations during their time, and the limits of torque and current."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hil.core.types import WHEEL_NAMES
from hil.record.claims import Claim, Columns, Flags, Table
from hil.record.layout import Entity

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
