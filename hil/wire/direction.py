"""One direction of a link under conditions: its fault rows, and one queue of delayed frames by the time of the clock.

Frames that are sent or arrive together stay together as long as no row that acts on them is in force.
"""

import heapq
from collections.abc import Sequence
from typing import NamedTuple

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import PackedFrames, split
from hil.faults.kind import NEVER_NS
from hil.wire.faults import LinkFault, ScenarioTime

LATENCY = -1
"""The place of frames that wait for the latency before the rows."""


class Waiting(NamedTuple):
    """Frames in the queue of a direction, in the order in which they continue.

    ``place`` is the stage at which they wait: the latency before the rows, the row of that number (only ``reorder``
    holds frames), the delay of all rows, or the latency behind them. ``number`` is a running number in the queue.
    """

    due_ns: int
    place: int
    number: int
    frames: Sequence[Frame]


class _AtWork(NamedTuple):
    """A fault row that acts on frames, or takes note of them before its window."""

    place: int
    fault: LinkFault
    is_in_force: bool


class Direction:
    """One direction of a link, "command" or "feedback", with its fault rows and delayed frames.

    Attributes:
        due_ns: clock time at which the next queued frames are due; NEVER_NS when the queue is empty.
    """

    def __init__(self, name: str, rows: Sequence[LinkFault], time: ScenarioTime, exempt_from: int) -> None:
        self.name = name
        self.rows = rows
        self.behind_rows = len(rows)
        self.latency_behind_rows = len(rows) + 1
        self.due_ns = NEVER_NS
        self._time = time
        self._exempt_from = exempt_from
        self._queue: list[Waiting] = []
        self._count = 0
        self._delayed = 0  # items in the queue that wait for the delay of all rows
        self._last_ns = 0  # when the last of them is due, and its frames
        self._last: list[Frame] = []
        self._has_message_rows = any(fault.is_of_one_message for fault in rows)
        # The rows that are at work from one edge of the rows' windows to the next.
        self._from_ns = self._until_ns = 0
        self._at_work: Sequence[_AtWork] = ()
        self._only_delay = False

    def hold(self, frames: Sequence[Frame], due_ns: int, place: int) -> None:
        """Delay frames until a time of the clock."""
        self._count += 1
        if place == self.behind_rows:
            self._delayed += 1
            self._last_ns = due_ns
        heapq.heappush(self._queue, Waiting(due_ns, place, self._count, frames))
        self.due_ns = self._queue[0].due_ns

    def apart(self, frames: Sequence[Frame]) -> tuple[Sequence[Frame] | None, Sequence[Frame] | None]:
        """Return the frames that conditions apply to, and those that are exempt, in their order; None for none."""
        limit = self._exempt_from
        if type(frames) is PackedFrames:
            return split(frames, limit)
        return [one for one in frames if one.id < limit] or None, [one for one in frames if one.id >= limit] or None

    def _rows_at(self, t_ns: int) -> Sequence[_AtWork]:
        """Return the rows that are at work at a time of the scenario."""
        if not self._from_ns <= t_ns < self._until_ns:
            edges = [edge for fault in self.rows for edge in (fault.row.start_ns, fault.row.end_ns)]
            self._from_ns = max((edge for edge in edges if edge <= t_ns), default=-NEVER_NS)
            self._until_ns = min((edge for edge in edges if edge > t_ns), default=NEVER_NS)
            self._at_work = [
                _AtWork(place, fault, fault.row.is_in_force(t_ns))
                for place, fault in enumerate(self.rows)
                if fault.acts_on(self.name) and fault.is_at_work(t_ns)
            ]
            self._only_delay = not self._has_message_rows and all(one.fault.delays for one in self._at_work)
        return self._at_work

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

    def _pass(self, frames: list[Frame], t_ns: int, rows: Sequence[_AtWork], delay_ns: int = 0) -> list[Frame]:
        """Apply rows to a frame and its copies. Return what continues at once; that is ``frames`` if none acted."""
        for place, fault, is_in_force in rows:
            if fault.is_of_one_message and not fault.concerns(self.name, frames[0].id):
                continue
            if not is_in_force:
                fault.note(self.name, frames[0])
            elif fault.delays:
                delay_ns += fault.delay_ns()
            elif fault.kind != "reorder":
                frames = fault.changed(self.name, frames)
                if not frames:
                    return frames
            elif (overtaken := self._remove_overtaken(place)) is not None:
                fault.applied += 1
                behind = _behind(rows, place)
                return self._pass(frames, t_ns, behind, delay_ns) + self._pass(overtaken, t_ns, behind, delay_ns)
            elif fault.chance.random() < fault.row.value:
                self.hold(frames, fault.row.end_ns + self._time.offset_ns, place)
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
        """Queue frames behind the rows. Nothing overtakes frames that already wait there."""
        if self._delayed and due_ns <= self._last_ns:
            self._last += frames
        else:
            self._last = frames
            self.hold(frames, due_ns, self.behind_rows)

    def _remove_overtaken(self, place: int) -> list[Frame] | None:
        """Return the frames that the row of this number holds, and remove them from the queue."""
        held = next((one for one in self._queue if one.place == place), None)
        if held is None:
            return None
        self._queue.remove(held)
        heapq.heapify(self._queue)
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS
        return list(held.frames)

    def pop_first(self, t_ns: int | None) -> Waiting:
        """Remove the first frames of the queue and return them, at a time of the scenario.

        Their ``frames`` are empty if rows, which they enter again, hold them.
        """
        one = heapq.heappop(self._queue)
        place = one.place
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS
        if place == self.behind_rows:
            self._delayed -= 1
        elif t_ns is not None and 0 <= place < self.behind_rows:  # nothing overtook it in the row's window
            left_ns = min(t_ns, self.rows[place].row.end_ns)
            at_once = self._pass(list(one.frames), left_ns, _behind(self._rows_at(left_ns), place))
            return Waiting(one.due_ns, self.behind_rows, one.number, at_once)
        return one

    def forget(self, *, but_latency: bool = False) -> None:
        """Discard the queue; ``but_latency`` keeps what has not reached the rows yet."""
        self._queue = [one for one in self._queue if but_latency and one.place == LATENCY]
        self._delayed = 0
        self.due_ns = self._queue[0].due_ns if self._queue else NEVER_NS


def _behind(rows: Sequence[_AtWork], place: int) -> Sequence[_AtWork]:
    """Return the rows behind that of a number."""
    return [one for one in rows if one.place > place]
