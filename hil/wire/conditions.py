"""The conditions of a link, directly above the transport: latency and faults of frames, in both directions.

A command passes the latency, then the fault rows, then the faults of the bus; feedback passes them in reverse order.
Each direction has one queue of delayed frames. An observer sees what crosses the wire, below all conditions.
"""

import heapq
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock, Link, Received
from hil.wire.faults import BusFaults, LinkFault, ScenarioTime
from hil.wire.statistics import LinkStatistics

_LATENCY = -1


class _Waiting(NamedTuple):
    """Frames in the queue of a direction, in the order in which they continue.

    ``place`` is the stage at which they wait: the latency before the rows, the row of that number (only ``reorder``
    holds frames), the delay of all rows, or the latency behind them. ``number`` is a running number in the queue.
    """

    due_ns: int
    place: int
    number: int
    frames: Sequence[Frame]


class _Way:
    """One direction: its fault rows, and the queue of delayed frames, by the time of the clock."""

    def __init__(self, direction: str, rows: Sequence[LinkFault], time: ScenarioTime) -> None:
        self.direction = direction
        self.rows = rows
        self.behind_rows = len(rows)
        self.latency_behind_rows = len(rows) + 1
        self._time = time
        self._queue: list[_Waiting] = []
        self._count = 0

    def hold(self, frames: Sequence[Frame], due_ns: int, place: int) -> None:
        """Delay frames until a time of the clock."""
        self._count += 1
        heapq.heappush(self._queue, _Waiting(due_ns, place, self._count, frames))

    def pass_rows(self, frames: list[Frame], t_ns: int, first: int = 0, delay_ns: int = 0) -> None:
        """Apply the rows from ``first`` on to a frame and its copies, at a time of the scenario; queue what comes
        out.
        """
        for place, fault in enumerate(self.rows[first:], first):
            if not frames:
                return
            if not fault.concerns(self.direction, frames[0].id):
                continue
            if not fault.row.is_in_force(t_ns):
                fault.notice(self.direction, frames[0], t_ns)
                continue
            if fault.kind != "reorder":
                delay_ns += fault.delay_ns()
                frames = fault.changed(self.direction, frames)
            elif (overtaken := self._remove_overtaken(place)) is not None:
                fault.applied += 1
                self.pass_rows(frames, t_ns, place + 1, delay_ns)
                self.pass_rows(overtaken, t_ns, place + 1, delay_ns)
                return
            elif fault.chance.random() < fault.row.value:
                self.hold(frames, self._time.on_clock_ns(fault.row.end_ns), place)
                return
        # Nothing overtakes frames that already wait behind the rows.
        waiting = (one.due_ns for one in self._queue if one.place == self.behind_rows)
        due_ns = max([self._time.on_clock_ns(t_ns + delay_ns), *waiting])
        for frame in frames:
            self.hold((frame,), due_ns, self.behind_rows)

    def _remove_overtaken(self, place: int) -> list[Frame] | None:
        """Return the frames that the row of this number holds, and remove them from the queue."""
        held = next((one for one in self._queue if one.place == place), None)
        if held is None:
            return None
        self._queue.remove(held)
        heapq.heapify(self._queue)
        return list(held.frames)

    def next_due_ns(self) -> int | None:
        """Return the clock time at which the next queued frames are due, or None when the queue is empty."""
        return self._queue[0].due_ns if self._queue else None

    def due(self, now_ns: int, t_ns: int | None, *, everything: bool = False) -> Iterator[_Waiting]:
        """Remove and yield what is due by now, in order; with ``everything`` also what is not yet due."""
        while self._queue and (everything or self._queue[0].due_ns <= now_ns):
            one = heapq.heappop(self._queue)
            if t_ns is not None and 0 <= one.place < self.behind_rows:  # nothing overtook it in the row's window
                end_ns = self.rows[one.place].row.end_ns
                self.pass_rows(list(one.frames), min(t_ns, end_ns), one.place + 1)
            else:
                yield one

    def forget(self, *, but_latency: bool = False) -> None:
        """Discard the queue; ``but_latency`` keeps what has not reached the rows yet."""
        self._queue = [one for one in self._queue if but_latency and one.place == _LATENCY]


class ConditionedLink:
    """A link with its conditions. Latency always acts; fault rows act only once the scenario's time has begun.

    Conditions do not apply to the frames of lockstep (``LinkProtocol.exempt_from``). ``service`` sends the commands
    that are due; ``next_due_ns`` says when to call it again. For a direction without conditions and observer, ``send``
    or ``receive`` is the transport's own method.

    Attributes:
        transport: the link below.
        is_plain: whether frames pass unchanged, at once and unobserved in both directions.
        may_hold: whether commands can be delayed at all; if not, nothing is ever due.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        *,
        command_latency_ns: int = 0,
        feedback_latency_ns: int = 0,
        faults: Sequence[LinkFault] = (),
        scenario_time: ScenarioTime | None = None,
        bus: BusFaults | None = None,
        observer: LinkStatistics | None = None,
        protocol: LinkProtocol = WHEEL_DBC,
    ) -> None:
        self._link = link
        self._clock = clock
        self._time = scenario_time or ScenarioTime(clock)
        self._command_latency_ns = command_latency_ns
        self._feedback_latency_ns = feedback_latency_ns
        self._bus = bus
        self._observer = observer
        self._exempt_from = protocol.exempt_from
        self._disconnects = [fault for fault in faults if fault.kind == "disconnect"]
        self._cut: LinkFault | None = None  # the row that cut the link
        rows = [fault for fault in faults if fault.kind != "disconnect"]
        self._has_rows = bool(faults)
        self._out = _Way("command", rows, self._time)
        self._in = _Way("feedback", rows, self._time)
        self._ready: deque[Received] = deque()
        self.may_hold = self._has_rows or command_latency_ns > 0
        is_bare = observer is None and bus is None
        self.transport = link
        self.is_plain = is_bare and not self.may_hold and not feedback_latency_ns
        self._put = link.send if is_bare else self._put_on_wire
        self._receive_now = link.receive if observer is None else self._receive_from_wire
        self.send = self._send if self.may_hold else self._put
        self.receive = self._receive if self._has_rows or bus is not None or feedback_latency_ns else self._receive_now

    def _put_on_wire(self, frame: Frame) -> None:
        if self._bus is not None:
            t_ns = self._time.now_ns()
            self._bus.babble(t_ns)
            if t_ns is not None and frame.id < self._exempt_from:
                frame = self._bus.sent(frame, t_ns)
        self._link.send(frame)
        if self._observer is not None:
            self._observer.sent(frame)

    def _receive_from_wire(self, timeout_ns: int) -> Received | None:
        received = self._link.receive(timeout_ns)
        if self._observer is not None:
            self._observer.received(received)
        return received

    # Commands

    def _send(self, frame: Frame) -> None:
        if frame.id >= self._exempt_from:
            self._put(frame)
        elif self._command_latency_ns:
            self._out.hold((frame,), self._clock.now_ns() + self._command_latency_ns, _LATENCY)
        else:
            self._enter(frame)
            self.service()

    def _enter(self, frame: Frame) -> None:
        """Apply the rows to a command. Raises LinkError while the link is cut."""
        t_ns = self._time.now_ns() if self._has_rows else None
        if t_ns is None:
            self._put(frame)
            return
        self._refuse_if_cut(t_ns)
        self._out.pass_rows([frame], t_ns)

    def service(self, *, everything: bool = False) -> None:
        """Send the commands that are due, or with ``everything`` all that wait."""
        if not self.may_hold:
            return
        t_ns = self._time.now_ns()
        if t_ns is not None and self._is_cut(t_ns):
            self._out.forget(but_latency=True)
        for one in self._out.due(self._clock.now_ns(), t_ns, everything=everything):
            for frame in one.frames:
                if one.place == _LATENCY:
                    self._enter(frame)
                else:
                    self._put(frame)

    def next_due_ns(self) -> int | None:
        """Return the clock time at which the next command is due, or None when none waits."""
        return self._out.next_due_ns()

    def hand_over_until(self, clock: Clock, t_ns: int) -> None:
        """Let time pass on the clock while a command becomes due before ``t_ns``, and send it."""
        self.service()
        while (due_ns := self.next_due_ns()) is not None and due_ns < t_ns:
            clock.wait_until(due_ns)
            self.service()

    def flush(self) -> None:
        """Send all waiting commands now, in order, because time will no longer pass for them."""
        self.service(everything=True)

    # Feedback

    def _receive(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            self._let_in()
            if self._ready:
                return self._ready.popleft()
            received = self._receive_now(timeout_ns)
            if received is None:
                return None
            self._admit(received)
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    def _admit(self, received: Received) -> None:
        """Apply the conditions to what came from the wire."""
        t_ns = self._time.now_ns()
        frames, stamp_ns = received
        if self._bus is not None:
            self._bus.babble(t_ns)
            if t_ns is not None:
                frames = [one for one in frames if one.id >= self._exempt_from or self._bus.arrives(one, t_ns)]
        if t_ns is not None and self._has_rows:
            for frame in frames:
                if frame.id >= self._exempt_from:
                    self._ready.append(Received((frame,), stamp_ns))
                elif not self._is_cut(t_ns):
                    self._in.pass_rows([frame], t_ns)
                    self._let_in()
        elif not self._feedback_latency_ns:
            if frames:
                self._ready.append(Received(frames, stamp_ns))
        else:
            if late := [frame for frame in frames if frame.id < self._exempt_from]:
                due_ns = self._clock.now_ns() + self._feedback_latency_ns
                self._in.hold(late, due_ns, self._in.latency_behind_rows)
            if at_once := [frame for frame in frames if frame.id >= self._exempt_from]:
                self._ready.append(Received(at_once, stamp_ns))

    def _let_in(self) -> None:
        """Make the feedback that is due available; its time stamp is when it was due."""
        now_ns, latency_ns = self._clock.now_ns(), self._feedback_latency_ns
        for one in self._in.due(now_ns, self._time.now_ns()):
            if one.place == self._in.latency_behind_rows:
                self._ready.append(Received(one.frames, one.due_ns))
            elif latency_ns:
                self._in.hold(one.frames, now_ns + latency_ns, self._in.latency_behind_rows)
            else:
                self._ready.append(Received(one.frames, now_ns))

    # The link itself

    def _is_cut(self, t_ns: int) -> bool:
        """Whether the link is lost. It stays so until it is reopened, even after the fault's window."""
        if self._disconnects and self._cut is None:
            self._cut = next((fault for fault in self._disconnects if fault.row.is_in_force(t_ns)), None)
        return self._cut is not None

    def _refuse_if_cut(self, t_ns: int) -> None:
        if self._is_cut(t_ns) and self._cut is not None:
            self._cut.applied += 1
            raise LinkError(f"the link was cut by the fault disconnect, seen at t = {t_ns * 1e-9:.3f} s")

    def discard(self) -> None:
        """Discard what waits: the link was lost, and an old command must not follow a new arming."""
        self._out.forget()
        self._in.forget()
        self._ready.clear()

    def reopen(self) -> None:
        """Reopen the link after it was lost, and discard what was on its way. Raises LinkError while it is cut."""
        self.discard()
        self._cut = None
        if (t_ns := self._time.now_ns()) is not None:
            self._refuse_if_cut(t_ns)
        self._link.reopen()
        if self._bus is not None:
            self._bus.reopen()

    def rejected(self) -> dict[str, int]:
        """Return the number of received frames dropped so far, by cause."""
        causes = self._link.rejected()
        own = {} if self._bus is None else self._bus.rejected
        return causes | {cause: causes.get(cause, 0) + count for cause, count in own.items()}

    def describe(self) -> str:
        """Return a description of the link, for a person."""
        return self._link.describe()

    def close(self) -> None:
        """Release the link. Closing twice is allowed."""
        if self._bus is not None:
            self._bus.close()
        self._link.close()
