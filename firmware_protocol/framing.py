"""Frames: an identifier and a payload, and their layout in the memory of C. ``framer`` has the framing of a line."""

from binascii import crc_hqx
from collections.abc import Iterable
from struct import Struct
from typing import NamedTuple

from firmware_protocol.generated.messages import LENGTHS

CRC_START = 0xFFFF
CAUSES = ("cobs", "crc", "length", "unknown_id", "overrun")
"""Why a frame that arrives on a line is dropped."""


class Frame(NamedTuple):
    """An 11-bit identifier and the payload of its message: the same on serial and CAN."""

    id: int
    payload: bytes


_PACKED_HEADER = Struct("<HB")
PACKED_HEADERS = {(number, length): _PACKED_HEADER.pack(number, length) for number, length in LENGTHS.items()}
"""The bytes before the payload of a packed frame, by id and length, for all frames that can be sent."""


def pack(frames: Iterable[Frame]) -> bytes:
    """Return frames one after the other, in C's layout: id16 LE, length8, payload."""
    header = _PACKED_HEADER.pack
    return b"".join([header(number, len(payload)) + payload for number, payload in frames])


def packed_frame(packed: bytes, at: int) -> tuple[Frame, int]:
    """Return the packed frame at position ``at``, and the position of the next one."""
    number, length = _PACKED_HEADER.unpack_from(packed, at)
    begin = at + _PACKED_HEADER.size
    end = begin + length
    return Frame(number, packed[begin:end]), end


def crc16(data: bytes) -> int:
    """Return the CRC-16/CCITT-FALSE of ``data`` (polynomial 1021, start FFFF, not reflected, no final XOR).

    ``crc_hqx`` has the same polynomial and bit order and takes the start value: it is this CRC, compiled and
    in the standard library.

    >>> hex(crc16(b"123456789"))
    '0x29b1'
    """
    return crc_hqx(data, CRC_START)


def unsendable(frame: Frame) -> ValueError:
    """Return the error for a frame with an unknown id, or with another length than its id has."""
    length = LENGTHS.get(frame.id)
    expected = "the id of a message of wheel.dbc" if length is None else f"{length} bytes"
    return ValueError(f"frame {frame.id:#05x} with {len(frame.payload)} bytes: expected {expected}")
