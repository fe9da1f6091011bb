"""Writes the lanes of states: each change of a state, and what is known of the verdict at the run's end."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from hil.record.claims import Checked, Claim, Columns, Standing
from hil.record.drawings import Times, indexes, seconds_index
from hil.record.lanes import (
    FAILED,
    NOT_JUDGED,
    OVER,
    PASSED,
    RUNNING,
    CodedLane,
    FaultLane,
    Lane,
    claim_lane,
    fault_lanes,
    lanes,
    verdict_lane,
)
from hil.record.ring import Rows


class States:
    """Writes the changes of the lanes of a run, piece by piece.

    A lane without a state is not written, so it takes no room. The verdict of a run that passed, and of one that failed
    for a reason without a time, is that of its whole time; a failure with a time begins there.
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
        self._lanes: list[CodedLane] = lanes(column, values)
        self._faults: list[FaultLane] = fault_lanes(column, values)
        self._claims = {claim.number: claim_lane(claim) for claim in claimed}
        self._claimed = claimed
        self._verdict = verdict_lane()
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
        return [fault for fault in self._faults if fault.coded.lane.path in self._configured]

    def rows(self, rows: Rows, times: Times, checked: Sequence[tuple[Claim, Checked]]) -> None:
        """Write the changes in rows of shape (n, signals); ``checked`` are the claims about signals at these rows."""
        if self._begin_s is None and len(times):
            self._begin_s = float(times[0, 0])
            if self._live:
                self._put(self._verdict, self._begin_s, RUNNING)
        for one in (*self._lanes, *(fault.coded for fault in self._faults)):
            self._changes(one.lane, one.names, one.codes(rows), times)
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
                self._put(fault.coded.lane, min(fault.begin_s, end_s), fault.word)

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
