"""Limits drawn as lines beside signals: bounds of expectations during their time, and limits of torque and current."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.types import WHEEL_NAMES
from hil.record.layout import Entity
from hil.record.properties import table_rows

LIMITS_PATH = "/limits"
"""Prefix of an entity's path: there the limits of its signals are recorded."""

_OF_WHEELS = (("torque_command_n_m", "robot.torque_limit_n_m"), ("current_a", "firmware.current_limit_a"))


class Limit(NamedTuple):
    """A line: a value in the unit of its signal, from one time to another, both included."""

    label: str
    value: float
    from_s: float
    to_s: float


def limits(values: Mapping[str, Any], entities: Sequence[Entity]) -> dict[str, tuple[Limit, ...]]:
    """Return the limits of a scenario (its values by dotted key), by the path of the entity that holds the signals.

    Entities without a limit are left out.
    """
    of_signal: dict[str, list[Limit]] = {}
    for row in table_rows(values, "expect"):
        span = float(row.get("from_s", 0.0)), float(row.get("to_s", math.inf))
        claims = [Limit(f"{row['signal']} {word}", value, *span) for word, value in _claims(row)]
        of_signal.setdefault(row["signal"], []).extend(claims)
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


def limit_values(lines: Sequence[Limit], t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the limits at times of shape (n,): shape (n, limits), NaN at times outside the limit's span."""
    value, begin, end = (np.array([line[i] for line in lines]) for i in (1, 2, 3))
    claimed = (t_s[:, None] >= begin) & (t_s[:, None] <= end)
    return np.where(claimed, value, np.nan)


def _claims(row: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return word and value of each line that an expectation draws."""
    claims = [(word, float(row[word])) for word in ("below", "above") if word in row]
    if "within" in row:
        low, high = row["within"]
        claims += [("above", float(low)), ("below", float(high))]
    for word in ("equals", "settles_to"):
        if word in row:
            target, tolerance = float(row[word]), float(row.get("tolerance", 0.0))
            claims += [(word.replace("_", " "), target + side * tolerance) for side in ((1, -1) if tolerance else (0,))]
    return claims
