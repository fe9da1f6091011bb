"""The plant's end of an emulated board's plant port."""

from firmware_protocol.host import library
from firmware_protocol.plant_port import Drive, PlantPort, Sense
from hil.core.errors import DeviceError


class _PlantFailedError(Exception):
    """The exchange returned an error; why, the plant knows."""


class PlantLine:
    """Answers the plant port from a C function of the type ``wheel_plant_exchange`` and its context.

    ``ticks`` counts the milliseconds that have passed in the plant. ``has_failed`` tells that it failed: from then on
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
        """Take bytes of the firmware, whatever they are, and return the answer."""
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


def only_lockstep() -> DeviceError:
    """Return what there is to say when an emulated board is asked to run by the wall clock."""
    return DeviceError("an emulated board has no real time: its robot time comes from STEP; use --mode lockstep")
