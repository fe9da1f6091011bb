"""One direction of a link under conditions: its fault rows, and one queue of delayed frames, ordered by clock time.

Frames that are sent or arrive together stay together as long as no row that acts on them is in force.
"""

import heapq
from collections.abc import Sequence
from enum import IntEnum, auto
from typing import TYPE_CHECKING, NamedTuple

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import PackedFrames, split
from hil.faults.rows import NEVER_NS, ScenarioTime

if TYPE_CHECKING:
    from hil.faults.link_faults import LinkFault


class Stage(IntEnum):
    """Why frames wait, in the order in which they pass. Of frames due together those of the earlier stage go first."""

    LATENCY_BEFORE_ROWS = auto()  # of commands
    HELD_BY_ROW = auto()  # of kind reorder: until another frame has overtaken them, or the row's window ends
    DELAYED_BY_ROWS = auto()  # by the sum of the delays of all rows
    LATENCY_BEHIND_ROWS = auto()  # of feedback


class Waiting(NamedTuple):
    """Frames in the queue of a direction, in the order in which they continue.

    ``row`` is the number of the row that holds them (stage HELD_BY_ROW). ``number`` counts what entered the queue.
    """

    due_ns: int
    stage: Stage
    row: int
    number: int
    frames: Sequence[Frame]


class _AtWork(NamedTuple):
    """A fault row in its window, or one that remembers frames before it (``LinkFault.remembers``), and its number."""

    number: int
    fault: "LinkFault"
    is_in_force: bool


class Direction:
    """One direction of a link, "command" or "feedback", with its fault rows and delayed frames.

    Rows and latency do not apply to frames with an id from ``exempt_from`` on (``LinkProtocol.exempt_from``).

    Attributes:
        due_ns: clock time at which the next queued frames are due; NEVER_NS when the queue is empty.
    """

    def __init__(self, name: str, rows: "Sequence[LinkFault]", time: ScenarioTime, exempt_from: int) -> None:
        self.name = name
        self.rows = rows
        self.due_ns = NEVER_NS
        self._time = time
        self._exempt_from = exempt_from
        self._queue: list[Waiting] = []
        self._count = 0
        self._delayed = 0  # number of items of the queue in the stage DELAYED_BY_ROWS
        self._last_ns = 0  # when the last of these items is due
        self._last: list[Frame] = []  # its frames
        self._has_message_rows = any(fault.is_of_one_message for fault in rows)
        # The rows that are at work from one edge of the rows' windows to the next.
        self._from_ns = self._until_ns = 0
        self._at_work: Sequence[_AtWork] = ()
        self._only_delay = False

    def hold(self, frames: Sequence[Frame], due_ns: int, stage: Stage, row: int = 0) -> None:
        """Queue frames until a time of the clock."""
        self._count += 1
        heapq.heappush(self._queue, Waiting(due_ns, stage, row, self._count, frames))
        self.due_ns = self._queue[0].due_ns

    def apart(self, frames: Sequence[Frame]) -> tuple[Sequence[Frame] | None, Sequence[Frame] | None]:
        """Split frames into those that conditions apply to and those that are exempt; None where there are none."""
        limit = self._exempt_from
        if type(frames) is PackedFrames:
            return split(frames, limit)
        return [one for one in frames if one.id < limit] or None, [one for one in frames if one.id >= limit] or None

    def pass_rows(self, frames: Sequence[Frame], t_ns: int) -> Sequence[Frame]:
        """Apply the rows to frames, at a time of the scenario. Return what continues at once; the rest is queued.

        Frames that are exempt continue at once.
        """
        rows = self._rows_at(t_ns)
        if isinstance(frames, PackedFrames) and self._has_message_rows:
            rows = [one for one in rows if one.fault.header in frames.packed]
        if not rows and not self._delayed:
            return frames
        if self._only_delay:
            return self._delay(frames, t_ns)
        at_once: list[Frame] = []
        is_changed, exempt_from, pass_one = False, self._exempt_from, self._pass
        for frame in frames:
            if frame.id >= exempt_from:
                at_once.append(frame)
                continue
            some = [frame]
            passed = pass_one(some, t_ns, rows)
            if passed is not some:
                is_changed = True
            at_once += passed
        return at_once if is_changed else frames

    def pop_first(self, t_ns: int | None) -> Waiting:
        """Remove the first frames of the queue and return them, at a time of the scenario.

        Frames that a row held first pass the rows behind it; ``frames`` is empty if these hold, delay or lose them.
        """
        first = heapq.heappop(self._queue)
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS
        if first.stage is Stage.DELAYED_BY_ROWS:
            self._delayed -= 1
        elif first.stage is Stage.HELD_BY_ROW and t_ns is not None:  # nothing overtook them in the row's window
            left_ns = min(t_ns, self.rows[first.row].row.end_ns)
            at_once = self._pass(list(first.frames), left_ns, _behind(self._rows_at(left_ns), first.row))
            return first._replace(frames=at_once)
        return first

    def forget(self, *, but_latency: bool = False) -> None:
        """Discard the queue; ``but_latency`` keeps commands in their latency, which have not reached the rows yet."""
        self._queue = [one for one in self._queue if but_latency and one.stage is Stage.LATENCY_BEFORE_ROWS]
        self._delayed = 0
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS

    def _rows_at(self, t_ns: int) -> Sequence[_AtWork]:
        """Return the rows that are at work at a time of the scenario."""
        if not self._from_ns <= t_ns < self._until_ns:
            edges = [edge for fault in self.rows for edge in (fault.row.start_ns, fault.row.end_ns)]
            self._from_ns = max((edge for edge in edges if edge <= t_ns), default=-NEVER_NS)
            self._until_ns = min((edge for edge in edges if edge > t_ns), default=NEVER_NS)
            self._at_work = [
                _AtWork(number, fault, fault.row.is_in_force(t_ns))
                for number, fault in enumerate(self.rows)
                if fault.acts_on(self.name) and fault.is_at_work(t_ns)
            ]
            self._only_delay = not self._has_message_rows and all(one.fault.delays for one in self._at_work)
        return self._at_work

    def _pass(self, frames: list[Frame], t_ns: int, rows: Sequence[_AtWork], delay_ns: int = 0) -> list[Frame]:
        """Apply rows to a frame and its copies. Return what continues at once; that is ``frames`` if none acted."""
        for number, fault, is_in_force in rows:
            if fault.is_of_one_message and not fault.concerns(self.name, frames[0].id):
                continue
            if not is_in_force:
                fault.remember(self.name, frames[0])
            elif fault.delays:
                delay_ns += fault.delay_ns()
            elif not fault.holds:
                frames = fault.changed(self.name, frames)
                if not frames:
                    return frames
            elif (overtaken := self._take_held(number)) is not None:
                fault.applied += 1
                behind = _behind(rows, number)
                return self._pass(frames, t_ns, behind, delay_ns) + self._pass(overtaken, t_ns, behind, delay_ns)
            elif fault.chance.random() < fault.row.value:
                self.hold(frames, fault.row.end_ns + self._time.offset_ns, Stage.HELD_BY_ROW, number)
                return []
        if not (delay_ns or self._delayed):
            return frames
        self._wait(frames, t_ns + delay_ns + self._time.offset_ns)
        return []

    def _delay(self, frames: Sequence[Frame], t_ns: int) -> Sequence[Frame]:
        """As ``pass_rows``, where all rows at work only delay: in a third of the time."""
        at_once: list[Frame] = []
        draws = [one.fault.delay_ns for one in self._at_work]
        clock_ns, exempt_from = t_ns + self._time.offset_ns, self._exempt_from
        for frame in frames:
            if frame.id >= exempt_from:
                at_once.append(frame)
                continue
            delay_ns = 0
            for draw in draws:
                delay_ns += draw()
            if delay_ns or self._delayed:
                self._wait([frame], clock_ns + delay_ns)
            else:
                at_once.append(frame)
        return at_once

    def _wait(self, frames: list[Frame], due_ns: int) -> None:
        """Queue frames for the delay of the rows. Nothing overtakes frames that already wait there."""
        if self._delayed and due_ns <= self._last_ns:
            self._last += frames
            return
        self._last, self._last_ns = frames, due_ns
        self._delayed += 1
        self.hold(frames, due_ns, Stage.DELAYED_BY_ROWS)

    def _take_held(self, row: int) -> list[Frame] | None:
        held = next((one for one in self._queue if one.stage is Stage.HELD_BY_ROW and one.row == row), None)
        if held is None:
            return None
        self._queue.remove(held)
        heapq.heapify(self._queue)
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS
        return list(held.frames)


def _behind(rows: Sequence[_AtWork], number: int) -> Sequence[_AtWork]:
    return [one for one in rows if one.number > number]
