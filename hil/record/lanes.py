"""What a recording shows beside its signals: lanes of states on a timeline, and limits as lines in the plots.

There is a lane for the robot, the link, the estimator and each fault of the scenario. Limits are the bounds of
expectations during their time, and the limits of torque and current.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from firmware_protocol.generated.messages import State
from hil.core.types import WHEEL_NAMES
from hil.record.layout import Entity
from hil.record.properties import table_rows

ROBOT_LANE = "/robot/state"
FAULT_LANES = "/fault"

Codes = npt.NDArray[np.float64]
Columns = Mapping[str, int]

_GREEN, _YELLOW, _ORANGE, _RED, _GREY = 0x3FB27FFF, 0xE0C341FF, 0xF4A23AFF, 0xEB5757FF, 0x8D99AEFF
_ROBOT_COLOURS = {"BOOT": _GREY, "IDLE": 0x6C8EBFFF, "ARMED": _ORANGE, "ACTIVE": _GREEN}
_ROBOT_COLOURS |= {"STOPPING": _YELLOW, "FAULT": _RED, "ESTOP": 0xB5179EFF}
_GOOD, _LOSSY, _STALE, _SILENT = range(4)
_LINK_STATES = {_GOOD: "GOOD", _LOSSY: "LOSSY", _STALE: "STALE", _SILENT: "SILENT"}
_LOSSY_S = 0.1
"""The link's state is LOSSY for this time after a frame was lost or rejected."""
_STALE_MS = 100.0
"""Age above which feedback is stale, if the scenario has no ``firmware.watchdog_s``."""


class Lane(NamedTuple):
    """A lane: its path, the names and colours of its states by code, and the function that finds the codes.

    ``codes`` takes rows of shape (n, signals) and returns (n,); NaN stands for no state.
    """

    path: str
    names: Mapping[int, str]
    colours: Sequence[int]
    codes: Callable[[npt.NDArray[np.float64]], Codes]


def lanes(column: Columns, values: Mapping[str, Any]) -> list[Lane]:
    """Return the lanes of a run. ``column``: index of each signal in a row; ``values``: the scenario's, by key."""
    robot = {int(state): state.name for state in State}
    colours = [_ROBOT_COLOURS.get(name, _GREY) for name in robot.values()]
    found = [Lane(ROBOT_LANE, robot, colours, _one(column, "robot.state"))]
    watchdog_s = values.get("firmware.watchdog_s")
    stale_ms = _STALE_MS if watchdog_s is None else float(watchdog_s) * 1e3
    if {"link.rejected", "link.lost", "link.feedback_age_ms"} <= column.keys():
        found.append(Lane("/link/state", _LINK_STATES, [_GREEN, _YELLOW, _ORANGE, _RED], _Link(column, stale_ms)))
    if "estimator.health" in column:
        health = {0: "GOOD", 1: "DEGRADED", 2: "LOST"}
        found.append(Lane("/ctrl/estimator/health", health, [_GREEN, _ORANGE, _RED], _one(column, "estimator.health")))
    faults = enumerate(table_rows(values, "fault"))
    return found + [_fault_lane(number, row, column["loop.t_s"]) for number, row in faults]


def _one(column: Columns, signal: str) -> Callable[[npt.NDArray[np.float64]], Codes]:
    place = column[signal]
    return lambda rows: rows[:, place]


class _Link:
    """Finds the link's state, row by row, by recent losses and by the age of feedback."""

    def __init__(self, column: Columns, stale_ms: float) -> None:
        self._t = column["loop.t_s"]
        self._counts = [column["link.rejected"], column["link.lost"]]
        self._age = column["link.feedback_age_ms"]
        self._stale_ms = stale_ms
        self._count_before: float | None = None
        self._lost_s = -math.inf

    def __call__(self, rows: npt.NDArray[np.float64]) -> Codes:
        count = np.nan_to_num(rows[:, self._counts]).sum(axis=1)
        before = np.append(count[:1] if self._count_before is None else self._count_before, count[:-1])
        times = np.where(count > before, rows[:, self._t], -np.inf)
        lost_s = np.maximum(np.fmax.accumulate(times), self._lost_s)
        self._count_before, self._lost_s = float(count[-1]), float(lost_s[-1])
        age_ms = rows[:, self._age]
        state = np.where(rows[:, self._t] - lost_s < _LOSSY_S, _LOSSY, _GOOD)
        state = np.where(age_ms > self._stale_ms, _STALE, state)
        return np.where(np.isnan(age_ms), _SILENT, state).astype(float)


def _fault_lane(number: int, row: Mapping[str, Any], t_column: int) -> Lane:
    from hil.faults.kinds import KINDS  # only for a run with faults: it imports the wire's protocol

    kind, target = str(row["kind"]), str(row["target"])
    begin_s, end_s = float(row.get("start_s", 0.0)), float(row.get("end_s", math.inf))
    is_instant = any(known.is_instant and known.name == kind and target in known.targets for known in KINDS)
    word = "HAPPENED" if is_instant else "IN FORCE"

    def codes(rows: npt.NDArray[np.float64]) -> Codes:
        t_s = rows[:, t_column]
        return ((t_s >= begin_s) & (t_s < end_s)).astype(float)

    name = re.sub(r"[^\w.-]", "_", f"{number}_{kind}_{target}")
    return Lane(f"{FAULT_LANES}/{name}", {0: "-", 1: word}, [0x303030FF, _RED], codes)


LIMITS_PATH = "/limits"
"""Prefix of an entity's path: there the limits of its signals are recorded."""

_SPEEDS = tuple(f"wheel.{wheel}.speed_rad_s" for wheel in WHEEL_NAMES)
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


def limits(values: Mapping[str, Any], entities: Sequence[Entity]) -> dict[str, tuple[Limit, ...]]:
    """Return the limits that a scenario sets on signals, by the path of the entity that shows them.

    ``values`` are the scenario's, by dotted key. Entities without a limit are left out.
    """
    of_signal: dict[str, list[Limit]] = {}
    faults = table_rows(values, "fault")
    for row in table_rows(values, "expect"):
        if "figure" in row or "stops" in row:  # not about a signal
            continue
        span, of = (float(row.get("from_s", 0.0)), float(row.get("to_s", math.inf))), row.get("of")
        if "after_fault" in row:
            from hil.faults.kind import claimed_span_s  # only then: it imports the wire's protocol

            span = claimed_span_s(row, faults)
        for signal in _SPEEDS if row.get("at_rest") else [row["signal"]]:
            claims = [Limit(f"{signal} {word}", value, *span, of) for word, value in _claims(row)]
            of_signal.setdefault(signal, []).extend(claims)
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


def limit_values(
    lines: Sequence[Limit], column: Columns, rows: npt.NDArray[np.float64], t_s: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the limits in rows of shape (n, signals), at their times (n,): shape (n, limits), NaN outside the span."""
    begin, end = (np.array([line[i] for line in lines]) for i in (2, 3))
    of = [0.0 if line.of is None else rows[:, column[line.of]] for line in lines]
    values = (line.value + base for line, base in zip(lines, of, strict=True))
    value = np.column_stack([np.broadcast_to(each, len(rows)) for each in values])
    claimed = (t_s[:, None] >= begin) & (t_s[:, None] <= end)
    return np.where(claimed, value, np.nan)


def _claims(row: Mapping[str, Any]) -> list[tuple[str, float]]:
    """Return word and value of each line that an expectation draws."""
    if row.get("at_rest"):
        return [("at rest", side * float(row["below"])) for side in (1, -1)]
    claims = [(word, float(row[word])) for word in ("below", "above") if word in row]
    if "within" in row:
        low, high = row["within"]
        claims += [("above", float(low)), ("below", float(high))]
    for word in ("equals", "settles_to"):
        if word in row:
            target, tolerance = float(row[word]), float(row.get("tolerance", 0.0))
            claims += [(word.replace("_", " "), target + side * tolerance) for side in ((1, -1) if tolerance else (0,))]
    return claims
