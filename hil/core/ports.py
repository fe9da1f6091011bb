"""The ports of the house: what the tick needs, and nothing of how it is provided."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.core.types import Applied, Gains, MeasuredPose, PoseFix, Reference, State, WheelCommand


class Received(NamedTuple):
    """Frames that arrived together, at least one, oldest first, and when that was, on the clock of the link.

    A line of bytes brings all that a tick has to say at once: what is done once for them costs a fifth.
    """

    frames: Sequence[Frame]
    stamp_ns: int


EXTENDED, REMOTE = 0x8000_0000, 0x4000_0000
"""In ``Frame.id`` of a CAN frame: an identifier of 29 bits, a frame that asks for one (Linux, struct can_frame)."""


class Framing(Protocol):
    """Frames on a line of bytes, both ways. No byte raises: what is no valid frame is dropped and counted."""

    @property
    def rejected(self) -> Mapping[str, int]:
        """How many pieces were no frame, by cause; ``lost`` are frames that the other side counted and did not come."""

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire."""

    def feed(self, data: bytes) -> Sequence[Frame]:
        """Take bytes in pieces of any size, and return the frames that they complete. Memory is bounded."""


class Clock(Protocol):
    """Robot time passes only here: by the wall in real time, by STEP in lockstep."""

    def now_ns(self) -> int:
        """Return the time since the clock was made."""

    def wait_until(self, t_ns: int) -> int:
        """Return at ``t_ns`` or later, with the lateness [ns]."""


class Link(Protocol):
    """A way for frames to reach the other side; bytes that are not a valid frame are counted, never raised."""

    def send(self, frame: Frame) -> None:
        """Send one frame. Raises LinkError when the link is lost."""

    def receive(self, timeout_ns: int) -> Received | None:
        """Return valid frames that have arrived, or None after ``timeout_ns``; 0 never waits.

        There may be more: only None says that there was nothing left. Raises LinkError when the link is lost.
        """

    def rejected(self) -> dict[str, int]:
        """Return how many received frames were dropped so far, by cause."""

    def reopen(self) -> None:
        """Close the link and open it anew after it was lost; what was on its way is forgotten, counters go on.

        Raises LinkError while that is not possible; it may be tried again.
        """

    def describe(self) -> str:
        """Return what the link is, in words for a person."""

    def close(self) -> None:
        """Release the link. Closing twice is allowed."""


class Controller(Protocol):
    """A control law: pure, no clock, no link, no plant."""

    @property
    def gains(self) -> Gains:
        """Gains of the last update, for telemetry; NO_GAINS where the law has none."""

    def reset(self, state: State, reference: Reference) -> None:
        """Forget everything and start from this state and reference."""

    def update(self, reference: Reference, state: State, applied: Applied, dt_s: float) -> WheelCommand:
        """Return the command for this tick."""


class OwnSignals(Protocol):
    """What has signals of its own, recorded behind those of ``hil.core.signals.SIGNALS``. A law may be one."""

    @property
    def signals(self) -> tuple[str, ...]:
        """Their names, always the same: dotted, the unit at the end, as ``fuzzy.x.rule`` or ``observer.x_m_s2``."""

    @property
    def telemetry(self) -> tuple[float, ...]:
        """Their values as of the last update, NaN before the first."""


class PoseSource(Protocol):
    """Ground truth; never travels on the wheel link."""

    def poll(self) -> PoseFix | None:
        """Return the newest fix, or None when there is none yet. Raises DeviceError when the source is lost."""

    def close(self) -> None:
        """Release the source."""


class FixSource(Protocol):
    """A localisation of the robot's: pose fixes, late and with errors. Not the ground truth."""

    def poll(self, now_ns: int, truth: PoseFix | None) -> Sequence[MeasuredPose]:
        """Return the fixes that have arrived since the last call, in the order of their arrival; never waits.

        ``now_ns`` is the robot time of this call; ``truth`` is the newest, of which only a simulation makes use.
        """

    def skip(self) -> None:
        """Do a tick in which no fix can be used, before the first one or without the robot; never waits."""

    def restart(self) -> None:
        """Go on with a robot that was reset: its clock began anew."""

    def figures(self) -> Mapping[str, Any]:
        """Return what was received and what was refused, for the figures of a run."""

    def close(self) -> None:
        """Release the source."""


class Sink(Protocol):
    """Takes samples; in real time it never blocks, and counts what it had to drop."""

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row in the order of the run's signals: ``hil.core.signals.SIGNALS``, then the extra ones."""


class Note(Protocol):
    """Takes a line of a run's event log; never waits."""

    def __call__(self, t_s: float, level: str, text: str, /) -> None:
        """``t_s`` is the scenario's time [s], ``level`` debug, info, warning or error."""
