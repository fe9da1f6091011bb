"""Latency on robot time, set per direction; the same meaning in lockstep and in real time."""

import time
from collections import deque
from typing import Protocol

from firmware_protocol.framing import Frame
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock, Link, Received


class NowNs(Protocol):
    """The part of a clock that tells the time."""

    def now_ns(self) -> int: ...


class HoldingLink(Link, Protocol):
    """A link that may hold back what was sent for a while, and has to be looked after meanwhile."""

    may_hold: bool
    """Whether it ever does; where not, nothing is ever due."""

    def next_due_ns(self) -> int | None:
        """Return when the next held command is due, or None when none is held."""

    def service(self) -> None:
        """Hand over the commands that are due."""

    def flush(self) -> None:
        """Hand over everything that is held, in order: nobody will wait for it to be due."""

    def discard(self) -> None:
        """Forget what is held: the link was lost, and an old command must not follow a new arming."""


class DelayedLink:
    """Holds frames of either direction for a fixed time.

    A direction without latency is that of the link below, with no step between. ``service`` lets go what is due;
    ``next_due_ns`` says when it is to be called again. ``command_latency_ns`` counts from ``send`` to the hand-over to
    the link below, ``feedback_latency_ns`` from there to ``receive``.
    """

    def __init__(
        self,
        link: HoldingLink,
        clock: NowNs,
        command_latency_ns: int,
        feedback_latency_ns: int,
        protocol: LinkProtocol = WHEEL_DBC,
    ) -> None:
        self._link = link
        self._exempt_from = protocol.exempt_from
        self._clock = clock
        self._command_latency_ns = command_latency_ns
        self._feedback_latency_ns = feedback_latency_ns
        self.may_hold = link.may_hold or command_latency_ns > 0
        self._outgoing: deque[tuple[int, Frame]] = deque()
        self._incoming: deque[Received] = deque()
        self.send = self._send_late if command_latency_ns else link.send
        self.receive = self._receive_late if feedback_latency_ns else link.receive

    def _send_late(self, frame: Frame) -> None:
        if frame.id >= self._exempt_from:
            self._link.send(frame)
        else:
            self._outgoing.append((self._clock.now_ns() + self._command_latency_ns, frame))

    def next_due_ns(self) -> int | None:
        """Return when the next held command is due, or None when none is held."""
        below_ns = self._link.next_due_ns()
        if not self._outgoing:
            return below_ns
        return self._outgoing[0][0] if below_ns is None else min(below_ns, self._outgoing[0][0])

    def service(self) -> None:
        """Hand over the commands that are due."""
        if self._outgoing:
            now_ns = self._clock.now_ns()
            while self._outgoing and self._outgoing[0][0] <= now_ns:
                self._link.send(self._outgoing.popleft()[1])
        self._link.service()

    def hand_over_until(self, clock: Clock, t_ns: int) -> None:
        """Let time pass on the clock as long as something becomes due before then, and hand that over.

        Nothing ever does where the link never holds anything (``may_hold``).
        """
        self.service()
        while (due_ns := self.next_due_ns()) is not None and due_ns < t_ns:
            clock.wait_until(due_ns)
            self.service()

    def flush(self) -> None:
        """Hand over everything that is held, in order: nobody will wait for it to be due."""
        while self._outgoing:
            self._link.send(self._outgoing.popleft()[1])
        self._link.flush()

    def _receive_late(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            # What is due goes first, however the rest comes in: the order is then the same on every transport.
            if self._incoming and self._incoming[0].stamp_ns <= self._clock.now_ns():
                return self._incoming.popleft()
            received = self._link.receive(timeout_ns)
            if received is None:
                return None
            late = [frame for frame in received.frames if frame.id < self._exempt_from]
            if late:
                self._incoming.append(Received(late, self._clock.now_ns() + self._feedback_latency_ns))
            if len(late) < len(received.frames):
                at_once = [frame for frame in received.frames if frame.id >= self._exempt_from]
                return Received(at_once, received.stamp_ns)
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    def rejected(self) -> dict[str, int]:
        return self._link.rejected()

    def reopen(self) -> None:
        self.discard()
        self._link.reopen()

    def discard(self) -> None:
        """Forget what is held: the link was lost, and an old command must not follow a new arming."""
        self._outgoing.clear()
        self._incoming.clear()
        self._link.discard()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        self._link.close()
