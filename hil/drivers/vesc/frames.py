"""The messages of VESC, over UART and over CAN; numbers are big-endian.

A message is a code (COMM_...) and its data. On a serial line it travels as ``02 length payload CRC-16 03``, with ``03``
and two bytes for more than 255. On CAN the identifier is command << 8 | VESC; the commands of a motor have a frame of
their own, and any message fits into others: up to 6 bytes in one (``8: sender, 0, message``), longer ones in parts of 7
(``5: offset, part``), of 6 from where the offset needs two bytes (``6``), that a last frame ends
(``7: sender, 1, length, CRC-16``).
Source: VESC bldc, documentation/comm_can.md, comm/comm_can.c, comm/commands.c, comm/packet.c, confgenerator.c,
util/buffer.c, datatypes.h.
"""

import math
import struct
from binascii import crc_hqx
from collections.abc import Mapping
from struct import Struct
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.drivers.port import EXTENDED

FW_VERSION, GET_APPCONF, GET_VALUES_SELECTIVE, FORWARD_CAN, PING_CAN = 0, 17, 50, 34, 62
CAN_FILL, CAN_FILL_LONG, CAN_PROCESS, CAN_SHORT, CAN_PING, CAN_PONG = 5, 6, 7, 8, 17, 18
CAN_STATUS, CAN_STATUS_4, CAN_STATUS_5 = 9, 16, 27
STATUS = Struct(">ihh")  # ERPM, current [0.1 A], duty [0.001]
STATUS_4 = Struct(">hhhh")  # temperatures of FET and motor [0.1 °C], input current [0.1 A], position of the PID
STATUS_5 = Struct(">ih")  # tachometer [a sixth of an electrical turn], input voltage [0.1 V]
STEPS = 6  # of the tachometer in an electrical turn
MOST_IDS = 254  # 255 is all of them at once
_MOST_BYTES = 512  # of a message
LONGEST_PACKET = _MOST_BYTES + 6  # in bytes of a serial line
_INT32 = Struct(">i")
_APPCONF = Struct(">xxxxxBIf")  # code and signature, id, timeout [ms], brake current [A]
_LEAST_APPCONF = 200  # bytes; the shortest that is known has 278
_OFFSET_BYTES = {CAN_FILL: 1, CAN_FILL_LONG: 2}


class Setting(NamedTuple):
    """A command of a motor: its code in a message, on CAN, and counts of one unit."""

    comm: int
    can: int
    per_unit: float

    def counts(self, value: float) -> bytes:
        """Return the number of a command, saturated to what it can carry."""
        return _INT32.pack(min(max(round(value * self.per_unit), -(2**31)), 2**31 - 1))


LEAST_CURRENT_A = 0.05  # a VESC lets its motor go when less is asked for, also of a brake

SET_CURRENT = Setting(6, 1, 1000.0)
SET_CURRENT_BRAKE = Setting(7, 2, 1000.0)
SET_RPM = Setting(8, 3, 1.0)

_VALUES: Mapping[int, tuple[str, str, float]] = {
    0: ("fet_degc", "h", 0.1),
    2: ("motor_a", "i", 0.01),
    3: ("input_a", "i", 0.01),
    7: ("erpm", "i", 1.0),
    8: ("input_v", "h", 0.1),
    13: ("tachometer", "i", 1.0),
    15: ("fault", "B", 1.0),
    17: ("id", "B", 1.0),
    21: ("status", "B", 1.0),
}
"""By its bit in the mask of COMM_GET_VALUES_SELECTIVE: name, layout, and what one count is."""

ALL_VALUES = tuple(_VALUES)
FAULT_BIT, ID_BIT, STATUS_BIT = 15, 17, 21
HAS_TIMED_OUT, KILL_SWITCH = 1, 2  # bits of status

FAULTS = (
    "none",
    "over voltage",
    "under voltage",
    "gate driver (DRV)",
    "absolute over current",
    "over temperature of the MOSFETs",
    "over temperature of the motor",
    "gate driver over voltage",
    "gate driver under voltage",
    "under voltage of the processor",
    "reset by its own watchdog",
    "encoder SPI",
    "sin/cos encoder below its least amplitude",
    "sin/cos encoder above its largest amplitude",
    "flash corruption",
    "offset of current sensor 1",
    "offset of current sensor 2",
    "offset of current sensor 3",
    "unbalanced currents",
    "brake input",
    "resolver: loss of tracking",
    "resolver: degradation of signal",
    "resolver: loss of signal",
    "corrupt app configuration",
    "corrupt motor configuration",
    "encoder without a magnet",
    "encoder's magnet too strong",
    "phase filter",
    "encoder",
    "low-voltage output",
)
"""The words of mc_fault_code, by number."""


def values_wanted(*bits: int) -> bytes:
    """Return the message that asks for some values."""
    return struct.pack(">BI", GET_VALUES_SELECTIVE, sum(1 << bit for bit in bits))


def parse_values(message: bytes) -> dict[str, float] | None:
    """Return the values that an answer carries, by name; None for what is none.

    A firmware that does not know one leaves it out, which only can be seen of the last.
    """
    if len(message) < 5 or message[0] != GET_VALUES_SELECTIVE:
        return None
    mask = int.from_bytes(message[1:5], "big")
    values: dict[str, float] = {}
    at = 5
    for bit in range(32):
        if not mask >> bit & 1:
            continue
        if bit not in _VALUES:
            return None
        name, layout, scale = _VALUES[bit]
        size = struct.calcsize(layout)
        if at + size > len(message):
            return values if at == len(message) and bit == STATUS_BIT else None
        values[name] = struct.unpack_from(">" + layout, message, at)[0] * scale
        at += size
    return values if at == len(message) else None


class Version(NamedTuple):
    """What a VESC says of itself."""

    major: int
    minor: int
    hardware: str


def parse_version(message: bytes) -> Version | None:
    """Return what the answer to COMM_FW_VERSION says, None for another message."""
    if len(message) < 3 or message[0] != FW_VERSION:
        return None
    hardware = message[3:].split(b"\0")[0].decode("ascii", "replace")
    return Version(message[1], message[2], hardware if hardware.isprintable() else "")


class Timeout(NamedTuple):
    """What a VESC does when commands end, of its app configuration: ``vesc`` is the id that stands there with it.

    After ``timeout_s`` without a command it brakes with ``brake_current_a``; a timeout of 0 is none.
    """

    vesc: int
    timeout_s: float
    brake_current_a: float


def parse_timeout(message: bytes) -> Timeout | None:
    """Return the timeout of an answer to COMM_GET_APPCONF, None for another message or no finite current.

    The configuration begins alike in every firmware that was looked at, and goes on differently (VESC.md); what is much
    shorter than any is none. Its numbers of ``float32_auto`` are IEEE 754 singles, but that those below the least
    normal one are sent as 0.
    """
    if len(message) < _LEAST_APPCONF or message[0] != GET_APPCONF:
        return None
    vesc, timeout_ms, brake_current_a = _APPCONF.unpack_from(message)
    return Timeout(vesc, timeout_ms / 1000, brake_current_a) if math.isfinite(brake_current_a) else None


class CanMessages:
    """Messages from the frames that a host with an id of its own is sent; one VESC at a time is to be asked.

    The parts of a message do not say whose they are, its last frame does.
    """

    def __init__(self, host: int) -> None:
        self._host = host
        self._open = b""

    def feed(self, frame: Frame) -> tuple[int, bytes] | None:
        """Return sender and message when a frame completes one."""
        command, payload = (frame.id & ~EXTENDED) >> 8, frame.payload
        if frame.id & 0xFF != self._host or not frame.id & EXTENDED:
            return None
        if command == CAN_SHORT and len(payload) > 2:
            return payload[0], payload[2:]
        head = _OFFSET_BYTES.get(command)
        if head is not None and len(payload) > head:
            offset = int.from_bytes(payload[:head], "big")
            before = self._open if offset else b""
            fits = offset == len(before) <= _MOST_BYTES
            self._open = before + payload[head:] if fits else b""
        elif command == CAN_PROCESS and len(payload) == 6:
            message, self._open = self._open, b""
            sender, _, length, crc = struct.unpack(">BBHH", payload)
            if message and length == len(message) and crc == crc_hqx(message, 0):
                return sender, message
        return None


CAUSES = ("start", "length", "end", "checksum")


class SerialFraming:
    """The packets of a serial line. ``Frame.id`` is the message's code.

    Bytes that make no packet count once for as long as they last, by what was wrong where they began: ``start`` (no
    02 or 03), ``length``, ``end`` (no 03) or ``checksum``.
    """

    def __init__(self) -> None:
        self.rejected = dict.fromkeys(CAUSES, 0)
        self._open = b""
        self._is_in_step = True

    def encode(self, frame: Frame) -> bytes:
        """Return the packet of a message. Raises ValueError when it is too long for one."""
        message = bytes((frame.id,)) + frame.payload
        if len(message) > _MOST_BYTES:
            raise ValueError(f"message {frame.id} of {len(message)} bytes: expected at most {_MOST_BYTES}")
        head = bytes((2, len(message))) if len(message) < 256 else struct.pack(">BH", 3, len(message))
        return head + message + struct.pack(">HB", crc_hqx(message, 0), 3)

    def feed(self, data: bytes) -> list[Frame]:
        data = self._open + data
        frames = []
        at = 0
        while at < len(data):
            head = data[at]
            end, cause = _packet_end(data, at)
            if cause is None and end > len(data):
                break
            if cause is None:
                message = data[at + head : end - 3]
                cause = _wrong(message, data[end - 3 : end])
            if cause is None:
                frames.append(Frame(message[0], message[1:]))
                at, self._is_in_step = end, True
                continue
            if self._is_in_step:
                self.rejected[cause] += 1
                self._is_in_step = False
            at += 1
        self._open = data[at:]
        return frames


def _packet_end(data: bytes, at: int) -> tuple[int, str | None]:
    """Return where the packet ends that may begin here, beyond the data when that cannot be told; or why none does."""
    head = data[at]
    if head not in (2, 3):
        return at, "start"
    if len(data) < at + head:
        return len(data) + 1, None
    length = data[at + 1] if head == 2 else data[at + 1] << 8 | data[at + 2]
    if not (1 if head == 2 else 255) <= length <= _MOST_BYTES:
        return at, "length"
    return at + head + length + 3, None


def _wrong(message: bytes, tail: bytes) -> str | None:
    if tail[2] != 3:
        return "end"
    return None if crc_hqx(message, 0) == tail[0] << 8 | tail[1] else "checksum"
