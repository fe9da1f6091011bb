"""A frame as a row of floats, for the ring buffer between a run and its trace writer.

A row is: Unix time [µs], flags, identifier, length, and 64 bytes of payload in 16 words of 32 bits. All are whole
numbers that a float64 holds exactly.
"""

import struct
from collections.abc import Sequence
from typing import Any

SENT, EXTENDED, REMOTE, ERROR, FD, SWITCHED = (1 << place for place in range(6))

MOST_CLASSIC_BYTES, MOST_BYTES = 8, 64
_WORDS = MOST_BYTES // 4
_PAD = struct.Struct("<16I")
WIDTH = 4 + _WORDS
_ROW = struct.Struct(f"{WIDTH}d")


def pack(unix_us: int, flags: int, number: int, length: int, payload: bytes) -> bytes:
    """Return the row; ``length`` is that of the payload, or the one that a remote frame requests."""
    return _ROW.pack(unix_us, flags, number, length, *_PAD.unpack(payload.ljust(_PAD.size, b"\0")))


def pack_message(unix_us: int, message: Any) -> bytes:
    """Return the row of a ``can.Message`` that was received."""
    kinds = (
        (EXTENDED, message.is_extended_id),
        (REMOTE, message.is_remote_frame),
        (ERROR, message.is_error_frame),
        (FD, message.is_fd),
        (SWITCHED, message.bitrate_switch),
    )
    flags = sum(flag for flag, holds in kinds if holds)
    return pack(unix_us, flags, message.arbitration_id, message.dlc, bytes(message.data))


def unpack(row: Sequence[float]) -> dict[str, Any]:
    """Return the arguments of ``can.Message``."""
    unix_us, flags, number, length, *words = (int(value) for value in row)
    payload = _PAD.pack(*words)[:length]
    remote = bool(flags & REMOTE)
    return {
        "timestamp": unix_us * 1e-6,
        "arbitration_id": number,
        "is_extended_id": bool(flags & EXTENDED),
        "is_remote_frame": remote,
        "is_error_frame": bool(flags & ERROR),
        "is_fd": bool(flags & FD),
        "bitrate_switch": bool(flags & SWITCHED),
        "is_rx": not flags & SENT,
        "dlc": length,
        "data": None if remote else payload,
    }
