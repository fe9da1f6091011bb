"""The firmware core in the host library, as one object: it takes and gives bytes or CAN frames.

Time passes by ``run`` or by a received STEP. The plant is a C function (``firmware/plant_port.h``), so that a tick
needs no Python call.
"""

import functools
import struct
import zlib
from collections.abc import Mapping
from typing import Any, NamedTuple

from firmware_protocol.capabilities import Capability
from firmware_protocol.extension import library, wheel
from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import Fault, FaultWheel, Mode, ResetCause, State, StopReason, Type

_BYTES = 1 << 17  # twice what all frames of a full queue take (WHEEL_HOST_QUEUE)

# The host library has no power stage of its own, and its user decides whether time comes from STEP.
_NOTHING = Capability(0)
_CAN_DO = ~(Capability.POWER_STAGE | Capability.LOCKSTEP)


class Parameter(NamedTuple):
    """A row of the firmware's parameter table; ``type`` is the value's type on the wire."""

    name: str
    type: Type
    minimum: float
    maximum: float


@functools.cache
def parameters() -> tuple[Parameter, ...]:
    """Return the firmware's parameters in the order of their hash."""
    ffi, lib = library()
    rows = (lib.wheel_parameter_table[i] for i in range(lib.WHEEL_PARAMETER_COUNT))
    return tuple(Parameter(ffi.string(row.name).decode(), Type(row.type), row.minimum, row.maximum) for row in rows)


def parameter_hash(values: Mapping[str, float]) -> int:
    """Return the CRC-32 that a robot with these parameters reports (DBC HELLO_PARAMETERS.parameter_hash).

    Raises KeyError when a parameter is missing.
    """
    ordered = [values[p.name] for p in parameters()]
    return zlib.crc32(struct.pack(f"<{len(ordered)}f", *ordered))


def stored_size() -> int:
    """Return how many bytes a robot keeps across a reset."""
    return int(library()[1].wheel_host_stored_size())


def stored_parameters(values: Mapping[str, float], board: int) -> bytes:
    """Return the bytes that a board keeps across a reset after storing these parameters; board 0 is the host library's.

    Raises ValueError when a parameter is unknown, missing or out of range.
    """
    ffi, lib = library()
    block = _parameter_block(values)
    stored = ffi.new("uint8_t[]", stored_size())
    lib.wheel_host_store(block, board, stored)
    return bytes(ffi.buffer(stored))


def _parameter_block(values: Mapping[str, float]) -> Any:
    """Return ``wheel_parameters *``. Raises ValueError when a parameter is unknown, missing or out of its range."""
    ffi, lib = library()
    names = {p.name for p in parameters()}
    if set(values) != names:
        raise ValueError(f"firmware parameters {sorted(set(values) ^ names)} are missing or unknown")
    block = ffi.new("wheel_parameters *", dict(values))
    if (wrong := lib.wheel_parameters_invalid(block)) >= 0:
        name, _, low, high = parameters()[wrong]
        raise ValueError(f"firmware parameter {name} = {values[name]:g}: expected {low:g} to {high:g}")
    return block


class View(NamedTuple):
    """The firmware's inner state, for tests, ground truth and reports; none of it is sent on the wire."""

    tick: int
    state: State
    mode: Mode
    fault: Fault
    fault_wheel: FaultWheel
    stop_reason: StopReason
    plant_failed: bool
    command_age_ticks: int
    set_point_rad_s: tuple[float, float, float, float]
    torque_n_m: tuple[float, float, float, float]
    duty: tuple[float, float, float, float]
    rejected: dict[str, int]


class HostNode(wheel.Node):
    """One robot's firmware on this machine.

    ``exchange_address`` and ``context_address`` are the plant's C function and its context; their owner keeps them
    alive as long as this object. ``values`` gives every parameter of ``parameters()``. ``power_stage`` makes it report
    motors, like a board with motors; it then refuses STEP. ``lacks`` are sensors that its plant does not have.
    ``stored`` is the result of an earlier node's ``stored()``: parameters kept across a reset; a damaged copy is
    ignored. ``reset_cause`` is reported in STATUS.

    Raises ValueError when a parameter is unknown, missing or out of range, or ``stored`` has a wrong length.

    Attributes:
        handle: the C struct, for cffi; valid as long as this object.
    """

    def __init__(
        self,
        values: Mapping[str, float],
        exchange_address: int,
        context_address: int,
        *,
        lockstep: bool,
        power_stage: bool = False,
        lacks: Capability = _NOTHING,
        stored: bytes | None = None,
        reset_cause: ResetCause = ResetCause.POWER_ON,
    ) -> None:
        self._ffi, self._lib = library()
        block = _parameter_block(values)
        self._bytes = self._ffi.new("uint8_t[]", _BYTES)
        self._buffer = self._ffi.buffer(self._bytes, _BYTES)
        self._id = self._ffi.new("uint16_t *")
        capabilities = _CAN_DO & ~lacks | (Capability.LOCKSTEP if lockstep else 0)
        capabilities |= Capability.POWER_STAGE if power_stage else 0
        if stored is not None and len(stored) != stored_size():
            raise ValueError(f"{len(stored)} stored bytes; expected {stored_size()}")
        parameters = bytes(self._ffi.buffer(block))
        super().__init__(parameters, stored, capabilities, reset_cause, exchange_address, context_address)
        self.handle = self._ffi.cast("wheel_host *", self.address)
        # Attributes are looked up once, because a lookup costs as much as the call.
        self._feed, self._take_bytes = self._lib.wheel_host_feed, self._lib.wheel_host_take_bytes

    def feed(self, data: bytes) -> None:
        """Take bytes of a serial line."""
        self._feed(self.handle, data, len(data))

    def receive(self, frame: Frame) -> None:
        """Take one CAN frame."""
        self._lib.wheel_host_receive(self.handle, frame.id, frame.payload, len(frame.payload))

    def set_clock(self, now_us: int) -> None:
        """Set the robot's clock between two ticks [µs], for the time stamps of what arrives and leaves."""
        self._lib.wheel_host_set_clock(self.handle, now_us & 0xFFFF_FFFF)

    def stored(self) -> bytes | None:
        """Return the bytes that the robot keeps across a reset (the newest STORE), or None."""
        size = stored_size()
        block = self._ffi.new("uint8_t[]", size)
        return bytes(self._ffi.buffer(block, size)) if self._lib.wheel_host_stored(self.handle, block) else None

    def run(self, ticks: int) -> None:
        """Let ``ticks`` ticks of 1 ms pass."""
        self._lib.wheel_host_run(self.handle, ticks)

    def take_bytes(self) -> bytes:
        """Return all waiting output, as bytes of a serial line."""
        count = self._take_bytes(self.handle, self._bytes, _BYTES)
        data: bytes = self._buffer[:count]
        return data

    def take_frames(self) -> list[Frame]:
        """Return all waiting output, as frames."""
        frames = []
        while (length := self._lib.wheel_host_take_frame(self.handle, self._id, self._bytes)) >= 0:
            frames.append(Frame(self._id[0], bytes(self._buffer[:length])))
        return frames

    def count_unsent(self, frames: int) -> None:
        """Count frames that were taken and could not be sent (DBC PORT_COUNTERS.transmit_overrun)."""
        self._lib.wheel_host_count_unsent(self.handle, frames)

    def look(self) -> View:
        """Return the firmware's inner state."""
        v = self._ffi.new("wheel_host_view *")
        self._lib.wheel_host_look(self.handle, v)
        rejected = {
            "cobs": v.rejected_cobs,
            "crc": v.rejected_crc,
            "length": v.rejected_length,
            "unknown_id": v.rejected_unknown_id,
            "range": v.rejected_range,
            "session": v.rejected_session,
            "stale": v.rejected_stale,
            "state": v.rejected_state,
            "feedforward_unmatched": v.feedforward_unmatched,
            "transmit_overruns": v.transmit_overruns,
        }
        return View(
            v.tick,
            State(v.state),
            Mode(v.mode),
            Fault(v.fault),
            FaultWheel(v.fault_wheel),
            StopReason(v.stop_reason),
            v.plant_failed,
            v.command_age_ticks,
            tuple(v.set_point_rad_s),
            tuple(v.torque_n_m),
            tuple(v.duty),
            rejected,
        )
