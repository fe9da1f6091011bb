"""Faults of whole frames: a link that loses, delays, doubles, swaps, mutes and repeats them, or is lost itself."""

import heapq
import itertools
import time
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link, Received
from hil.wire.fault_rows import LinkFault, ScenarioTime

TICK_NS = 1_000_000


class _Held(NamedTuple):
    """A frame that waits for its time; ``number`` keeps the order of those that are due at once."""

    due_ns: int
    number: int
    frame: Frame


class _Way:
    """One direction: what is held back, and what each row remembers of it."""

    def __init__(self, direction: str, faults: Sequence[LinkFault]) -> None:
        self.direction = direction
        self.faults = [fault for fault in faults if fault.kind != "disconnect"]
        self.held: list[_Held] = []
        self._numbers = itertools.count()
        self._bad: set[LinkFault] = set()  # burst_loss in its bad state
        self._overtaken: dict[LinkFault, list[Frame]] = {}  # what reorder holds until the next frame
        self._newest: dict[tuple[LinkFault, int], Frame] = {}  # what freeze repeats

    def take(self, frame: Frame, t_ns: int) -> None:
        """Take a frame that is not exempt; what becomes of it is in ``held``."""
        self._pass([frame], 0, t_ns)

    def _pass(self, frames: list[Frame], first: int, t_ns: int, delay_ns: int = 0) -> None:
        """Let a frame and its copies pass the rows from the one numbered ``first`` on."""
        for place, fault in enumerate(self.faults[first:], first):
            if not frames:
                return
            if not fault.concerns(self.direction, frames[0].id):
                continue
            if fault.kind == "freeze" and t_ns < fault.row.start_ns:
                self._newest[fault, frames[0].id] = frames[0]
            if not fault.row.is_in_force(t_ns):
                continue
            if fault.kind in ("delay", "jitter"):
                delay_ns += self._delay_ns(fault)
            elif fault.kind == "reorder" and fault in self._overtaken:
                fault.applied += 1
                self._pass(frames, place + 1, t_ns, delay_ns)
                self._pass(self._overtaken.pop(fault), place + 1, t_ns, delay_ns)
                return
            elif fault.kind == "reorder":
                if fault.chance.random() < fault.row.value:
                    self._overtaken[fault] = frames
                    return
            else:
                frames = self._changed(fault, frames)
        for one in frames:
            self._hold(one, t_ns + delay_ns)

    def _changed(self, fault: LinkFault, frames: list[Frame]) -> list[Frame]:
        """Return what a row makes of a frame and its copies."""
        match fault.kind:
            case "drop":
                return [] if fault.strikes() else frames
            case "duplicate":
                return frames * 2 if fault.strikes() else frames
            case "burst_loss":
                return [] if self._bursts(fault) else frames
            case "mute":
                fault.applied += 1
                return []
            case "freeze":
                old = self._newest.get((fault, frames[0].id))
                fault.applied += old is not None
                return frames if old is None else [old] * len(frames)
        return frames

    def _bursts(self, fault: LinkFault) -> bool:
        """Go on to the next state of the Gilbert-Elliott chain; tell whether it is the bad one."""
        share, length = fault.row.value, fault.row.burst_frames
        probability = 1.0 - 1.0 / length if fault in self._bad else share / (length * (1.0 - share))
        if fault.chance.random() < probability:
            self._bad.add(fault)
            fault.applied += 1
            return True
        self._bad.discard(fault)
        return False

    @staticmethod
    def _delay_ns(fault: LinkFault) -> int:
        seconds = fault.row.value * (fault.chance.random() if fault.kind == "jitter" else 1.0)
        ticks = -(-round(seconds * 1e9) // TICK_NS)  # robot time has no finer grain in lockstep
        fault.applied += ticks > 0
        return ticks * TICK_NS

    def _hold(self, frame: Frame, due_ns: int) -> None:
        """Let a frame wait; it does not overtake those that wait already."""
        due_ns = max(due_ns, max((held.due_ns for held in self.held), default=due_ns))
        heapq.heappush(self.held, _Held(due_ns, next(self._numbers), frame))

    def forget(self) -> None:
        """Lose what is held."""
        self.held.clear()
        self._overtaken.clear()

    def next_due_ns(self) -> int | None:
        """Return when the next frame that is held has to go on, or None when none is held."""
        ends = [fault.row.end_ns for fault in self._overtaken]
        if self.held:
            ends.append(self.held[0].due_ns)
        return min(ends, default=None)

    def due(self, t_ns: int, *, everything: bool = False) -> list[Frame]:
        """Return what has to go on, in order; with ``everything`` also what has time left."""
        for place, fault in enumerate(self.faults):
            if fault in self._overtaken and (everything or fault.row.end_ns <= t_ns):
                self._pass(self._overtaken.pop(fault), place + 1, min(t_ns, fault.row.end_ns))
        frames = []
        while self.held and (everything or self.held[0].due_ns <= t_ns):
            frames.append(heapq.heappop(self.held).frame)
        return frames


class FaultLink:
    """Applies faults to the frames of a link. Time is the scenario's, so nothing happens before that has begun.

    ``service`` lets go what is due of what is held on its way out; ``next_due_ns`` says when it is to be called again.
    Without faults it sends and receives as the link below, with no step between.
    """

    def __init__(
        self, link: Link, time: ScenarioTime, faults: Sequence[LinkFault], protocol: LinkProtocol = WHEEL_DBC
    ) -> None:
        self._link = link
        self._time = time
        self._exempt_from = protocol.exempt_from
        self.may_hold = bool(faults)
        self._disconnects = [fault for fault in faults if fault.kind == "disconnect"]
        self._out = _Way("command", faults)
        self._in = _Way("feedback", faults)
        self._ready: deque[Received] = deque()
        self._cut: LinkFault | None = None  # that the link was lost by
        self.send = self._send_through if faults else link.send
        self.receive = self._receive_through if faults else link.receive

    def _send_through(self, frame: Frame) -> None:
        t_ns = self._time.now_ns()
        if t_ns is None or frame.id >= self._exempt_from:
            self._link.send(frame)
            return
        self._refuse_if_cut(t_ns)
        self._out.take(frame, t_ns)
        self._let_go(t_ns)

    def _receive_through(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            t_ns = self._time.now_ns()
            if t_ns is not None:
                self._take_due(t_ns)
            if self._ready:
                return self._ready.popleft()
            received = self._link.receive(timeout_ns)
            if received is None or t_ns is None:
                return received
            for frame in received.frames:
                self._admit(frame, received.stamp_ns, t_ns)
            if self._ready:
                return self._ready.popleft()
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    def _admit(self, frame: Frame, stamp_ns: int, t_ns: int) -> None:
        """Take a frame of the robot's; what is to go on by now is ready."""
        if frame.id >= self._exempt_from:
            self._ready.append(Received((frame,), stamp_ns))
        elif not self._is_cut(t_ns):
            self._in.take(frame, t_ns)
            self._take_due(t_ns)

    def _take_due(self, t_ns: int) -> None:
        self._ready.extend(Received((frame,), self._time.on_clock_ns(t_ns)) for frame in self._in.due(t_ns))

    def next_due_ns(self) -> int | None:
        """Return when, on the clock, the next held command is due, or None when none is held."""
        due_ns = self._out.next_due_ns()
        return None if due_ns is None else self._time.on_clock_ns(due_ns)

    def service(self, *, everything: bool = False) -> None:
        """Hand over the commands that are due, or with ``everything`` all that are held."""
        t_ns = self._time.now_ns() if self.may_hold else None
        if t_ns is not None:
            self._let_go(t_ns, everything=everything)

    def flush(self) -> None:
        """Hand over everything that is held, in order: nobody will wait for it to be due."""
        self.service(everything=True)

    def discard(self) -> None:
        """Forget what is held, in both directions."""
        self._out.forget()
        self._in.forget()
        self._ready.clear()

    def reopen(self) -> None:
        """Open the link anew after a disconnect; what was on its way is forgotten. Raises LinkError while it lasts."""
        t_ns = self._time.now_ns()
        self._cut = None
        if t_ns is not None:
            self._refuse_if_cut(t_ns)
        self.discard()
        self._link.reopen()

    def rejected(self) -> dict[str, int]:
        return self._link.rejected()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        self._link.close()

    def _let_go(self, t_ns: int, *, everything: bool = False) -> None:
        if self._is_cut(t_ns):
            self._out.forget()
        for frame in self._out.due(t_ns, everything=everything):
            self._link.send(frame)

    def _is_cut(self, t_ns: int) -> bool:
        """Tell whether the link is lost: a cable that was pulled has to be opened again, also when it is back."""
        if self._disconnects and self._cut is None:
            self._cut = next((fault for fault in self._disconnects if fault.row.is_in_force(t_ns)), None)
        return self._cut is not None

    def _refuse_if_cut(self, t_ns: int) -> None:
        if self._is_cut(t_ns) and self._cut is not None:
            self._cut.applied += 1
            raise LinkError(f"the link was cut by the fault disconnect, seen at t = {t_ns * 1e-9:.3f} s")
