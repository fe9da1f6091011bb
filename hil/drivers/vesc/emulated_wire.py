"""The wire format of a VESC's messages, written from its specification and independently of the driver."""

import math
import struct
from binascii import crc_hqx
from collections.abc import Iterator

_MAX_BYTES = 512


def can_parts(sender: int, message: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield command and data of the CAN frames of an answer: one for up to 6 bytes, else its pieces and a last one."""
    if len(message) <= 6:
        yield 8, bytes((sender, 1)) + message
        return
    offset = 0
    while offset < len(message):
        if offset <= 255:
            yield 5, bytes((offset,)) + message[offset : offset + 7]
            offset += 7
        else:
            yield 6, offset.to_bytes(2, "big") + message[offset : offset + 6]
            offset += 6
    yield 7, struct.pack(">BBHH", sender, 1, len(message), crc_hqx(message, 0))


def packet(message: bytes) -> bytes:
    """Return the packet of a message on the serial line."""
    size = len(message)
    head = bytes((3, size >> 8, size & 0xFF)) if size > 255 else bytes((2, size))
    return head + message + crc_hqx(message, 0).to_bytes(2, "big") + b"\x03"


def first_packet(data: bytes) -> tuple[int, bytes]:
    """Return the number of bytes to remove and the message in them, if any; 0 bytes if the packet is incomplete."""
    if data[0] not in (2, 3):
        return 1, b""
    head = data[0]
    if len(data) < head:
        return 0, b""
    length = int.from_bytes(data[1:head], "big")
    if not (1 if head == 2 else 255) <= length <= _MAX_BYTES:
        return 1, b""
    size = head + length + 3
    if len(data) < size:
        return 0, b""
    message = data[head : head + length]
    if data[size - 1] != 3 or crc_hqx(message, 0) != int.from_bytes(data[size - 3 : size - 1], "big"):
        return 1, b""
    return size, message


def float32_auto(value: float) -> bytes:
    """Return a number as in a configuration: sign, exponent of ``frexp`` plus 126, significand minus one half."""
    if abs(value) < 1.5e-38:
        return bytes(4)
    significand, exponent = math.frexp(abs(value))
    bits = (value < 0.0) << 31 | exponent + 126 << 23 | int((significand - 0.5) * 2**24)
    return bits.to_bytes(4, "big")
