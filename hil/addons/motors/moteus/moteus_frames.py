"""The codec of moteus frames, for driver and emulated device: subframes that write, read and answer registers.

One CAN FD frame carries several subframes; numbers are little-endian. A subframe is a code, the number of registers (in
the code's two lowest bits for 1 to 3), the first register, and one value per register if it writes or answers. Bits 2
and 3 of the code give the type: int8, int16, int32 or float. Whole numbers count in steps whose size depends on the
register's quantity; the lowest number of each type stands for NaN.
Source: mjbots moteus, docs/protocol/can.md and docs/protocol/registers.md.
"""

import math
import struct
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import NamedTuple

from hil.core.types import NAN
from hil.robot.driver import clamp

MODE, POSITION, VELOCITY, Q_CURRENT, VOLTAGE, TEMPERATURE, FAULT = 0x000, 0x001, 0x002, 0x004, 0x00D, 0x00E, 0x00F
COMMAND_POSITION, COMMAND_MAX_TORQUE, COMMAND_TIMEOUT, COMMAND_ILIMIT_SCALE = 0x020, 0x025, 0x027, 0x02B
MODEL, FIRMWARE, REGISTER_MAP = 0x100, 0x101, 0x102

INT8, INT16, INT32, FLOAT = range(4)

FAULTS: Mapping[int, str] = {
    32: "calibration fault: no magnet was seen by the encoder",
    33: "motor driver fault, most often a supply that gives in",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not configured, run moteus_tool --calibrate",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "outside servopos.position_min and position_max, which a wheel should not have",
    40: "under voltage",
    41: "a configuration was changed while it ran",
    42: "no valid commutation encoder",
    43: "no valid output encoder",
    44: "the gate driver could not be enabled",
    45: "stop position with limits of velocity or acceleration",
    46: "timing violation",
    47: "servo.bemf_feedforward without an acceleration limit",
    48: "invalid limits in servopos",
}
"""Fault codes of register 0x00f. Codes from 96 on only say what limits the power."""

_QUANTITIES = (
    ((1e-2, 1e-4, 1e-5), (0x01, 0x20)),  # position [rev]
    ((1e-1, 2.5e-4, 1e-5), (0x02, 0x21)),  # velocity [rev/s]
    ((5e-1, 1e-2, 1e-3), (0x03, 0x22, 0x25)),  # torque [N·m]
    ((1 / 127, 1 / 32767, 1 / 2147483647), (0x23, 0x24, 0x2B)),  # share
    ((1e-2, 1e-3, 1e-6), (0x27,)),  # time [s]
    ((1.0, 1e-1, 1e-3), (0x04,)),  # current [A]
    ((5e-1, 1e-1, 1e-3), (0x0D,)),  # voltage [V]
    ((1.0, 1e-1, 1e-3), (0x0E,)),  # temperature [°C]
)
"""The quantities: one count as int8, int16 and int32, and the registers. All others have plain whole numbers."""
_STEPS = {register: steps for steps, registers in _QUANTITIES for register in registers}

WRITE, READ, REPLY = 0x00, 0x10, 0x20
WRITE_ERROR, READ_ERROR = 0x30, 0x31
_NOP = 0x50
_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)  # that a CAN FD frame can have
_MAX_REGISTERS = 64 * 8  # more than any frame can answer
_FORMATS = ("<b", "<h", "<i", "<f")
_MAX_FLOAT = 3.4028234663852886e38


class Subframe(NamedTuple):
    """One register: ``code`` is WRITE, READ, REPLY, WRITE_ERROR or READ_ERROR, ``kind`` the type, INT8 to FLOAT.

    ``raw`` is the value, of an error its number.
    """

    code: int
    register: int
    kind: int = INT8
    raw: float = 0.0


def write_mode(mode: int) -> bytes:
    """Return the subframe that asks for a mode. It goes before all other registers of the frame."""
    return bytes((WRITE | 1, MODE, mode))


def write_floats(first: int, *values: float) -> bytes:
    """Return the subframe that writes consecutive registers from ``first`` on as floats."""
    return header(WRITE, FLOAT, first, len(values)) + struct.pack(f"<{len(values)}f", *values)


def read(kind: int, first: int, count: int = 1) -> bytes:
    """Return the subframe that asks for ``count`` registers from ``first`` on as one of the four types."""
    return header(READ, kind, first, count)


def header(code: int, kind: int, first: int, count: int) -> bytes:
    """Return the beginning of a subframe for ``count`` registers from ``first`` on; values follow it."""
    code |= kind << 2
    return (bytes((code | count,)) if count <= 3 else bytes((code,)) + varuint(count)) + varuint(first)


def varuint(value: int) -> bytes:
    """Return a number in bytes of 7 bits each, least significant first."""
    return bytes((value,)) if value < 0x80 else bytes((value & 0x7F | 0x80,)) + varuint(value >> 7)


def pack(kind: int, raw: float) -> bytes:
    """Return the bytes of a raw value."""
    return struct.pack(_FORMATS[kind], raw)


def padded(payload: bytes) -> bytes:
    """Return a payload of up to 64 bytes, filled with empty subframes to a length that a CAN FD frame can have."""
    return payload.ljust(next(length for length in _LENGTHS if length >= len(payload)), bytes((_NOP,)))


def physical(register: int, kind: int, raw: float) -> float:
    """Return a raw value in rev, rev/s, N·m, s, A, V, °C or W; NaN for the lowest whole number of its type."""
    if kind == FLOAT or register not in _STEPS:
        return raw
    return NAN if raw == -(1 << (8 << kind) - 1) else raw * _STEPS[register][kind]


def raw_of(register: int, kind: int, value: float) -> float:
    """Return a value of a quantity as its type carries it, saturated; the lowest whole number if it is not finite."""
    if kind == FLOAT:
        return clamp(value, _MAX_FLOAT) if math.isfinite(value) else value
    most = (1 << (8 << kind) - 1) - 1
    if not math.isfinite(value):
        return -most - 1
    return int(clamp(value / _STEPS[register][kind], most))


def parse_reply(payload: bytes) -> dict[int, float] | None:
    """Return the registers of an answer in the units of ``physical``; None if it is damaged or not an answer."""
    found, is_whole = subframes(payload)
    if not is_whole or any(one.code not in (REPLY, WRITE_ERROR, READ_ERROR) for one in found):
        return None
    values = [one for one in found if one.code == REPLY]
    if any(one.register not in _STEPS and not math.isfinite(one.raw) for one in values):
        return None
    return {one.register: physical(one.register, one.kind, one.raw) for one in values}


def subframes(payload: bytes) -> tuple[list[Subframe], bool]:
    """Return the subframes up to the first unknown or incomplete one, and whether there was no such one."""
    found: list[Subframe] = []
    rest = iter(payload)
    try:
        for code in rest:
            if code == _NOP:
                continue
            if code in (WRITE_ERROR, READ_ERROR):
                found.append(Subframe(code, _varuint(rest), raw=_varuint(rest)))
                continue
            operation, kind, count = code & 0xF0, code >> 2 & 3, code & 3
            if operation > REPLY:
                return found, False
            count = count or _varuint(rest)
            first = _varuint(rest)
            for register in range(first, first + count):
                data = b"" if operation == READ else bytes(islice(rest, struct.calcsize(_FORMATS[kind])))
                raw = 0.0 if operation == READ else struct.unpack(_FORMATS[kind], data)[0]
                found.append(Subframe(operation, register, kind, raw))
                if len(found) > _MAX_REGISTERS:
                    return found, False
    except (StopIteration, struct.error):
        return found, False
    return found, True


def _varuint(rest: Iterator[int]) -> int:
    byte = next(rest)
    return byte if byte < 0x80 else byte & 0x7F | _varuint(rest) << 7
