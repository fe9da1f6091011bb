"""The base class of emulated boards: their plant behind a serial line, and what their frames say of the firmware."""

import math
from typing import Self

from firmware_protocol import codec
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame
from firmware_protocol.generated import messages as m
from firmware_protocol.host import View
from firmware_protocol.plant_port import Drive, PlantPort, Sense
from hil.core.errors import DeviceError
from hil.robot.virtual import RobotNode

_NEVER = 0xFFFF_FFFF  # age of the newest command when there was none, as in the host library
_OLDEST_MS = 255  # TICK.command_age_ms goes no further
_OBSERVED = (m.Tick.ID, m.Status.ID, m.LinkCounters.ID)
_UNKNOWN = (math.nan,) * 4
_AT_REST = (0.0,) * 4


class _PlantFailedError(Exception):
    """The exchange returned an error; the plant knows the cause."""


class EmulatedBoard(RobotNode):
    """A board whose plant is a C function of the type ``wheel_plant_exchange`` with its context; a context manager.

    Attributes:
        plant_failed: whether the plant has failed. Then it no longer answers, and no time passes.
        plant_ticks: milliseconds that have passed in the plant.
    """

    def __init__(self, exchange_address: int, context_address: int) -> None:
        self._ffi, _ = library()
        self._exchange = self._ffi.cast("wheel_plant_exchange", exchange_address)
        self._context = self._ffi.cast("void *", context_address)
        self._c_drive = self._ffi.new("wheel_drive *")
        self._c_sense = self._ffi.new("wheel_sense *")
        self._plant_port = PlantPort(self._exchange_with_plant)
        self._drive: Drive | None = None  # the newest that the firmware sent to its plant
        self._state = m.State.BOOT
        self._age_ms = _OLDEST_MS
        self._status = m.Status(0, 0, 0, 0, 0, 0, 0, 0, 0)
        self._rejected: dict[str, int] = {}
        self._unsent = 0
        self.plant_failed = False
        self.plant_ticks = 0

    def feed_plant(self, data: bytes) -> bytes:
        """Feed any bytes that the firmware sent to its plant; return the answer."""
        try:
            return b"" if self.plant_failed else self._plant_port.feed(data)
        except _PlantFailedError:
            self.plant_failed = True
            return b""

    def _exchange_with_plant(self, drive: Drive | None) -> Sense:
        argument = self._ffi.NULL
        if drive is not None:
            argument = self._c_drive
            argument.tick, argument.enabled = drive.tick, drive.enabled
            argument.torque_n_m, argument.duty = drive.torque_n_m, drive.duty
            self._drive = drive
        s, unpack = self._c_sense, self._ffi.unpack
        if self._exchange(self._context, argument, s) != 0:
            raise _PlantFailedError
        self.plant_ticks += drive is not None
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

    def observe(self, frame: Frame) -> None:
        """Note the firmware's state from a frame that the board sent."""
        if frame.id not in _OBSERVED:
            return
        match codec.decode(frame):
            case m.Tick() as tick:
                self._state, self._age_ms = m.State(tick.state), tick.command_age_ms
            case m.Status() as status:
                self._state, self._status = m.State(status.state), status
            case m.LinkCounters() as counters:
                self._rejected = counters._asdict()

    def look(self) -> View:
        """Return what is known of the firmware's state.

        The set points are unknown (NaN), and a command's age of 255 ms or more counts as no command.
        """
        drive, status = self._drive, self._status
        return View(
            tick=drive.tick + 1 if drive is not None else 0,
            state=self._state,
            mode=m.Mode(status.mode),
            fault=m.Fault(status.fault),
            fault_wheel=m.FaultWheel(status.fault_wheel),
            stop_reason=m.StopReason(status.stop_reason),
            plant_failed=self.plant_failed,
            command_age_ticks=_NEVER if self._age_ms == _OLDEST_MS else self._age_ms,
            set_point_rad_s=_UNKNOWN,
            torque_n_m=drive.torque_n_m if drive is not None else _AT_REST,
            duty=drive.duty if drive is not None else _AT_REST,
            rejected=self._rejected | {"transmit_overruns": self._unsent},
        )

    def count_unsent(self, frames: int) -> None:
        """Count frames that could not be sent on. The firmware does not learn of them, as on a real board."""
        self._unsent += frames

    def run(self, ticks: int) -> None:
        """Raise DeviceError: robot time comes from STEP."""
        raise DeviceError("an emulated board has no real time: its robot time comes from STEP; use --mode lockstep")

    def close(self) -> None:
        """Power the board off. Closing twice is allowed."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
