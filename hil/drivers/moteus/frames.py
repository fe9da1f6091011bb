"""The frames of moteus: registers written, read and answered, several in one CAN FD frame; numbers least byte first.

A subframe is a code, the number of registers (in the code's two lowest bits where it is 1 to 3), the first register,
and a value each where it writes or answers. Bits 2 and 3 of the code tell the type: int8, int16, int32 or float; the
whole numbers count in steps of a size that the register's quantity gives, and the lowest of each type is NaN.
Source: mjbots moteus, docs/protocol/can.md and docs/protocol/registers.md.
"""

import math
from collections.abc import Mapping
from struct import Struct
from struct import error as struct_error

from hil.core.types import NAN

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
"""Fault codes of register 0x00f. Those from 96 on only say what limits the power."""

_STEPS: Mapping[int, tuple[float, float, float]] = {
    POSITION: (0.01, 0.0001, 0.00001),
    VELOCITY: (0.1, 0.00025, 0.00001),
    Q_CURRENT: (1.0, 0.1, 0.001),
    VOLTAGE: (0.5, 0.1, 0.001),
    TEMPERATURE: (1.0, 0.1, 0.001),
    COMMAND_TIMEOUT: (0.01, 0.001, 0.000001),
}
"""What one count is as int8, int16 and int32 [rev, rev/s, A, V, °C, s]. Registers that are not here count things."""

_TYPES = (Struct("<b"), Struct("<h"), Struct("<i"), Struct("<f"))
_LOWEST = (-(2**7), -(2**15), -(2**31))
_WRITE, _READ, _REPLY = 0x00, 0x10, 0x20
_ERRORS = (0x30, 0x31)  # a register that could not be written or read, and why
_NOP = 0x50
_LENGTHS = (12, 16, 20, 24, 32, 48, 64)  # of CAN FD frames with more than 8 bytes


def write_mode(mode: int) -> bytes:
    """Return the subframe that asks for a mode; it goes before all other registers of the frame."""
    return bytes((_WRITE | 1, MODE, mode))


def write_floats(first: int, *values: float) -> bytes:
    """Return the subframe that writes registers from ``first`` on as floats."""
    return _header(_WRITE | FLOAT << 2, first, len(values)) + b"".join(map(_TYPES[FLOAT].pack, values))


def read(kind: int, first: int, count: int = 1) -> bytes:
    """Return the subframe that asks for registers from ``first`` on as one of the four types."""
    return _header(_READ | kind << 2, first, count)


def padded(payload: bytes) -> bytes:
    """Fill a payload with empty subframes to a length that a CAN FD frame can have."""
    size = len(payload)
    return (
        payload if size <= 8 else payload.ljust(next(length for length in _LENGTHS if length >= size), bytes((_NOP,)))
    )


def parse_reply(payload: bytes) -> dict[int, float] | None:
    """Return the registers of an answer in rev, rev/s, A, V, °C and s; None for what is no whole answer."""
    values: dict[int, float] = {}
    at = 0
    try:
        while at < len(payload):
            code = payload[at]
            at += 1
            if code == _NOP:
                continue
            if code in _ERRORS:
                _, at = _varuint(payload, at)
                _, at = _varuint(payload, at)
                continue
            if code & 0xF0 != _REPLY:
                return None
            kind, count = code >> 2 & 3, code & 3
            if not count:
                count, at = _varuint(payload, at)
            first, at = _varuint(payload, at)
            for register in range(first, first + count):
                (raw,) = _TYPES[kind].unpack_from(payload, at)
                at += _TYPES[kind].size
                if register not in _STEPS and not math.isfinite(raw):  # what counts things is a number
                    return None
                values[register] = _scaled(register, kind, raw)
    except (IndexError, struct_error):  # cut off
        return None
    return values


def _scaled(register: int, kind: int, raw: float) -> float:
    steps = _STEPS.get(register)
    if kind == FLOAT or steps is None:
        return raw
    return NAN if raw == _LOWEST[kind] else raw * steps[kind]


def _header(code: int, first: int, count: int) -> bytes:
    begin = bytes((code | count,)) if count <= 3 else bytes((code, count))
    return begin + (bytes((first,)) if first < 0x80 else bytes((first & 0x7F | 0x80, first >> 7)))


def _varuint(data: bytes, at: int) -> tuple[int, int]:
    """Return a number of 7 bits a byte, least first, and where the next thing is. Raises IndexError beyond the end."""
    value = 0
    for shift in range(0, 35, 7):
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise IndexError
