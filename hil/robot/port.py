"""The interface of a robot behind a link, for the control loop and the service. It fits every motor controller."""

import hashlib
import math
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import State
from hil.core.errors import DeviceError
from hil.core.ports import Clock
from hil.core.types import NAN, WheelCommand
from hil.robot.link_times import ClockSync, PollAge, RoundTrip
from hil.robot.robot_report import Health
from hil.robot.snapshot import Feedback
from hil.wire.conditions import ConditionedLink

_START_LIMIT_NS = 4_000_000_000

_HEADER = struct.Struct("<IH")  # 32-bit ids, and payloads of any length


class WireHash:
    """Hashes the frames that are sent to motor controllers of other makers, and those that are received.

    The caller leaves out frames whose number depends on the wall clock.
    """

    def __init__(self) -> None:
        self._sent, self._received = hashlib.sha256(), hashlib.sha256()

    def sent(self, frame: Frame) -> None:
        self._sent.update(_HEADER.pack(frame.id, len(frame.payload)) + frame.payload)

    def received(self, frame: Frame) -> None:
        self._received.update(_HEADER.pack(frame.id, len(frame.payload)) + frame.payload)

    def hexdigest(self) -> str:
        return hashlib.sha256(self._sent.digest() + self._received.digest()).hexdigest()


class Identity(Protocol):
    """What a robot reports about its identity."""

    @property
    def has_power_stage(self) -> bool:
        """Whether the robot drives real motors."""

    def describe(self) -> str:
        """Return a description for the user."""


class Report(Protocol):
    """What a robot reports besides its feedback."""

    @property
    def health(self) -> Health:
        """Battery and motor temperatures as the robot measures them."""

    def stop_reason(self) -> str:
        """Return why the robot last stopped, in terms of its protocol."""

    def explains(self, state: State) -> bool:
        """Return whether the robot has reported why it is in this state. The report may come after the feedback."""

    @property
    def knows_no_reason(self) -> bool:
        """Whether the robot reports that nothing has stopped it."""

    @property
    def last_reset(self) -> str:
        """The cause of the last reset in words; empty if the robot does not report one."""

    @property
    def trouble(self) -> str | None:
        """A warning that the user must see at once, such as a stop that could not be sent; None without one."""


class Line(Protocol):
    """Counts and hashes the frames of a device: ``sent`` and ``received`` are their numbers."""

    sent: int
    received: int
    hash: WireHash


class Device(ABC):
    """A robot at the other end of a link. Its states are those of our own protocol (PROTOCOL.md, "States").

    Every method may raise LinkError when the link is lost. A subclass sets ``_line``, through which its frames pass, or
    counts and hashes them itself.

    Attributes:
        report: what the robot reports besides its feedback.
        wait_until: waits until the clock shows a time; delayed frames are sent meanwhile. Returns the lateness [ns].
        step: lockstep: runs the robot for a number of 1 ms ticks, and processes what it sends.
        link_figures: returns ``sent``, ``received``, ``snapshots_lost`` and the newest of ``round_trip`` [ms], or NaN.
    """

    report: Report
    step: Callable[[int], None]
    _clock: Clock | None = None
    _line: Line
    _tick = 0

    def __init__(self, link: ConditionedLink, *, is_lockstep: bool) -> None:
        self._is_lockstep = is_lockstep
        self.clock_sync = ClockSync()
        self._link = link
        self._poll_age = PollAge()
        self._sequence = 0
        self.wait_until: Callable[[int], int] = self._wait_until
        self.link_figures: Callable[[], tuple[float, float, float, float]] = self._counts

    # Connecting

    @property
    def is_lockstep(self) -> bool:
        """Whether time advances only with ``step``."""
        return self._is_lockstep

    @abstractmethod
    def connect(self) -> Identity:
        """Identify the robot and check it against the scenario.

        Raises DeviceError when nothing answers, BadInputError when it does not match the scenario.
        """

    @property
    @abstractmethod
    def info(self) -> Identity | None:
        """The robot's identity; None before it is known."""

    @property
    def speed_limit_rad_s(self) -> float:
        """The largest wheel speed that the robot accepts as a command; infinity if it reports none."""
        return math.inf

    @property
    def overspeed_rad_s(self) -> float:
        """The wheel speed at which the robot stops itself; infinity if it reports none."""
        return math.inf

    @property
    @abstractmethod
    def warnings(self) -> Sequence[str]:
        """Warnings for the user before anything moves, for example that nothing stops the wheels if the host dies.

        Some are known only after ``connect``, and they may change when a robot comes back after a loss.
        """

    def describe_link(self) -> str:
        """Return a description of the link for the user."""
        return self._link.describe()

    # Reconnection after a loss, in steps that do not wait

    @property
    @abstractmethod
    def keeps_counts(self) -> bool:
        """Whether encoders keep counting while the link is lost, unless the robot was reset."""

    @abstractmethod
    def leave(self) -> None:
        """Stop commanding and discard all data, because the link or the robot was lost."""

    def reopen(self) -> None:
        """Close and reopen the link. Raises LinkError when that fails."""
        self._link.reopen()

    @abstractmethod
    def begin_again(self) -> None:
        """Start again with a robot that may have been reset or replaced meanwhile."""

    @abstractmethod
    def greeted(self) -> bool:
        """Return whether the robot has identified itself again. Raises BadInputError when it is another robot."""

    # Arming and stopping

    def attend(self, clock: Clock) -> None:
        """Set the clock of the run. Nothing is sent to the robot yet."""
        self._clock = clock
        if self._is_lockstep and not self._link.may_hold:
            self.wait_until = clock.wait_until

    def start(self, clock: Clock, period_ns: int) -> int:
        """Arm with zero commands; return the clock's time of the first ACTIVE tick [ns].

        Raises DeviceError when the robot refuses, has latched an error, or is not ACTIVE within 4 s.
        """
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
    def armed(self) -> bool:
        """Do one step of arming; return whether the robot is ACTIVE in our session. Raises as ``start`` does."""

    @abstractmethod
    def why_not_active(self) -> str:
        """Return why the robot does not become ACTIVE, and what to do."""

    @abstractmethod
    def disarm(self) -> None:
        """Start to ramp down to IDLE. Best effort: raises nothing."""

    @abstractmethod
    def estop(self) -> None:
        """Stop the robot at once and latch ESTOP. Repeat the call until the feedback reports ESTOP."""

    @abstractmethod
    def clear(self) -> None:
        """Request the end of a latched FAULT or ESTOP, until ``disarm`` is called. It does not arm."""

    @abstractmethod
    def stop(self, period_ns: int, limit_ns: int) -> bool:
        """Request IDLE and wait until the robot is at rest, at most ``limit_ns``; return whether it is."""

    @abstractmethod
    def close(self) -> None:
        """Stop the robot if it may still be driven. Best effort; closing twice is allowed."""

    # One tick

    def _wait_until(self, t_ns: int) -> int:
        clock, link = self._clock, self._link
        assert clock is not None
        if link.may_hold:
            link.hand_over_until(clock, t_ns)
        if not self._is_lockstep:
            self._receive_until(clock, t_ns)
        late_ns = clock.wait_until(t_ns)
        if link.may_hold:
            link.service()
        return late_ns

    def _receive_until(self, clock: Clock, t_ns: int) -> None:  # noqa: B027 - most devices have nothing to do here
        """Receive, in real time, what needs a time stamp of its own arrival, until ``t_ns`` at the latest."""

    @abstractmethod
    def poll(self) -> Feedback | None:
        """Read what has arrived; return the newest feedback. Call it once per tick: it also sends the heartbeat."""

    @property
    def poll_age_ns(self) -> int:
        """Upper bound on how long the data of the newest poll may have waited in the link; 0 in lockstep."""
        return self._poll_age.ns

    def _discard(self) -> None:
        self._poll_age.restart()
        self._link.discard()

    @property
    @abstractmethod
    def feedback(self) -> Feedback | None:
        """The newest feedback; None before the first, and after a loss until the next one."""

    @abstractmethod
    def send(self, command: WheelCommand) -> int:
        """Send a command after the guard; return its sequence number. Raises ValueError if it cannot be encoded."""

    @property
    def tick(self) -> int:
        """In lockstep: the firmware tick that the robot has reached."""
        return self._tick

    # Counters

    @property
    def round_trip(self) -> RoundTrip:
        """All round trips of commands."""
        return RoundTrip()

    @property
    def sent(self) -> int:
        """Number of frames sent so far."""
        return self._line.sent

    @property
    def received(self) -> int:
        """Number of frames received so far."""
        return self._line.received

    def _counts(self) -> tuple[float, float, float, float]:
        return self.sent, self.received, self.snapshots_lost, NAN

    def wire_sha256(self) -> str:
        """Return the hash of all frames of the session, in both directions and in order."""
        return self._line.hash.hexdigest()

    @property
    def snapshots_lost(self) -> int:
        """Number of snapshots that never came or came incomplete; 0 if the robot does not number them."""
        return 0

    def rejected(self) -> dict[str, int]:
        """Return the number of dropped frames, by cause; a cause that the robot reports begins with ``robot_``."""
        return {cause: count for cause, count in self._link.rejected().items() if count}
