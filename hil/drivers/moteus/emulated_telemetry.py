"""The telemetry channels of an emulated moteus, in the binary form that moteus_tool reads: schema and data.

A schema is an object. It lists for each field flags, name, aliases, type, and whether it has a default; a field of type
0 ends it. Numbers are little-endian. Source: the reader of the maker's package ``moteus``.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hil.drivers.moteus.emulated_servo import Servo
from hil.drivers.moteus.frames import FIRMWARE, INT32, MODEL, varuint

_OBJECT, _END, _FIXED_ARRAY = 16, 0, 19
_TYPES: Mapping[str, bytes] = {  # by the format letter of ``struct``
    "?": b"\x02",
    "b": b"\x03\x01",
    "i": b"\x03\x04",
    "B": b"\x04\x01",
    "I": b"\x04\x04",
    "Q": b"\x04\x08",
    "f": b"\x07",
}


class _Field(NamedTuple):
    name: str
    letter: str
    value: float | Sequence[int]


def channels(servo: Servo) -> Mapping[str, Sequence[_Field]]:
    """Return the current fields of each channel, by its name."""
    serial = [int(servo.read(0x120 + i, INT32) or 0) for i in range(3)]
    measured = servo.measured
    return {
        "firmware": [
            _Field("version", "I", servo.read(FIRMWARE, INT32) or 0),
            _Field("serial_number", "I", serial),
            _Field("model", "I", servo.read(MODEL, INT32) or 0),
        ],
        "git": [_Field("hash", "B", bytes(20)), _Field("dirty", "?", 0), _Field("timestamp", "Q", 0)],
        "servo_stats": [
            _Field("mode", "b", servo.mode),
            _Field("fault", "i", servo.fault),
            _Field("position", "f", measured[0x01]),
            _Field("velocity", "f", measured[0x02]),
            _Field("torque_Nm", "f", measured[0x03]),
            _Field("q_A", "f", measured[0x04]),
            _Field("d_A", "f", measured[0x05]),
            _Field("bus_V", "f", measured[0x0D]),
            _Field("fet_temp_C", "f", measured[0x0E]),
            _Field("motor_temp_C", "f", measured[0x0A]),
            _Field("timeout_s", "f", servo.timeout_s),
            _Field("trajectory_done", "?", measured[0x0B]),
        ],
    }


def schema(fields: Sequence[_Field]) -> bytes:
    """Return the binary schema of a channel with these fields."""
    encoded = [bytes((_OBJECT, 0))]
    for field in fields:
        kind = _TYPES[field.letter]
        if isinstance(field.value, Sequence):
            kind = bytes((_FIXED_ARRAY,)) + varuint(len(field.value)) + kind
        encoded.append(_named(field.name) + kind + b"\0")
    return b"".join([*encoded, _named(""), bytes((_END, 0))])


def data(fields: Sequence[_Field]) -> bytes:
    """Return the binary data of a channel with these fields."""
    values = ((field.letter, field.value if isinstance(field.value, Sequence) else [field.value]) for field in fields)
    return b"".join(
        struct.pack(f"<{letter}", one if letter == "f" else int(one)) for letter, ones in values for one in ones
    )


def _named(name: str) -> bytes:
    return b"\0" + varuint(len(name)) + name.encode("ascii") + b"\0"
