"""Latency on robot time, set per direction; the same meaning in lockstep and in real time."""

from collections import deque
from typing import Protocol

from firmware_protocol.framing import Frame
from hil.ports import Link, Received

# STEP, STEP_DONE and the HELLO pages carry no control: conditions of the link do not touch them.
FIRST_EXEMPT_ID = 0x300


class NowNs(Protocol):
    """The part of a clock that tells the time."""

    def now_ns(self) -> int: ...


class DelayedLink:
    """Holds frames of either direction for a fixed time.

    ``service`` lets go what is due; ``next_due_ns`` says when it is to be called again. ``command_latency_ns`` counts
    from ``send`` to the hand-over to the link below, ``feedback_latency_ns`` from there to ``receive``.
    """

    def __init__(self, link: Link, clock: NowNs, command_latency_ns: int, feedback_latency_ns: int) -> None:
        self._link = link
        self._clock = clock
        self._command_latency_ns = command_latency_ns
        self._feedback_latency_ns = feedback_latency_ns
        self._outgoing: deque[tuple[int, Frame]] = deque()
        self._incoming: deque[Received] = deque()
        self._exempt: deque[Received] = deque()

    def send(self, frame: Frame) -> None:
        if frame.id >= FIRST_EXEMPT_ID or not self._command_latency_ns:
            self._link.send(frame)
        else:
            self._outgoing.append((self._clock.now_ns() + self._command_latency_ns, frame))

    def next_due_ns(self) -> int | None:
        """Return when the next held command is due, or None when none is held."""
        return self._outgoing[0][0] if self._outgoing else None

    def service(self) -> None:
        """Hand over the commands that are due."""
        now_ns = self._clock.now_ns()
        while self._outgoing and self._outgoing[0][0] <= now_ns:
            self._link.send(self._outgoing.popleft()[1])

    def flush(self) -> None:
        """Hand over everything that is held, in order: nobody will wait for it to be due."""
        while self._outgoing:
            self._link.send(self._outgoing.popleft()[1])

    def receive(self, timeout_ns: int) -> Received | None:
        if not self._feedback_latency_ns:
            return self._link.receive(timeout_ns)
        if self._exempt:
            return self._exempt.popleft()
        while (received := self._link.receive(0 if self._incoming else timeout_ns)) is not None:
            if received.frame.id >= FIRST_EXEMPT_ID:
                self._exempt.append(received)
                break
            self._incoming.append(Received(received.frame, self._clock.now_ns() + self._feedback_latency_ns))
        if self._exempt:
            return self._exempt.popleft()
        if self._incoming and self._incoming[0].stamp_ns <= self._clock.now_ns():
            return self._incoming.popleft()
        return None

    def rejected(self) -> dict[str, int]:
        return self._link.rejected()

    def reopen(self) -> None:
        self.discard()
        self._link.reopen()

    def discard(self) -> None:
        """Forget what is held: the link was lost, and an old command must not follow a new arming."""
        self._outgoing.clear()
        self._incoming.clear()
        self._exempt.clear()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        self._link.close()
