"""The interfaces that the control loop uses: clock, link, control law, pose sources and sinks."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

from firmware_protocol.framing import Frame
from firmware_protocol.host_line import PackedFrames
from hil.core.types import Applied, MeasuredPose, Pairs, PoseFix, Reference, State, WheelCommand


class Received(NamedTuple):
    """Frames that arrived together (at least one, oldest first), and their time of arrival on the link's clock.

    On a byte stream all messages of a tick arrive at once. Handling them together takes a fifth of the time.
    """

    frames: Sequence[Frame]
    stamp_ns: int


EXTENDED, REMOTE = 0x8000_0000, 0x4000_0000
"""Flags in ``Frame.id`` of a CAN frame: 29-bit identifier, remote frame (as in Linux's ``struct can_frame``)."""


class Framing(Protocol):
    """Encodes and decodes frames on a byte stream. Invalid bytes are dropped and counted; they raise no exception."""

    @property
    def rejected(self) -> Mapping[str, int]:
        """Number of dropped pieces, by cause; ``lost`` counts frames that the other side sent and that never came."""

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire."""

    def feed(self, data: bytes) -> Sequence[Frame]:
        """Add received bytes, any number, and return the frames that they complete. The buffer is bounded."""


class Clock(Protocol):
    """The time of a run: wall-clock time in real time; in lockstep it advances with STEP messages."""

    def now_ns(self) -> int:
        """Return the time since the clock was made."""

    def wait_until(self, t_ns: int) -> int:
        """Wait until ``t_ns`` and return how much later it is [ns]."""


class Link(Protocol):
    """Carries frames to and from the other side. Bytes that are not a valid frame are counted; they raise nothing."""

    def send(self, frame: Frame) -> None:
        """Send one frame. Raises LinkError when the link is lost."""

    def receive(self, timeout_ns: int) -> Received | None:
        """Return valid frames that have arrived, or None after ``timeout_ns``; with 0 it does not wait.

        More frames may be left until it returns None. Raises LinkError when the link is lost.
        """

    def rejected(self) -> dict[str, int]:
        """Return the number of received frames dropped so far, by cause."""

    def reopen(self) -> None:
        """Close a lost link and open it again. Frames in transit are discarded; the counters continue.

        Raises LinkError when that fails; the call may be repeated.
        """

    def describe(self) -> str:
        """Return a description of the link for the user."""

    def close(self) -> None:
        """Release the link. Closing twice is allowed."""


@runtime_checkable
class PackedLink(Link, Protocol):
    """A link that also sends many frames of our own protocol in one call."""

    def send_packed(self, frames: PackedFrames) -> None:
        """Send frames, which must be messages of ours, in order. Raises LinkError when the link is lost."""


class Node(Protocol):
    """A firmware's end of the wire: it takes and gives bytes of a serial line, or CAN frames."""

    def feed(self, data: bytes) -> None:
        """Take bytes of a serial line."""

    def receive(self, frame: Frame) -> None:
        """Take one CAN frame."""

    def take_bytes(self) -> bytes:
        """Return all waiting output, as bytes of a serial line."""

    def take_frames(self) -> list[Frame]:
        """Return all waiting output, as frames."""

    def count_unsent(self, frames: int) -> None:
        """Count a number of frames that could not be sent."""


class Controller(Protocol):
    """A control law. It has no access to the clock, the link or the plant."""

    @property
    def gains(self) -> Pairs:
        """Gains of the last update, for telemetry, in the order of ``Gains``; NO_GAINS for a law without gains."""

    def reset(self, state: State, reference: Reference) -> None:
        """Reset all internal state and start from this state and reference."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command for this tick."""


class OwnSignals(Protocol):
    """A component with signals of its own, such as a law. They are recorded after ``hil.core.signals.SIGNALS``."""

    @property
    def signals(self) -> tuple[str, ...]:
        """The signal names, constant: dotted, with the unit at the end (``fuzzy.x.rule``, ``observer.x_m_s2``)."""

    @property
    def telemetry(self) -> tuple[float, ...]:
        """The signal values of the last update; NaN before the first."""


class PoseSource(Protocol):
    """A source of the true pose. It does not use the link to the robot."""

    def poll(self) -> PoseFix | None:
        """Return the newest fix, or None when there is none yet. Raises DeviceError when the source is lost."""

    def close(self) -> None:
        """Release the source."""


class FixSource(Protocol):
    """The robot's localisation (a lidar's, for example): pose fixes with delay and errors, not the true pose."""

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        """Return the fixes that have arrived since the last call, in order of arrival, without waiting.

        ``now_ns`` is the robot time of this call; ``truth`` is the newest true pose, which only a simulation uses.
        """

    def skip(self) -> None:
        """Called in place of ``poll`` in ticks that cannot use a fix: before the first tick or without the robot."""

    def restart(self) -> None:
        """Continue after a reset of the robot: its clock started again at zero."""

    def figures(self) -> Mapping[str, Any]:
        """Return the numbers of received and refused fixes, for the results of a run."""

    def close(self) -> None:
        """Release the source."""


class Sink(Protocol):
    """Receives samples. In real time it does not block; it drops and counts what it cannot accept."""

    def put(self, row: bytes) -> None:
        """Accept one row of doubles: one for each signal of the run that somebody reads, in their order."""


Note = Callable[[float, str, str], None]
"""Adds a line to a run's event log, without waiting: called with the scenario's time [s], the level (debug, info,
warning or error) and the text."""


class Event(NamedTuple):
    """A line of the event log; the level is DEBUG, INFO, WARN or ERROR, as rerun names it."""

    t_s: float
    level: str
    text: str
