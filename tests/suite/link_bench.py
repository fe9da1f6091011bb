"""Links without a robot behind them: frames to send, rows of faults, and a clock that is set by hand."""

from typing import Any

from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from hil.core.ports import Link
from hil.faults.rows import FaultRow, ScenarioTime

MS = 1_000_000
STEP = Frame(m.Step.ID, m.Step(0, 1).encode())
STEP_DONE = Frame(m.StepDone.ID, m.StepDone(1).encode())
BEAT = Frame(m.HostHeartbeat.ID, m.HostHeartbeat(1, 2, m.Request.IDLE, m.Mode.SPEED, 3).encode())


class Clock:
    """A clock that is set by hand."""

    now = 0

    def now_ns(self) -> int:
        """Return the time [ns]."""
        return self.now

    def wait_until(self, t_ns: int) -> int:
        """Go on to this time [ns]."""
        self.now = max(self.now, t_ns)
        return 0


def begun(clock: Clock, at_ns: int = 0) -> ScenarioTime:
    """Return the time of a scenario that has begun."""
    time = ScenarioTime(clock)
    time.begin(at_ns)
    return time


def command(number: int) -> Frame:
    """Return a command that has a number of 12 bits."""
    return Frame(m.WheelCommand.ID, m.WheelCommand(0, 0, 0, 0, number & 0xFF, number >> 8).encode())


def tick(number: int) -> Frame:
    """Return a TICK at this time."""
    return Frame(m.Tick.ID, m.Tick(number, 0, 0, 0, 0, 0).encode())


def row(kind: str, target: str, value: float = 1.0, from_ms: int = 0, to_ms: int = 10_000, **more: Any) -> FaultRow:
    """Return a row of a fault of the link, in force within a window of the scenario's time."""
    return FaultRow(kind, "link", target, from_ms * MS, to_ms * MS, value, **more)


def framed(frames: list[Frame]) -> bytes:
    """Return the bytes of frames on a serial line."""
    return b"".join(map(Framer().encode, frames))


def heard(link: Link) -> list[Frame]:
    """Return all frames that have arrived at an end."""
    frames: list[Frame] = []
    while (received := link.receive(0)) is not None:
        frames += received.frames
    return frames
