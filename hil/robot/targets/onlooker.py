"""What can be seen of a board from outside: what it says on the wire, and what it gives to its plant."""

import math

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import View
from firmware_protocol.plant_port import Drive

_NEVER = 0xFFFF_FFFF  # age of the newest command when there was none, as in the host library
_OLDEST_MS = 255  # TICK.command_age_ms goes no further
_TOLD_IN = (m.Tick.ID, m.Status.ID, m.LinkCounters.ID)
_UNSEEN = (math.nan,) * 4
_AT_REST = (0.0,) * 4


class Onlooker:
    """Puts a View together from the frames that a board sends.

    The set points stay unknown (NaN); an age of 255 ms and more is that of no command. ``unsent`` are frames that its
    owner could not send on.
    """

    def __init__(self) -> None:
        self._state = m.State.BOOT
        self._age_ms = _OLDEST_MS
        self._status = m.Status(0, 0, 0, 0, 0, 0, 0, 0, 0)
        self._rejected: dict[str, int] = {}
        self.unsent = 0

    def hear(self, frame: Frame) -> None:
        """Take a frame that the board sent."""
        if frame.id not in _TOLD_IN:
            return
        match codec.decode(frame):
            case m.Tick() as tick:
                self._state, self._age_ms = m.State(tick.state), tick.command_age_ms
            case m.Status() as status:
                self._state, self._status = m.State(status.state), status
            case m.LinkCounters() as counters:
                self._rejected = counters._asdict()

    def view(self, drive: Drive | None, *, plant_failed: bool) -> View:
        """Return what is known; ``drive`` is the newest that the board gave to its plant."""
        status = self._status
        return View(
            tick=drive.tick + 1 if drive is not None else 0,
            state=self._state,
            mode=m.Mode(status.mode),
            fault=m.Fault(status.fault),
            fault_wheel=m.FaultWheel(status.fault_wheel),
            stop_reason=m.StopReason(status.stop_reason),
            plant_failed=plant_failed,
            command_age_ticks=_NEVER if self._age_ms == _OLDEST_MS else self._age_ms,
            set_point_rad_s=_UNSEEN,
            torque_n_m=drive.torque_n_m if drive is not None else _AT_REST,
            duty=drive.duty if drive is not None else _AT_REST,
            rejected=self._rejected | {"transmit_overruns": self.unsent},
        )
