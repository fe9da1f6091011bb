"""Lanes of states on a timeline: the verdict, the robot, the link, the estimator, each expectation, each fault.

A viewer sorts lanes by their paths; the number in a path is the lane's place.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import rerun as rr

from firmware_protocol.generated.messages import State
from hil.addons.report.claim_watch import Checked, Claim, Columns, Standing
from hil.addons.report.verdict_text import FAILED, NOT_JUDGED, PASSED, RUNNING
from hil.core.types import Limit
from hil.record.properties import table_rows
from hil.record.ring import Rows
from hil.record.stream import Times, indexes, seconds_index

LANES = "/state"
"""All lanes are below this path."""

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
_CLAIM_COLOURS = {**{standing.name: colour for standing, colour in _STANDINGS.items()}, NOT_JUDGED: _GREY}
"""Of an expectation's lane: the states of ``Standing``, and ``NOT_JUDGED``."""
OVER = "-"
"""The state of a fault that is over, and of what is not known for a while; it is not drawn."""


class Lane(NamedTuple):
    """A lane: its path, and the names of its states, each with its colour (RGBA).

    If rows decide it, ``codes`` takes rows of shape (n, signals) and returns (n,), NaN for no known state; ``names``
    are the states by their codes.
    """

    path: str
    colours: Mapping[str, int]
    names: Mapping[int, str] = {}
    codes: Callable[[npt.NDArray[np.float64]], Codes] | None = None


def _row_lanes(column: Columns, values: Mapping[str, Any]) -> Iterator[Lane]:
    """Yield the lanes that rows decide, but for those of expectations and faults.

    ``column``: index of each signal in a row; ``values``: the scenario's, by dotted key.
    """
    robot = {int(state): state.name for state in State}
    colours = {name: _ROBOT_COLOURS.get(name, _GREY) for name in robot.values()}
    yield Lane(f"{LANES}/2_robot", colours, robot, lambda rows: rows[:, column["robot.state"]])
    watchdog_s = values.get("firmware.watchdog_s")
    stale_ms = _STALE_MS if watchdog_s is None else float(watchdog_s) * 1e3
    if {"link.rejected", "link.lost", "link.feedback_age_ms"} <= column.keys():
        colours = dict(zip(_LINK_STATES.values(), (_GREEN, _YELLOW, _ORANGE, _RED), strict=True))
        yield Lane(f"{LANES}/3_link", colours, _LINK_STATES, _Link(column, stale_ms))
    if "guard.limit" in column:
        limits = {int(limit): limit.name.replace("_", " ") for limit in Limit if limit is not Limit.NONE}
        limit = column["guard.limit"]
        colours = dict.fromkeys(limits.values(), _ORANGE)
        yield Lane(
            f"{LANES}/4_limiter", colours, limits, lambda rows: np.where(rows[:, limit] > 0.0, rows[:, limit], np.nan)
        )
    if "estimator.health" in column:
        colours = {"GOOD": _GREEN, "DEGRADED": _ORANGE, "LOST": _RED}
        health = dict(enumerate(colours))
        yield Lane(f"{LANES}/4_estimator", colours, health, lambda rows: rows[:, column["estimator.health"]])


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
    """The lane of a fault of the scenario; ``word`` is its state while it is in force [s].

    It has no state until the fault begins, so an idle fault takes no room.
    """

    lane: Lane
    word: str
    words: str
    begin_s: float
    end_s: float


def _fault_lane(number: int, row: Mapping[str, Any], t_column: int) -> FaultLane:
    from hil.faults.kinds import is_instant  # only for a run with faults: it imports the wire's protocol

    kind, target = str(row["kind"]), str(row["target"])
    begin_s, end_s = float(row.get("start_s", 0.0)), float(row.get("end_s", math.inf))
    word = "HAPPENED" if is_instant(kind, target) else "IN FORCE"

    def codes(rows: npt.NDArray[np.float64]) -> Codes:
        t_s = rows[:, t_column]
        return np.where(t_s < begin_s, np.nan, (t_s < end_s).astype(float))

    path = re.sub(r"[^\w.-]", "_", f"{number}_{kind}_{target}")
    lane = Lane(f"{LANES}/6_fault_{path}", {word: _RED}, {0: OVER, 1: word}, codes)
    return FaultLane(lane, word, f"{kind} {target}", begin_s, end_s)


class States:
    """Writes the changes of the lanes of a run, piece by piece.

    A lane without a state is not written, so it takes no room. A run that passed, or failed for a reason without a
    time, has its verdict over its whole time; a failure with a time begins there.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        column: Columns,
        values: Mapping[str, Any],
        claimed: Sequence[Claim],
        *,
        live: bool,
    ) -> None:
        self._rerun = recording
        self._live = live
        self._lanes = list(_row_lanes(column, values))
        faults = enumerate(table_rows(values, "fault"))
        self._faults = [_fault_lane(number, row, column["loop.t_s"]) for number, row in faults]
        self._claims = {claim.number: Lane(f"{LANES}/5_expect_{claim.path}", _CLAIM_COLOURS) for claim in claimed}
        self._claimed = claimed
        self._verdict = Lane(f"{LANES}/1_verdict", _VERDICTS)
        self._newest: dict[str, str] = {}  # by the lane's path
        self._configured: set[str] = set()
        self._begin_s: float | None = None

    @property
    def count(self) -> int:
        """How many lanes have a state so far."""
        return len(self._configured)

    @property
    def begun(self) -> list[FaultLane]:
        """The faults that have begun so far."""
        return [fault for fault in self._faults if fault.lane.path in self._configured]

    def rows(self, rows: Rows, times: Times, checked: Sequence[tuple[Claim, Checked]]) -> None:
        """Write the changes in rows of shape (n, signals); ``checked`` are the claims about signals at these rows."""
        if self._begin_s is None and len(times):
            self._begin_s = float(times[0, 0])
            if self._live:
                self._put(self._verdict, self._begin_s, RUNNING)
        for lane in (*self._lanes, *(fault.lane for fault in self._faults)):
            if lane.codes is not None:
                self._changes(lane, lane.names, lane.codes(rows), times)
        standings = {int(standing): standing.name for standing in Standing}
        for claim, found in checked:
            # A figure is one number of the whole run: its lane is written at the end.
            if claim.signals or claim.is_stop:
                self._changes(self._claims[claim.number], standings, found.standing, times)

    def finish(self, summary: Mapping[str, Any] | None, end_s: float, failed_s: float | None) -> None:
        """Write what only the end of the run decides; ``failed_s`` is the time of its first violation, if any."""
        begin_s = end_s if self._begin_s is None else self._begin_s
        if summary is None or "passed" not in summary:
            self._put(self._verdict, begin_s, RUNNING if summary is None else NOT_JUDGED)
        else:
            word = {True: PASSED, False: FAILED, None: NOT_JUDGED}[summary["passed"]]
            if word == FAILED and failed_s is None and summary.get("failure") is not None:
                failed_s = end_s
            if word == FAILED and failed_s is not None:
                if not self._live:
                    self._put(self._verdict, begin_s, RUNNING)
                self._put(self._verdict, failed_s, FAILED)
            else:
                self._put(self._verdict, end_s if self._live else begin_s, word)
            self._judge_claims(summary, begin_s, end_s)
            self._show_applied(summary, end_s)

    def _judge_claims(self, summary: Mapping[str, Any], begin_s: float, end_s: float) -> None:
        words = {True: Standing.HELD.name, False: Standing.FAILED.name, None: NOT_JUDGED}
        for claim, outcome in zip(self._claimed, summary.get("expect") or (), strict=False):
            lane, word = self._claims[claim.number], words[outcome["passed"]]
            if claim.is_stop:
                decided_s = min(claim.to_s, end_s) if outcome["violation_s"] is None else outcome["violation_s"]
                self._put(lane, decided_s, word)
            elif not claim.signals:
                self._put(lane, end_s if self._live else begin_s, word)
            elif claim.to_s >= end_s:
                self._put(lane, end_s, word)

    def _show_applied(self, summary: Mapping[str, Any], end_s: float) -> None:
        """Show a fault that ended the run before a row was written in its time."""
        for fault, outcome in zip(self._faults, summary.get("fault") or (), strict=False):
            if outcome["applied"] and fault not in self.begun and math.isfinite(fault.begin_s):
                self._put(fault.lane, min(fault.begin_s, end_s), fault.word)

    def _changes(self, lane: Lane, names: Mapping[int, str], codes: Rows, times: Times) -> None:
        known = np.isfinite(codes)
        for i in np.flatnonzero(np.append(True, (codes[1:] != codes[:-1]) & (known[1:] | known[:-1]))):
            if not known[i] and lane.path not in self._newest:
                continue
            name = names.get(int(codes[i]), f"UNKNOWN {codes[i]:g}") if known[i] else OVER
            if name != self._newest.get(lane.path):
                self._configure(lane)
                self._newest[lane.path] = name
                states = rr.StateChange.columns(state=[name])
                self._rerun.send_columns(lane.path, indexes(times[i : i + 1]), states)

    def _put(self, lane: Lane, t_s: float, name: str) -> None:
        self._configure(lane)
        self._newest[lane.path] = name
        states = rr.StateChange.columns(state=[name])
        self._rerun.send_columns(lane.path, [seconds_index(np.array([t_s]))], states)

    def _configure(self, lane: Lane) -> None:
        if lane.path in self._configured:
            return
        self._configured.add(lane.path)
        # As an array: rerun would take a list of three or four numbers for one colour.
        colours = np.array([*lane.colours.values(), 0], dtype=np.uint32)
        visible = [True] * len(lane.colours) + [False]
        states = rr.StateConfiguration(values=[*lane.colours, OVER], colors=colours, visible=visible)
        self._rerun.log(lane.path, states, static=True)
