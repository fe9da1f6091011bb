"""The conditions of a link, directly above the transport: latency and faults of frames, in both directions.

A command passes the latency, then the fault rows, then the faults of the bus; feedback passes them in reverse order.
Each direction (``direction.py``) has one queue of delayed frames. An observer sees the wire, below all conditions.
"""

import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import PackedFrames
from hil.core.errors import LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock, Link, PackedLink, Received
from hil.faults.rows import NEVER_NS, ScenarioTime
from hil.wire.direction import Direction, Stage
from hil.wire.link import DirectTransport
from hil.wire.link_statistics import LinkStatistics

if TYPE_CHECKING:
    from hil.faults.link_faults import LinkFault
    from hil.wire.byte_faults import BusFaults


class ConditionedLink:
    """A link with its conditions. Latency always acts; fault rows act only once the scenario's time has begun.

    Conditions do not apply to the frames of lockstep (``LinkProtocol.exempt_from``). ``service`` sends the commands
    that are due; ``next_due_ns`` says when to call it again.

    Attributes:
        transport: the link below.
        clock: the clock of the run; ``session_clock`` is the same, for who uses the link.
        is_plain: whether frames pass unchanged, at once and unobserved in both directions.
        may_hold: whether commands can be delayed at all; if not, nothing is ever due.
        may_exchange: whether ``exchange`` may be called.
    """

    def __init__(
        self,
        link: Link,
        clock: Clock,
        *,
        command_latency_ns: int = 0,
        feedback_latency_ns: int = 0,
        faults: "Sequence[LinkFault]" = (),
        scenario_time: ScenarioTime | None = None,
        bus: "BusFaults | None" = None,
        observer: LinkStatistics | None = None,
        protocol: LinkProtocol = WHEEL_DBC,
    ) -> None:
        self.transport = link
        self.clock = self.session_clock = clock
        self._time = scenario_time or ScenarioTime(clock)
        self._command_latency_ns = command_latency_ns
        self._feedback_latency_ns = feedback_latency_ns
        self._bus = bus
        self._observer = observer
        self._exempt_from = protocol.exempt_from
        self._cutting = [fault for fault in faults if fault.cuts]
        self._cut: LinkFault | None = None  # the row that cut the link
        rows = [fault for fault in faults if not fault.cuts]
        self._has_rows = bool(faults)
        self._is_timed = self._has_rows or bus is not None  # whether anything depends on the scenario's time
        self._out = Direction("command", rows, self._time, protocol.exempt_from)
        self._in = Direction("feedback", rows, self._time, protocol.exempt_from)
        self._ready: deque[Received] = deque()
        acts_out, acts_in = (any(fault.acts_on(name) for fault in faults) for name in ("command", "feedback"))
        self.may_hold = acts_out or command_latency_ns > 0
        self._changes_feedback = acts_in or bus is not None or feedback_latency_ns > 0
        self.is_plain = not (observer or bus or self.may_hold or self._changes_feedback)
        self.may_exchange = True
        self._send_packed = link.send_packed if isinstance(link, PackedLink) and bus is None else None

    def _put(self, frames: Sequence[Frame]) -> None:
        if type(frames) is PackedFrames and self._send_packed is not None:
            self._send_packed(frames)
            if self._observer is not None:
                self._observer.sent(frames)
            return
        for frame in frames:
            if self._bus is not None:
                frame = self._sent_over(self._bus, frame)
            self.transport.send(frame)
            if self._observer is not None:
                self._observer.sent((frame,))

    def _sent_over(self, bus: "BusFaults", frame: Frame) -> Frame:
        t_ns = self._time.now_ns()
        bus.send_foreign(t_ns)
        return frame if t_ns is None or frame.id >= self._exempt_from else bus.sent(frame, t_ns)

    def _receive_from_wire(self, timeout_ns: int) -> Received | None:
        received = self.transport.receive(timeout_ns)
        if self._observer is not None:
            self._observer.received(received)
        return received

    # Commands

    def send(self, frame: Frame) -> None:
        """Send a frame. Raises LinkError when the link is lost."""
        self.send_all((frame,))

    def send_all(self, frames: Sequence[Frame]) -> None:
        """Send frames, in order. Raises LinkError when the link is lost."""
        self._send(frames)

    def _send(self, frames: Sequence[Frame]) -> None:
        if not self.may_hold:
            self._put(frames)
            return
        delayed, exempt = self._out.apart(frames)
        if exempt is not None:
            if delayed is None:
                self._put(frames)
                return
            for frame in frames:  # in their order
                self._send((frame,))
        elif self._command_latency_ns:
            self._out.hold(frames, self.clock.now_ns() + self._command_latency_ns, Stage.LATENCY_BEFORE_ROWS)
        else:
            self.service()
            self._enter(frames)

    def _enter(self, frames: Sequence[Frame]) -> None:
        """Apply the rows to commands. Raises LinkError while the link is cut."""
        if (t_ns := self._time.now_ns()) is not None:
            self._refuse_if_cut(t_ns)
            frames = self._out.pass_rows(frames, t_ns)
        self._put(frames)

    def service(self, *, everything: bool = False) -> None:
        """Send the commands that are due, or with ``everything`` all that wait."""
        now_ns, way = self.clock.now_ns(), self._out
        if way.due_ns > now_ns and not (everything or self._cutting):
            return
        t_ns = self._time.at(now_ns) if self._is_timed else None
        if t_ns is not None and self._is_cut(t_ns):
            way.forget(but_latency=True)
        until_ns = NEVER_NS - 1 if everything else now_ns
        while way.due_ns <= until_ns:
            first = way.pop_first(t_ns)
            if first.stage is Stage.LATENCY_BEFORE_ROWS and self._has_rows:
                self._enter(first.frames)
            else:
                self._put(first.frames)

    def next_due_ns(self) -> int | None:
        """Return the clock time at which the next command is due, or None when none waits."""
        return None if self._out.due_ns == NEVER_NS else self._out.due_ns

    def hand_over_until(self, clock: Clock, t_ns: int) -> None:
        """Send the commands that become due before ``t_ns``, each when the clock has reached its time.

        In lockstep a command that is due within the last tick before ``t_ns`` is sent at ``t_ns``.
        """
        if self._cutting:
            self.service()
        while self._out.due_ns < t_ns:
            before_ns = clock.now_ns()
            clock.wait_until(self._out.due_ns)
            if clock.now_ns() == before_ns:
                return
            self.service()

    def flush(self) -> None:
        """Send all waiting commands now, in order, because time will no longer pass for them."""
        self.service(everything=True)

    # Feedback

    def exchange(self, transport: DirectTransport, ticks: int) -> deque[Received]:
        """Have a robot that answers at once make a STEP; return what ``receive`` would return now.

        The client's other frames must have been sent. ``receive`` returns later what the caller leaves in the result.
        """
        now_ns = self.clock.now_ns()
        if self._in.due_ns <= now_ns:
            self._let_in(now_ns)
        answer = transport.exchange(ticks)
        if self._observer is not None:
            self._observer.exchanged(*transport.crossed(), now_ns)
        if answer.packed:
            self._admit(answer, now_ns, now_ns)
        return self._ready

    def receive(self, timeout_ns: int) -> Received | None:
        """Return frames that arrived together, waiting at most ``timeout_ns`` for them. Raises LinkError when lost."""
        if not self._changes_feedback:
            return self._receive_from_wire(timeout_ns)
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            now_ns = self.clock.now_ns()
            if self._in.due_ns <= now_ns:
                self._let_in(now_ns)
            if self._ready:
                return self._ready.popleft()
            received = self._receive_from_wire(timeout_ns)
            if received is None:
                return None
            self._admit(*received, self.clock.now_ns())
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    def _admit(self, frames: Sequence[Frame], stamp_ns: int, now_ns: int) -> None:
        t_ns = self._time.at(now_ns) if self._is_timed else None
        if self._bus is not None:
            frames = self._undamaged(self._bus, frames, t_ns)
            if not frames:
                return
        late: Sequence[Frame] | None = None
        at_once: Sequence[Frame] | None = frames
        is_cut = bool(self._cutting) and t_ns is not None and self._is_cut(t_ns)
        if self._feedback_latency_ns or is_cut:
            late, at_once = self._in.apart(frames)
        if is_cut:
            late = None
        elif self._in.rows and t_ns is not None:
            if late is not None:
                late = self._in.pass_rows(late, t_ns) or None
            elif not self._feedback_latency_ns:
                at_once = self._in.pass_rows(frames, t_ns) or None
        if at_once is not None:
            self._add_ready(at_once, stamp_ns)
        if late is not None:
            self._in.hold(late, now_ns + self._feedback_latency_ns, Stage.LATENCY_BEHIND_ROWS)

    def _add_ready(self, frames: Sequence[Frame], stamp_ns: int) -> None:
        """Make frames available, together with those of the same time before them."""
        ready = self._ready
        if ready and ready[-1].stamp_ns == stamp_ns:
            before = ready.pop().frames
            if type(before) is PackedFrames and type(frames) is PackedFrames:
                frames = PackedFrames(before.packed + frames.packed)
            else:
                frames = [*before, *frames]
        ready.append(Received(frames, stamp_ns))

    def _undamaged(self, bus: "BusFaults", frames: Sequence[Frame], t_ns: int | None) -> Sequence[Frame]:
        bus.send_foreign(t_ns)
        return [one for one in frames if t_ns is None or one.id >= self._exempt_from or bus.arrives(one, t_ns)]

    def _let_in(self, now_ns: int) -> None:
        """Make the feedback that is due available; its time stamp is when it was due."""
        latency_ns, way = self._feedback_latency_ns, self._in
        t_ns = self._time.at(now_ns) if self._is_timed else None
        while way.due_ns <= now_ns:
            first = way.pop_first(t_ns)
            if first.stage is Stage.LATENCY_BEHIND_ROWS:
                self._ready.append(Received(first.frames, first.due_ns))
            elif not first.frames:  # they wait again
                continue
            elif latency_ns:
                way.hold(first.frames, now_ns + latency_ns, Stage.LATENCY_BEHIND_ROWS)
            else:
                self._ready.append(Received(first.frames, now_ns))

    # The link itself

    def _is_cut(self, t_ns: int) -> bool:
        """Whether the link is lost. It stays so until it is reopened, even after the fault's window."""
        if self._cutting and self._cut is None:
            self._cut = next((fault for fault in self._cutting if fault.row.is_in_force(t_ns)), None)
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
        """Reopen the link after it was lost, and discard the frames on their way. Raises LinkError while it is cut."""
        self.discard()
        self._cut = None
        if (t_ns := self._time.now_ns()) is not None:
            self._refuse_if_cut(t_ns)
        self.transport.reopen()
        if self._bus is not None:
            self._bus.reopen()

    def rejected(self) -> dict[str, int]:
        """Return the number of received frames dropped so far, by cause."""
        causes = self.transport.rejected()
        own = {} if self._bus is None else self._bus.rejected()
        return causes | {cause: causes.get(cause, 0) + count for cause, count in own.items()}

    def describe(self) -> str:
        return self.transport.describe()

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
        self.transport.close()
