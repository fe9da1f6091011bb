"""The line to a maker's controllers: frames between driver and link, and the question of who answers."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError
from hil.core.ports import Clock
from hil.drivers.makers_feedback import MotorsInfo
from hil.drivers.port import Driver
from hil.robot.handshake import RETRY_NS
from hil.robot.link_times import PollAge
from hil.robot.wire_hash import WireHash, pack_wide
from hil.wire.conditions import ConditionedLink

_MOST_A_POLL = 5000  # frames; four controllers at 1 kHz send forty in 10 ms
_ASK_NS = 20_000_000  # controllers that only answer count as lost after 250 ms, and some are asked in turn


class MotorLine:
    """Between a driver, which knows no link, and a link, which knows no driver.

    Every call may raise LinkError when the link is lost.

    Attributes:
        sent, received: number of frames so far.
        hash: of every frame, both directions, in order.
        info: what the controllers said of themselves; None before all have answered. It stays after ``restart``.
    """

    def __init__(self, link: ConditionedLink, driver: Driver, poll_age: PollAge, *, is_lockstep: bool) -> None:
        self._link = link
        self._driver = driver
        self._is_lockstep = is_lockstep
        self._poll_age = poll_age
        self.hash = WireHash(pack_wide, pack_wide)
        self._is_identified = False
        self._ask_again_ns = 0
        self.info: MotorsInfo | None = None
        self.sent = 0
        self.received = 0

    def restart(self, now_ns: int) -> None:
        """Ask again who is there."""
        self._is_identified = False
        self._ask_again_ns = now_ns

    def identify(self, now_ns: int) -> bool:
        """Return whether the controllers have said who they are, asking them when that is due.

        Raises BadInputError when they are not those of before ``restart``.
        """
        words = self._driver.identity
        if words is None:
            if now_ns >= self._ask_again_ns:
                self._ask_again_ns = now_ns + RETRY_NS
                self.send(self._driver.ask())
            return False
        if self.info is not None and self.info.words != words:
            raise BadInputError(
                f"another robot answers on the link: {words}; the run began with {self.info.words}; plug in the first "
                "one, or start a new run"
            )
        self.info = MotorsInfo(words)
        self._is_identified = True
        return True

    def ask_state(self, now_ns: int) -> None:
        """Ask identified controllers for their state, when that is due: many send only answers."""
        if self._is_identified and now_ns >= self._ask_again_ns:
            self._ask_again_ns = now_ns + _ASK_NS
            self.send(self._driver.ask())

    def send(self, frames: Sequence[Frame]) -> None:
        """Send frames, in order."""
        for frame in frames:
            self._link.send(frame)
            self.hash.sent(frame)
            self.sent += 1

    def flush(self) -> None:
        """Send at once what the link still delays."""
        self._link.flush()

    def take(self, clock: Clock) -> None:
        """Give the driver the frames that have arrived."""
        count = 0
        while (self._is_lockstep or count < _MOST_A_POLL) and (received := self._link.receive(0)) is not None:
            frames, stamp_ns = received
            for frame in frames:
                self.hash.received(frame)
                self._driver.feed(frame, stamp_ns)
            count += len(frames)
        self.received += count
        if not self._is_lockstep:
            self._poll_age.record_poll(clock.now_ns(), everything=count < _MOST_A_POLL)
        self.hash.keep_up()
