"""The line to a maker's controllers: the driver's frames onto the link, what comes to the driver, and their account."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.ports import Clock
from hil.drivers.port import Driver
from hil.robot.link_times import PollAge
from hil.robot.wire_hash import WireHash, pack_wide
from hil.wire.conditions import ConditionedLink

_MOST_A_POLL = 5000  # frames; four controllers at 1 kHz send forty in 10 ms


class MotorLine:
    """Between a driver, that knows no link, and a link, that knows no driver.

    Every call may raise LinkError when the link is lost.

    Attributes:
        sent, received: frames so far.
    """

    def __init__(self, link: ConditionedLink, driver: Driver, *, is_lockstep: bool) -> None:
        self._link = link
        self._driver = driver
        self._is_lockstep = is_lockstep
        self._poll_age = PollAge()
        self._hash = WireHash(pack_wide, pack_wide)
        self.sent = 0
        self.received = 0

    def send(self, frames: Sequence[Frame]) -> None:
        """Send frames, in order."""
        for frame in frames:
            self._link.send(frame)
            self._hash.sent(frame)
            self.sent += 1

    def flush(self) -> None:
        """Hand over what the link holds: nobody will wait for it to be due."""
        self._link.flush()

    def take(self, clock: Clock) -> None:
        """Let the driver have what has arrived."""
        taken = 0
        while (self._is_lockstep or taken < _MOST_A_POLL) and (received := self._link.receive(0)) is not None:
            frames, stamp_ns = received
            for frame in frames:
                self._hash.received(frame)
                self._driver.feed(frame, stamp_ns)
            taken += len(frames)
        self.received += taken
        if not self._is_lockstep:
            self._poll_age.record_poll(clock.now_ns(), everything=taken < _MOST_A_POLL)
        self._hash.keep_up()

    def wait_until(self, clock: Clock, t_ns: int) -> int:
        """Let time pass, and hand over what becomes due. Returns the lateness [ns]."""
        if self._link.may_hold:
            self._link.hand_over_until(clock, t_ns)
        late_ns = clock.wait_until(t_ns)
        if self._link.may_hold:
            self._link.service()
        return late_ns

    def discard(self) -> None:
        """Forget what is held, in both directions: the link was lost."""
        self._poll_age.restart()
        self._link.discard()

    def reopen(self) -> None:
        """Close and open the link anew. Raises LinkError while that is not possible."""
        self._link.reopen()

    @property
    def poll_age_ns(self) -> int:
        """How long what was taken last may have lain on the link; 0 in lockstep."""
        return self._poll_age.ns

    def describe(self) -> str:
        """Return what the link is, in words for a person."""
        return self._link.describe()

    def wire_sha256(self) -> str:
        """Return the hash of every frame, both directions, in order."""
        return self._hash.hexdigest()

    def rejected(self) -> dict[str, int]:
        """Return the frames that were dropped, by cause."""
        return {cause: count for cause, count in self._link.rejected().items() if count}
