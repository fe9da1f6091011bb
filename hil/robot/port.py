"""What the tick, the loop and the service need of a robot behind a link, whatever its motors speak."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

from firmware_protocol.generated.messages import State
from hil.core.errors import DeviceError
from hil.core.ports import Clock
from hil.core.types import WheelCommand
from hil.robot.link_times import ClockSync, PollAge, RoundTrip
from hil.robot.robot_report import Health
from hil.robot.snapshot import Feedback
from hil.robot.wire_hash import WireHash
from hil.wire.conditions import ConditionedLink

_START_LIMIT_NS = 4_000_000_000


class Identity(Protocol):
    """What a robot said of itself."""

    @property
    def has_power_stage(self) -> bool:
        """Whether it drives real motors."""

    def describe(self) -> str:
        """Return what it is, in words."""


class Report(Protocol):
    """What a robot reports beside its feedback."""

    @property
    def health(self) -> Health:
        """Battery and motors as it measures them."""

    def stop_reason(self) -> str:
        """Return why the robot last stopped, in the terms of its protocol."""

    def explains(self, state: State) -> bool:
        """Return whether it has reported why it is in this state, which may come after the feedback."""

    @property
    def knows_no_reason(self) -> bool:
        """Whether it reports that nothing has stopped it."""

    @property
    def last_reset(self) -> str:
        """The cause of its last reset in words; empty where it does not report one."""

    @property
    def trouble(self) -> str | None:
        """A warning that a user has to see now, such as a stop that could not be sent; None without one."""


class Device(Protocol):
    """A robot at the other end of a link; states are those of our own protocol (PROTOCOL.md, "States").

    Every call may raise LinkError when the link is lost.
    """

    round_trip: RoundTrip
    clock_sync: ClockSync

    @property
    def tick(self) -> int:
        """In lockstep: the firmware tick that the robot has reached."""

    @property
    def report(self) -> Report:
        """What the robot reports beside its feedback."""

    # Connecting

    @property
    def is_lockstep(self) -> bool:
        """Whether robot time passes by ``step`` only, so that it stands still without the robot."""

    def connect(self) -> Identity:
        """Find out what is there, and check it against what the scenario expects.

        Raises DeviceError when nothing answers, BadInputError when it is not what was expected.
        """

    @property
    def info(self) -> Identity | None:
        """What the robot said of itself, None before it has."""

    @property
    def speed_limit_rad_s(self) -> float:
        """The largest wheel speed that the robot says it takes as a command; infinite where it says none."""

    @property
    def warnings(self) -> Sequence[str]:
        """Sentences to be said before anything moves, such as that nothing stops the wheels when the host dies.

        Some are known only once the robot has said what it is, and what comes back may be another one.
        """

    def describe_link(self) -> str:
        """Return what the link is, in words for a person."""

    # Coming back after a loss, in steps that do not wait

    @property
    def keeps_counts(self) -> bool:
        """Whether encoder counts have gone on while the robot was away, unless its clock began anew."""

    def leave(self) -> None:
        """Command nothing any more, and forget what is held: the link or the robot was lost."""

    def reopen(self) -> None:
        """Close and open the link anew. Raises LinkError while that is not possible."""

    def begin_again(self) -> None:
        """Begin with a robot that may have been reset meanwhile, or exchanged."""

    def greeted(self) -> bool:
        """Return whether it has said again what it is. Raises BadInputError when that is another robot."""

    # The way to ACTIVE and back

    def attend(self, clock: Clock) -> None:
        """Set the clock of the run; nothing is asked of the robot yet."""

    def start(self, clock: Clock, period_ns: int) -> int:
        """Arm and begin with zero commands; return the clock's time of the first ACTIVE tick [ns].

        Raises DeviceError when the robot refuses, has latched an error, or is not ACTIVE within 4 s.
        """

    def armed(self) -> bool:
        """Do one step of arming; return whether the robot is ACTIVE in our session. Raises as ``start``."""

    def why_not_active(self) -> str:
        """Return what keeps the robot from being driven, and what to do."""

    def disarm(self) -> None:
        """Begin to ramp down to IDLE, if it is not there; at best effort, never raises."""

    def estop(self) -> None:
        """Stop the robot at once and latch that; to be repeated until its feedback says ESTOP."""

    def clear(self) -> None:
        """Ask for the way out of a latched FAULT or ESTOP, until ``disarm``; arms nothing."""

    def stop(self, period_ns: int, limit_ns: int) -> bool:
        """Go to IDLE and wait for it, at most ``limit_ns`` on the clock; return whether the robot got there."""

    # One tick

    def wait_until(self, t_ns: int) -> int:
        """Let time pass on the clock. Returns the lateness [ns]."""

    def poll(self) -> Feedback | None:
        """Read what has arrived; return the newest feedback so far. Call it once a tick: it keeps the session alive."""

    @property
    def poll_age_ns(self) -> int:
        """Upper bound on the age of what the newest poll took: how long it may have lain on the link; 0 in lockstep."""

    @property
    def feedback(self) -> Feedback | None:
        """The newest feedback that was taken; None after a loss, until the next one."""

    def send(self, command: WheelCommand) -> int:
        """Send a command that the guard has passed; return its sequence. Raises ValueError for what cannot be sent."""

    def step(self, ticks: int) -> None:
        """Lockstep: let so many ticks of 1 ms pass, and take what the robot sends meanwhile."""

    # Accounts

    @property
    def sent(self) -> int:
        """Frames that were sent so far."""

    @property
    def received(self) -> int:
        """Frames that were received so far."""

    def wire_sha256(self) -> str:
        """Return the hash of every frame of the session, both directions, in order."""

    @property
    def snapshots_lost(self) -> int:
        """Feedback that the robot counted and that did not come whole; 0 where nothing is counted."""

    def rejected(self) -> dict[str, int]:
        """Return the frames that were dropped, by cause; those that the robot reported as ``robot_...``."""

    def close(self) -> None:
        """Stop what may still be driven, at once and at best effort. Closing twice is allowed."""


class Line(Protocol):
    """Counts and hashes the frames of a device: ``sent`` and ``received`` are their numbers."""

    sent: int
    received: int
    hash: WireHash


class LinkedDevice(ABC):
    """What all devices have in common: link, clock, counters, the wait for ACTIVE. ``Device`` documents the calls.

    A subclass sets ``_line``, through which its frames pass.
    """

    _clock: Clock | None = None
    _line: Line

    def __init__(self, link: ConditionedLink, *, is_lockstep: bool) -> None:
        self._is_lockstep = is_lockstep
        self.round_trip = RoundTrip()
        self.clock_sync = ClockSync()
        self._link = link
        self._poll_age = PollAge()
        self._sequence = 0

    @property
    def is_lockstep(self) -> bool:
        return self._is_lockstep

    def describe_link(self) -> str:
        return self._link.describe()

    def reopen(self) -> None:
        self._link.reopen()

    def attend(self, clock: Clock) -> None:
        self._clock = clock

    def start(self, clock: Clock, period_ns: int) -> int:
        self.attend(clock)
        begin_ns = clock.now_ns()
        try:
            for now_ns in range(begin_ns, begin_ns + _START_LIMIT_NS + 1, period_ns):
                self.wait_until(now_ns)
                if self.armed():
                    return now_ns
            raise DeviceError(self.why_not_active())
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def armed(self) -> bool: ...

    @abstractmethod
    def why_not_active(self) -> str: ...

    @abstractmethod
    def close(self) -> None: ...

    def wait_until(self, t_ns: int) -> int:
        """Let time pass on the clock; frames that the link delays go out meanwhile. Returns the lateness [ns]."""
        clock, link = self._clock, self._link
        assert clock is not None
        if link.may_hold:
            link.hand_over_until(clock, t_ns)
        self._receive_until(clock, t_ns)
        late_ns = clock.wait_until(t_ns)
        if link.may_hold:
            link.service()
        return late_ns

    def _receive_until(self, clock: Clock, t_ns: int) -> None:  # noqa: B027 - most devices have nothing to do here
        """Receive what needs a time stamp of its own arrival, until ``t_ns`` at the latest."""

    @property
    def poll_age_ns(self) -> int:
        return self._poll_age.ns

    def _discard(self) -> None:
        """Forget what the link holds, in both directions: the link was lost."""
        self._poll_age.restart()
        self._link.discard()

    @property
    def speed_limit_rad_s(self) -> float:
        return math.inf

    @property
    def sent(self) -> int:
        return self._line.sent

    @property
    def received(self) -> int:
        return self._line.received

    @property
    def snapshots_lost(self) -> int:
        return 0

    def wire_sha256(self) -> str:
        return self._line.hash.hexdigest()

    def rejected(self) -> dict[str, int]:
        return {cause: count for cause, count in self._link.rejected().items() if count}
