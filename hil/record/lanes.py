"""Lanes of states on a timeline: the verdict, the robot, the link, the estimator, each expectation, each fault.

A viewer sorts lanes by their paths; the number in a path is the lane's place.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from firmware_protocol.generated.messages import State
from hil.record.claims import Claim, Columns, Standing
from hil.record.properties import table_rows

LANES = "/state"
"""All lanes are below this path."""
VERDICT_LANE = f"{LANES}/1_verdict"
ROBOT_LANE = f"{LANES}/2_robot"
LINK_LANE = f"{LANES}/3_link"
ESTIMATOR_LANE = f"{LANES}/4_estimator"
EXPECT_LANES = f"{LANES}/5_expect"
FAULT_LANES = f"{LANES}/6_fault"

Codes = npt.NDArray[np.float64]

_GREEN, _YELLOW, _ORANGE, _RED, _GREY = 0x3FB27FFF, 0xE0C341FF, 0xF4A23AFF, 0xEB5757FF, 0x8D99AEFF
_DARK_GREEN, _DARK_RED, _DARK_GREY = 0x2A6E50FF, 0x9E2B2BFF, 0x4A4F57FF
_ROBOT_COLOURS = {"BOOT": _GREY, "IDLE": 0x6C8EBFFF, "ARMED": _ORANGE, "ACTIVE": _GREEN}
_ROBOT_COLOURS |= {"STOPPING": _YELLOW, "FAULT": _RED, "ESTOP": 0xB5179EFF}
_GOOD, _LOSSY, _STALE, _SILENT = range(4)
_LINK_STATES = {_GOOD: "GOOD", _LOSSY: "LOSSY", _STALE: "STALE", _SILENT: "SILENT"}
_LOSSY_S = 0.1
"""The link's state is LOSSY for this time after a frame was lost or rejected."""
_STALE_MS = 100.0
"""Age above which feedback is stale, if the scenario has no ``firmware.watchdog_s``."""
RUNNING, PASSED, FAILED, NOT_JUDGED = "RUNNING", "PASSED", "FAILED", "NOT JUDGED"
_VERDICTS = {RUNNING: _GREY, PASSED: _GREEN, FAILED: _RED, NOT_JUDGED: _YELLOW}
_STANDINGS = {
    Standing.WAITING: _DARK_GREY,
    Standing.HOLDING: _GREEN,
    Standing.VIOLATED: _RED,
    Standing.SETTLING: _YELLOW,
    Standing.HELD: _DARK_GREEN,
    Standing.FAILED: _DARK_RED,
    Standing.OPEN: _GREY,
}
OVER = "-"
"""The state of a fault that is over, and of what is not known for a while; it is not drawn."""


class Lane(NamedTuple):
    """A lane: its path, and the names of its states, each with its colour (RGBA)."""

    path: str
    colours: Mapping[str, int]


class CodedLane(NamedTuple):
    """A lane that rows decide: ``codes`` takes rows of shape (n, signals) and returns (n,).

    ``names`` are the states by their codes; NaN stands for no known state.
    """

    lane: Lane
    names: Mapping[int, str]
    codes: Callable[[npt.NDArray[np.float64]], Codes]


def verdict_lane() -> Lane:
    """Return the lane of the run's verdict."""
    return Lane(VERDICT_LANE, _VERDICTS)


def claim_lane(claim: Claim) -> Lane:
    """Return the lane of an expectation; its states are those of ``Standing``, and ``NOT_JUDGED``."""
    colours = {standing.name: colour for standing, colour in _STANDINGS.items()}
    return Lane(f"{EXPECT_LANES}_{claim.path}", {**colours, NOT_JUDGED: _GREY})


def lanes(column: Columns, values: Mapping[str, Any]) -> list[CodedLane]:
    """Return the lanes that rows decide, but for those of expectations and faults.

    ``column``: index of each signal in a row; ``values``: the scenario's, by dotted key.
    """
    robot = {int(state): state.name for state in State}
    found = [_coded(ROBOT_LANE, robot, [_ROBOT_COLOURS.get(name, _GREY) for name in robot.values()], column)]
    watchdog_s = values.get("firmware.watchdog_s")
    stale_ms = _STALE_MS if watchdog_s is None else float(watchdog_s) * 1e3
    if {"link.rejected", "link.lost", "link.feedback_age_ms"} <= column.keys():
        colours = dict(zip(_LINK_STATES.values(), (_GREEN, _YELLOW, _ORANGE, _RED), strict=True))
        found.append(CodedLane(Lane(LINK_LANE, colours), _LINK_STATES, _Link(column, stale_ms)))
    if "estimator.health" in column:
        health = {0: "GOOD", 1: "DEGRADED", 2: "LOST"}
        found.append(_coded(ESTIMATOR_LANE, health, (_GREEN, _ORANGE, _RED), column))
    return found


_SIGNALS = {ROBOT_LANE: "robot.state", ESTIMATOR_LANE: "estimator.health"}


def _coded(path: str, names: Mapping[int, str], colours: Sequence[int], column: Columns) -> CodedLane:
    """Return the lane of a signal that is the code of a state."""
    place = column[_SIGNALS[path]]
    return CodedLane(Lane(path, dict(zip(names.values(), colours, strict=True))), names, lambda rows: rows[:, place])


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


class FaultLane(NamedTuple):
    """The lane of a fault of the scenario: ``number`` is its place, ``word`` its state while it is in force [s]."""

    coded: CodedLane
    number: int
    word: str
    words: str
    begin_s: float
    end_s: float


def fault_lanes(column: Columns, values: Mapping[str, Any]) -> list[FaultLane]:
    """Return the lane of each fault; it has no state until the fault begins, so an idle fault takes no room."""
    return [_fault_lane(number, row, column["loop.t_s"]) for number, row in enumerate(table_rows(values, "fault"))]


def _fault_lane(number: int, row: Mapping[str, Any], t_column: int) -> FaultLane:
    from hil.faults.kinds import is_instant  # only for a run with faults: it imports the wire's protocol

    kind, target = str(row["kind"]), str(row["target"])
    begin_s, end_s = float(row.get("start_s", 0.0)), float(row.get("end_s", math.inf))
    word = "HAPPENED" if is_instant(kind, target) else "IN FORCE"

    def codes(rows: npt.NDArray[np.float64]) -> Codes:
        t_s = rows[:, t_column]
        return np.where(t_s < begin_s, np.nan, (t_s < end_s).astype(float))

    path = re.sub(r"[^\w.-]", "_", f"{number}_{kind}_{target}")
    lane = Lane(f"{FAULT_LANES}_{path}", {word: _RED})
    return FaultLane(CodedLane(lane, {0: OVER, 1: word}, codes), number, word, f"{kind} {target}", begin_s, end_s)
