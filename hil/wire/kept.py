"""A link and a clock whose session the journal of a recording keeps (``hil.record.journal``)."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.ports import Clock, Received
from hil.record.journal import Journal, Kind
from hil.wire.conditions import ConditionedLink


class KeptLink(ConditionedLink):
    """A link with its conditions, and a journal of what passes above them.

    ``session_clock`` is the clock that the session reads. Other arguments: ``ConditionedLink``.
    """

    def __init__(self, journal: Journal, session_clock: Clock, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.session_clock = session_clock
        self.is_plain = self.may_exchange = False  # the journal sees each frame
        self._journal = journal
        self._told: LinkError | None = None

    def send_all(self, frames: Sequence[Frame]) -> None:
        with self._keeping_loss():
            super().send_all(frames)
        self._journal.frames(Kind.SENT, self.clock.now_ns(), 0, frames)

    def receive(self, timeout_ns: int) -> Received | None:
        with self._keeping_loss():
            received = super().receive(timeout_ns)
        now_ns = self.clock.now_ns()
        if received is None:
            self._journal.add(Kind.EMPTY, now_ns)
        else:
            kind = Kind.ARRIVED if timeout_ns > 0 else Kind.RECEIVED
            self._journal.frames(kind, now_ns, received.stamp_ns, received.frames)
        return received

    def service(self, *, everything: bool = False) -> None:
        with self._keeping_loss():
            super().service(everything=everything)

    def hand_over_until(self, clock: Clock, t_ns: int) -> None:
        super().hand_over_until(self.clock, t_ns)  # these waits are the link's

    def reopen(self) -> None:
        with self._keeping_loss():
            super().reopen()

    @contextlib.contextmanager
    def _keeping_loss(self) -> Iterator[None]:
        """Keep the loss of the link in the journal, once where one call raises it through another."""
        try:
            yield
        except LinkError as error:
            if error is not self._told:
                self._told = error
                self._journal.add(Kind.LOST, self.clock.now_ns(), 0, str(error).encode("utf-8", "replace"))
            raise


class KeptClock:
    """The clock of a run in real time for its session and its loop: the journal has when it was read, and its waits."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock

    def now_ns(self) -> int:
        now_ns = self._clock.now_ns()
        self._journal.add(Kind.READ, now_ns)
        return now_ns

    def wait_until(self, t_ns: int) -> int:
        before_ns = self._clock.now_ns()
        late_ns = self._clock.wait_until(t_ns)
        self._journal.add(Kind.WAITED, before_ns, t_ns, (t_ns + late_ns).to_bytes(8, "little", signed=True))
        return late_ns
