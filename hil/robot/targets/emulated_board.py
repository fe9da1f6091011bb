"""What the emulated boards share: the plant behind their serial line, and what their frames tell of the firmware."""

import math
from abc import ABC, abstractmethod
from typing import Self

from firmware_protocol import codec
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import View, library
from firmware_protocol.plant_port import Drive, PlantPort, Sense
from hil.core.errors import DeviceError

_NEVER = 0xFFFF_FFFF  # age of the newest command when there was none, as in the host library
_OLDEST_MS = 255  # TICK.command_age_ms goes no further
_OBSERVED = (m.Tick.ID, m.Status.ID, m.LinkCounters.ID)
_UNSEEN = (math.nan,) * 4
_AT_REST = (0.0,) * 4


class _PlantFailedError(Exception):
    """The exchange returned an error; why, the plant knows."""


class PlantLine:
    """Answers the plant port from a C function of the type ``wheel_plant_exchange`` and its context.

    ``ticks`` counts the milliseconds that have passed in the plant. ``has_failed`` is true once it has failed: then
    nothing is answered, and no time passes.
    """

    def __init__(self, exchange_address: int, context_address: int) -> None:
        self._ffi, _ = library()
        self._exchange = self._ffi.cast("wheel_plant_exchange", exchange_address)
        self._context = self._ffi.cast("void *", context_address)
        self._drive = self._ffi.new("wheel_drive *")
        self._sense = self._ffi.new("wheel_sense *")
        self._port = PlantPort(self._body)
        self.has_failed = False
        self.ticks = 0
        self.drive: Drive | None = None

    def feed(self, data: bytes) -> bytes:
        """Feed bytes of the firmware, whatever they are, and return the answer."""
        if self.has_failed:
            return b""
        try:
            return self._port.feed(data)
        except _PlantFailedError:
            self.has_failed = True
            return b""

    def _body(self, drive: Drive | None) -> Sense:
        held = self._ffi.NULL
        if drive is not None:
            held = self._drive
            held.tick, held.enabled = drive.tick, drive.enabled
            held.torque_n_m, held.duty = drive.torque_n_m, drive.duty
            self.drive = drive
        if self._exchange(self._context, held, self._sense) != 0:
            raise _PlantFailedError
        if drive is not None:
            self.ticks += 1
        s, unpack = self._sense, self._ffi.unpack
        return Sense(
            s.tick,
            tuple(unpack(s.count, 4)),
            tuple(unpack(s.current_a, 4)),
            tuple(unpack(s.gyro_rad_s, 3)),
            tuple(unpack(s.acceleration_m_s2, 3)),
            s.battery_v,
            s.battery_a,
            tuple(unpack(s.temperature_degc, 4)),
        )


class Observer:
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

    def add(self, frame: Frame) -> None:
        """Add a frame that the board sent."""
        if frame.id not in _OBSERVED:
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


class EmulatedBoard(ABC):
    """What both boards share: the plant behind them, and what is known of the firmware. A context manager."""

    def __init__(self, exchange_address: int, context_address: int) -> None:
        self._plant = PlantLine(exchange_address, context_address)
        self._observer = Observer()

    def count_unsent(self, frames: int) -> None:
        """Count frames that could not be sent on; the firmware, like a board's, does not learn of them."""
        self._observer.unsent += frames

    def run(self, ticks: int) -> None:
        """Raise DeviceError: robot time comes from STEP."""
        raise DeviceError("an emulated board has no real time: its robot time comes from STEP; use --mode lockstep")

    def look(self) -> View:
        """Return what is known of the firmware's state."""
        return self._observer.view(self._plant.drive, plant_failed=self._plant.has_failed)

    @abstractmethod
    def close(self) -> None:
        """Power the board off. Closing twice is allowed."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
