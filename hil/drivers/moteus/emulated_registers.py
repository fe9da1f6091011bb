"""The registers of an emulated moteus, and the subframes in which they are written and read.

Source: mjbots moteus, docs/protocol/registers.md and docs/protocol/can.md.
"""

import math
import struct
from collections.abc import Mapping
from typing import NamedTuple

from hil.drivers.emulated import limited

INT8, INT16, INT32, FLOAT = 0, 1, 2, 3
MODE, FAULT = 0x00, 0x0F
MODEL, FIRMWARE, REGISTER_MAP = 0x100, 0x101, 0x102
ID, SERIAL_NUMBER, UUID, UUID_MASK, UUID_CAPABLE = 0x110, 0x120, 0x150, 0x154, 0x158
SET_NEAREST, SET_EXACT, RECAPTURE = 0x130, 0x131, 0x133
MILLISECONDS = 0x70

_MOST_BYTES = 64  # of a CAN FD frame
_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)
WRITE_ERROR, READ_ERROR = 0x30, 0x31
NO_REGISTER, READ_ONLY, NO_MODE = 1, 2, 3

_MOST_FLOAT = 3.4028234663852886e38
_FORMATS = ("<b", "<h", "<i", "<f")
_SCALES: Mapping[str, tuple[float, float, float]] = {
    "position": (1e-2, 1e-4, 1e-5),
    "velocity": (1e-1, 2.5e-4, 1e-5),
    "acceleration": (5e-2, 1e-3, 1e-5),
    "torque": (5e-1, 1e-2, 1e-3),
    "share": (1 / 127, 1 / 32767, 1 / 2147483647),
    "time": (1e-2, 1e-3, 1e-6),
    "current": (1.0, 1e-1, 1e-3),
    "voltage": (5e-1, 1e-1, 1e-3),
    "temperature": (1.0, 1e-1, 1e-3),
    "power": (10.0, 5e-2, 1e-4),
    "count": (1.0, 1.0, 1.0),
}

COMMAND: Mapping[int, tuple[str, float]] = {  # register: quantity and what holds when a command does not write it
    0x18: ("share", 0.0),
    0x19: ("voltage", 0.0),
    0x1A: ("voltage", 0.0),
    0x1B: ("voltage", 0.0),
    0x1C: ("current", 0.0),
    0x1D: ("current", 0.0),
    0x1E: ("velocity", 0.0),
    0x20: ("position", 0.0),
    0x21: ("velocity", 0.0),
    0x22: ("torque", 0.0),
    0x23: ("share", 1.0),
    0x24: ("share", 1.0),
    0x25: ("torque", math.nan),
    0x26: ("position", math.nan),
    0x27: ("time", 0.0),
    0x28: ("velocity", math.nan),
    0x29: ("acceleration", math.nan),
    0x2B: ("share", 1.0),
    0x2D: ("count", 0.0),
    0x40: ("position", 0.0),
    0x41: ("position", 0.0),
}
SHADOWS: Mapping[int, int] = {  # the same registers, beside the bounds of "stay within"
    0x42: 0x22,
    0x43: 0x23,
    0x44: 0x24,
    0x45: 0x25,
    0x46: 0x27,
    0x47: 0x2B,
    0x48: 0x2D,
}
NOT_EMULATED = frozenset((0x10, 0x11, 0x12, 0x14, 0x15, 0x16, 0x2A, 0x2C))
"""Raw voltages of the phases and overrides of the control: a command that writes one is not obeyed at all."""

MEASURED: Mapping[int, str] = {
    0x01: "position",
    0x02: "velocity",
    0x03: "torque",
    0x04: "current",
    0x05: "current",
    0x07: "power",
    0x0A: "temperature",
    0x0B: "count",
    0x0C: "count",
    0x0D: "voltage",
    0x0E: "temperature",
    0x38: "position",
    0x39: "velocity",
    0x3A: "torque",
    0x50: "position",
    0x51: "velocity",
}


class Subframe(NamedTuple):
    """One register written or read (``code`` 0x00, 0x10), or bytes or a poll of the diagnostic stream (0x40, 0x42)."""

    code: int
    register: int  # or the stream's channel
    kind: int = INT8
    raw: float = 0.0  # or the most bytes of an answer
    data: bytes = b""


def subframes(payload: bytes) -> tuple[list[Subframe], bool]:
    """Return what a frame carries before it is cut off or goes on in an unknown way, and whether it does neither."""
    found: list[Subframe] = []
    at = 0
    try:
        while at < len(payload):
            code = payload[at]
            at += 1
            if code == 0x50:
                continue
            if code in (0x40, 0x42):
                channel, at = _number(payload, at)
                size, at = _number(payload, at)
                data = payload[at : at + size] if code == 0x40 else b""
                if code == 0x40 and len(data) < size:
                    return found, False
                at += len(data)
                found.append(Subframe(code, channel, raw=size, data=data))
                continue
            if code >= 0x20:
                return found, False
            kind = code >> 2 & 3
            count = code & 3
            if not count:
                count, at = _number(payload, at)
            first, at = _number(payload, at)
            for register in range(first, first + count):
                raw = 0.0
                if code < 0x10:
                    (raw,) = struct.unpack_from(_FORMATS[kind], payload, at)
                    at += struct.calcsize(_FORMATS[kind])
                found.append(Subframe(code & 0x10, register, kind, raw))
                if len(found) > 64 * 8:  # more than any answer can carry
                    return found, False
    except (IndexError, struct.error):
        return found, False
    return found, True


def physical(kind: int, raw: float, quantity: str) -> float:
    """Return a raw value in rev, rev/s, N·m, s, A, V; NaN for the least integer."""
    if kind == FLOAT:
        return raw
    lowest = -(1 << (8 << kind) - 1)
    return math.nan if raw == lowest else raw * _SCALES[quantity][kind]


def raw_of(kind: int, value: float, quantity: str) -> float:
    """Return a value as its type carries it, saturated; the least integer for what is no number."""
    if kind == FLOAT:
        return limited(value, _MOST_FLOAT) if math.isfinite(value) else value
    most = (1 << (8 << kind) - 1) - 1
    return -most - 1 if not math.isfinite(value) else int(limited(value / _SCALES[quantity][kind], most))


def varuint(value: int) -> bytes:
    """Return a number of 7 bits a byte, least first."""
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes((*parts, value))


def _number(payload: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = payload[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if not byte & 0x80:
            return value, at


class Answer:
    """The subframes of one answer: values of registers that follow each other share one, and none is cut off."""

    def __init__(self) -> None:
        self._whole = b""
        self._first, self._kind = 0, INT8
        self._values: list[bytes] = []

    def value(self, register: int, kind: int, raw: float) -> None:
        """Tell the raw value of a register."""
        if self._values and (kind != self._kind or register != self._first + len(self._values)):
            self._close()
        if not self._values:
            self._first, self._kind = register, kind
        self._values.append(struct.pack(_FORMATS[kind], raw))

    def error(self, code: int, register: int, error: int) -> None:
        """Tell why a register was not written (``WRITE_ERROR``) or read (``READ_ERROR``)."""
        self.add(bytes((code,)) + varuint(register) + varuint(error))

    def add(self, subframe: bytes) -> None:
        """Tell something else; what the frame has no room for is left out."""
        self._close()
        if len(self._whole) + len(subframe) <= _MOST_BYTES:
            self._whole += subframe

    def payload(self) -> bytes:
        """Return all of it, filled up to a length that a CAN FD frame can have."""
        self._close()
        return self._whole.ljust(min(length for length in _LENGTHS if length >= len(self._whole)), b"\x50")

    def _close(self) -> None:
        values, self._values = self._values, []
        while values:
            count = len(values)
            head = bytes((0x20 | self._kind << 2 | (count if count <= 3 else 0),))
            head += (b"" if count <= 3 else varuint(count)) + varuint(self._first)
            subframe = head + b"".join(values)
            if len(self._whole) + len(subframe) <= _MOST_BYTES:
                self._whole += subframe
                return
            values.pop()
