"""Frames as rows of bytes, for the ring buffer between a run and its trace writer.

A row is four doubles, Unix time [µs], flags, identifier and length, and the payload, padded with zeros. With the flag
PACKED it holds frames that crossed the wire together, as ``PackedFrames`` has them, and the identifier is 0.
"""

import struct
from collections.abc import Callable, Iterator
from typing import Any

from firmware_protocol.host_line import PackedFrames

SENT, EXTENDED, REMOTE, ERROR, FD, SWITCHED, PACKED = (1 << place for place in range(7))

MOST_CLASSIC_BYTES, MOST_BYTES = 8, 64
MOST_PACKED = 128
"""The most bytes of frames that a row holds."""
_ROW = struct.Struct(f"4d{MOST_PACKED}s")
WIDTH = _ROW.size // 8


pack: Callable[[int, int, int, int, bytes], bytes] = _ROW.pack
"""Returns the row of a Unix time [µs], flags, identifier, length of the payload, or the one that a remote frame
requests, and payload."""


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


def unpack(row: bytes) -> Iterator[dict[str, Any]]:
    """Yield the arguments of ``can.Message`` for each frame of a row."""
    *numbers, content = _ROW.unpack(row)
    unix_us, flags, number, length = map(int, numbers)
    remote = bool(flags & REMOTE)
    frames = PackedFrames(content[:length]) if flags & PACKED else [(number, content[:length])]
    for number, payload in frames:
        yield {
            "timestamp": unix_us * 1e-6,
            "arbitration_id": number,
            "is_extended_id": bool(flags & EXTENDED),
            "is_remote_frame": remote,
            "is_error_frame": bool(flags & ERROR),
            "is_fd": bool(flags & FD),
            "bitrate_switch": bool(flags & SWITCHED),
            "is_rx": not flags & SENT,
            "dlc": len(payload) if flags & PACKED else length,
            "data": None if remote else payload,
        }
