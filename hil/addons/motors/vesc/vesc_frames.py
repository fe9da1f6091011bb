"""The messages of VESC, over UART and over CAN; numbers are big-endian.

A message is a code (COMM_...) and its data. On a serial line it is sent as ``02 length payload CRC-16 03``; a message
of more than 255 bytes begins with ``03`` and has a length of two bytes. On CAN the identifier is command << 8 | VESC.
Motor commands have frames of their own. Other messages: up to 6 bytes go in one frame (``8: sender, 0, message``).
Longer ones go in pieces of 7 bytes (``5: offset, piece``), or of 6 where the offset needs two bytes (``6``), and a last
frame (``7: sender, 1, length, CRC-16``).
Source: VESC bldc, documentation/comm_can.md, comm/comm_can.c, comm/commands.c, comm/packet.c, confgenerator.c,
util/buffer.c, datatypes.h.
"""

import math
import struct
from binascii import crc_hqx
from collections.abc import Mapping, Sequence
from struct import Struct
from typing import NamedTuple

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import PacketFraming
from hil.robot.driver import EXTENDED, clamp

FW_VERSION, GET_APPCONF, GET_VALUES_SELECTIVE, FORWARD_CAN = 0, 17, 50, 34
CAN_FILL, CAN_FILL_LONG, CAN_PROCESS, CAN_SHORT, CAN_PING, CAN_PONG = 5, 6, 7, 8, 17, 18
CAN_STATUS, CAN_STATUS_4, CAN_STATUS_5 = 9, 16, 27
STATUS = Struct(">ihh")  # ERPM, current [0.1 A], duty [0.001]
STATUS_4 = Struct(">hhhh")  # temperatures of FET and motor [0.1 °C], input current [0.1 A], position of the PID
STATUS_5 = Struct(">ih")  # tachometer [a sixth of an electrical turn], input voltage [0.1 V]
STATUS_BYTES = {CAN_STATUS: STATUS.size, CAN_STATUS_4: STATUS_4.size, CAN_STATUS_5: STATUS_5.size}
STEPS = 6  # of the tachometer in an electrical turn
_MAX_BYTES = 512  # of a message
LONGEST_PACKET = _MAX_BYTES + 6  # bytes on a serial line
_INT32 = Struct(">i")
_APPCONF = Struct(">xxxxxBIf")  # code and signature, id, timeout [ms], brake current [A]
_MIN_APPCONF = 200  # bytes; the shortest known one has 278
_OFFSET_BYTES = {CAN_FILL: 1, CAN_FILL_LONG: 2}


class Setting(NamedTuple):
    """A motor command: its code in a message, its command on CAN, and the counts per unit of its value."""

    comm: int
    can: int
    per_unit: float

    def counts(self, value: float) -> bytes:
        """Return the bytes of a value, saturated to int32."""
        return _INT32.pack(clamp(round(value * self.per_unit), 2**31 - 1, -(2**31)))


MAX_ID = 254  # 255 is the broadcast id
HOST = 253  # id of this computer on the bus
MIN_CURRENT_A = 0.05  # a VESC releases its motor when less is commanded, also as a brake current

SET_CURRENT = Setting(6, 1, 1000.0)
SET_CURRENT_BRAKE = Setting(7, 2, 1000.0)
SET_RPM = Setting(8, 3, 1.0)

_VALUES: Mapping[int, tuple[str, str, float]] = {
    0: ("fet_degc", "h", 0.1), 2: ("motor_a", "i", 0.01), 3: ("input_a", "i", 0.01), 7: ("erpm", "i", 1.0),
    8: ("input_v", "h", 0.1), 13: ("tachometer", "i", 1.0), 15: ("fault", "B", 1.0), 17: ("id", "B", 1.0),
    21: ("status", "B", 1.0),
}  # fmt: skip
"""Name, layout and size of one count of each value, by its bit in the mask of COMM_GET_VALUES_SELECTIVE."""

ALL_VALUES = tuple(_VALUES)
FAULT_BIT, ID_BIT, STATUS_BIT = 15, 17, 21
KILL_SWITCH = 2  # bit of status

FAULTS = (
    "none", "over voltage", "under voltage", "gate driver (DRV)", "absolute over current",
    "over temperature of the MOSFETs", "over temperature of the motor", "gate driver over voltage",
    "gate driver under voltage", "under voltage of the processor", "reset by its own watchdog", "encoder SPI",
    "sin/cos encoder below its least amplitude", "sin/cos encoder above its largest amplitude", "flash corruption",
    "offset of current sensor 1", "offset of current sensor 2", "offset of current sensor 3", "unbalanced currents",
    "brake input", "resolver: loss of tracking", "resolver: degradation of signal", "resolver: loss of signal",
    "corrupt app configuration", "corrupt motor configuration", "encoder without a magnet",
    "encoder's magnet too strong", "phase filter", "encoder", "low-voltage output",
)  # fmt: skip
"""The faults of mc_fault_code, by number."""


def request_values(*bits: int) -> bytes:
    """Return the message that asks for the values of these bits."""
    return struct.pack(">BI", GET_VALUES_SELECTIVE, sum(1 << bit for bit in bits))


def parse_values(message: bytes) -> dict[str, float] | None:
    """Return the values of an answer by name; None for another or damaged message.

    A firmware leaves out a value that it does not know. Only a missing status can be recognised, because it is last.
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
    """Firmware version and hardware name of a VESC."""

    major: int
    minor: int
    hardware: str

    def __str__(self) -> str:
        return f"{self.hardware or 'unnamed'}, firmware {self.major}.{self.minor:02}"


def parse_version(message: bytes) -> Version | None:
    """Return the version of an answer to COMM_FW_VERSION; None for another message."""
    if len(message) < 3 or message[0] != FW_VERSION:
        return None
    hardware = message[3:].split(b"\0")[0].decode("ascii", "replace")
    return Version(message[1], message[2], hardware if hardware.isprintable() else "")


class Timeout(NamedTuple):
    """The timeout of an app configuration: after ``timeout_s`` without a command the VESC brakes.

    ``vesc`` is the id in the configuration. A ``timeout_s`` of 0 means no timeout. ``brake_current_a`` is the current
    with which it brakes.
    """

    vesc: int
    timeout_s: float
    brake_current_a: float


def parse_timeout(message: bytes) -> Timeout | None:
    """Return the timeout in an answer to COMM_GET_APPCONF; None for another message, or if the current is not finite.

    Only the first bytes of the configuration are read, because they alone are the same in all firmwares that were
    examined (VESC.md). A message much shorter than in any of these gives None. Numbers of ``float32_auto`` are IEEE 754
    singles, except that subnormal ones are sent as 0.
    """
    if len(message) < _MIN_APPCONF or message[0] != GET_APPCONF:
        return None
    vesc, timeout_ms, brake_current_a = _APPCONF.unpack_from(message)
    return Timeout(vesc, timeout_ms / 1000, brake_current_a) if math.isfinite(brake_current_a) else None


class CanMessages:
    """Assembles messages from the CAN frames to this computer.

    Only the last frame of a message names its sender, so one VESC at a time may be asked for a long message.
    """

    def __init__(self) -> None:
        self._open = b""

    def feed(self, frame: Frame) -> tuple[int, bytes] | None:
        """Return sender and message if the frame completes a message, else None."""
        command, payload = (frame.id & ~EXTENDED) >> 8, frame.payload
        if frame.id & 0xFF != HOST or not frame.id & EXTENDED:
            return None
        if command == CAN_SHORT and len(payload) > 2:
            return payload[0], payload[2:]
        head = _OFFSET_BYTES.get(command)
        if head is not None and len(payload) > head:
            offset = int.from_bytes(payload[:head], "big")
            before = self._open if offset else b""
            fits = offset == len(before) <= _MAX_BYTES
            self._open = before + payload[head:] if fits else b""
        elif command == CAN_PROCESS and len(payload) == 6:
            message, self._open = self._open, b""
            sender, _, length, crc = struct.unpack(">BBHH", payload)
            if message and length == len(message) and crc == crc_hqx(message, 0):
                return sender, message
        return None


class SerialFraming(PacketFraming):
    """The packets of a serial line. ``Frame.id`` is the message's code."""

    head = b"\x02"  # or 03
    longest = LONGEST_PACKET
    causes = ("length", "end", "checksum")

    def encode(self, frame: Frame) -> bytes:
        """Return the packet of a message. Raises ValueError when it is too long for one."""
        message = bytes((frame.id,)) + frame.payload
        if len(message) > _MAX_BYTES:
            raise ValueError(f"message {frame.id} of {len(message)} bytes: expected at most {_MAX_BYTES}")
        head = bytes((2, len(message))) if len(message) < 256 else struct.pack(">BH", 3, len(message))
        return head + message + struct.pack(">HB", crc_hqx(message, 0), 3)

    def _find(self, buffer: bytearray, at: int) -> int:
        return min((begin for head in (b"\x02", b"\x03") if (begin := buffer.find(head, at)) >= 0), default=-1)

    def _decode(self, data: bytes) -> tuple[int, list[Frame]] | str | None:
        head = data[0]
        if len(data) < head:
            return None
        length = int.from_bytes(data[1:head], "big")
        if not (1 if head == 2 else 255) <= length <= _MAX_BYTES:
            return "length"
        end = head + length
        if len(data) < end + 3:
            return None
        message, crc, last = data[head:end], data[end : end + 2], data[end + 2]
        if last != 3:
            return "end"
        if crc_hqx(message, 0) != int.from_bytes(crc, "big"):
            return "checksum"
        return end + 3, [Frame(message[0], message[1:])]


class Bus:
    """The way to VESCs over CAN.

    Attributes:
        questions: messages that ask a VESC at the start, one value each, so that each answer fits into one frame.
        rounds: frames to send in turn, one item per tick: each asks one VESC for fault and status.
    """

    def __init__(self, ids: Sequence[int]) -> None:
        values = [request_values(bit) for bit in (FAULT_BIT, STATUS_BIT)]
        self.questions: Sequence[bytes] = (bytes((FW_VERSION,)), *values)
        self.rounds: Sequence[Sequence[Frame]] = [[self.message(vesc, request) for request in values] for vesc in ids]

    def setting(self, setting: Setting, vesc: int, value: float) -> Frame:
        """Return the frame of a motor's command."""
        return Frame(EXTENDED | setting.can << 8 | vesc, setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return the frame of a message of up to 6 bytes."""
        return Frame(EXTENDED | CAN_SHORT << 8 | vesc, bytes((HOST, 0)) + message)


class Line:
    """The way over the serial line of the VESC ``near``, which forwards messages to the others.

    Attributes:
        questions: messages that ask a VESC at the start.
        rounds: frames to send in turn, one item per tick: each asks the near VESC and one of the others. Two answers of
            the others at once would mix on the bus between them.
    """

    def __init__(self, ids: Sequence[int], near: int) -> None:
        self._near = near
        request = request_values(*ALL_VALUES)
        self.questions: Sequence[bytes] = (bytes((FW_VERSION,)), request)
        first = [self.message(near, request)] if near in ids else []
        self.rounds: Sequence[Sequence[Frame]] = [[*first, self.message(vesc, request)] for vesc in ids if vesc != near]

    def setting(self, setting: Setting, vesc: int, value: float) -> Frame:
        """Return the message of a motor's command."""
        return self.message(vesc, bytes((setting.comm,)) + setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return the frame of a message, which the near VESC forwards if it is for another one."""
        if vesc == self._near:
            return Frame(message[0], message[1:])
        return Frame(FORWARD_CAN, bytes((vesc,)) + message)


_OVERHEAD_BYTES = 6  # of a short packet: begin, length, code, checksum and end


def repeated_past_packet(commands: Sequence[Frame]) -> Sequence[Frame]:
    """Return commands for a serial line, repeated until they are longer than the longest packet.

    After a lost or a stray byte, a VESC may take the bytes that follow for one long packet. When this is complete, its
    checksum is wrong. The VESC then reads its bytes again, and executes the old commands among them. The repetition
    makes sure that it executes these commands last.
    """
    size = sum(len(frame.payload) + _OVERHEAD_BYTES for frame in commands)
    return [*commands] * (LONGEST_PACKET // size + 1)
