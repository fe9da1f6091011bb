"""The messages of a WHEELTEC base: CAN frames, and the same numbers on its serial line."""

from functools import reduce
from operator import xor
from struct import Struct

from firmware_protocol.framing import Frame

COMMAND = 0x181
REPORTS = (0x101, 0x102, 0x103)
HEAD, TAIL = 0x7B, 0x7D
REPORT_BYTES = 24

COMMAND_NUMBERS = Struct(">3hxx")
IN_STEP = bytes(10)
"""Before each command on the serial line. The board takes eleven bytes from the first 7B that it sees, and the sum of a
stop is 7B: once a byte is lost, it would read stop after stop from the wrong place for ever. Ten bytes complete
whatever it has begun."""

_COMMAND_WIRE = Struct(">Bxx3h")


def checksum(data: bytes | bytearray) -> int:
    """Return the xor of bytes."""
    return reduce(xor, data, 0)


class WheeltecFraming:
    """A serial line's 24 bytes as the three frames of CAN, and a command's frame as its 11 bytes.

    ``rejected`` counts what had no end where it should, wrong sums, and bytes that belong to no frame.
    """

    def __init__(self) -> None:
        self.rejected = {"tail": 0, "checksum": 0, "stray": 0}
        self._buffer = bytearray()

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire. Raises ValueError for what is no command."""
        if frame.id != COMMAND or len(frame.payload) != COMMAND_NUMBERS.size:
            raise ValueError(f"frame 0x{frame.id:X} with {len(frame.payload)} bytes: expected 0x181 with 8")
        # The third byte is 0 in newer firmware for: stop when commands end.
        body = _COMMAND_WIRE.pack(HEAD, *COMMAND_NUMBERS.unpack(frame.payload))
        return IN_STEP + body + bytes([checksum(body), TAIL])

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes in pieces of any size, and return the frames that they complete."""
        buffer = self._buffer
        buffer += data
        frames: list[Frame] = []
        at = 0
        while (begin := buffer.find(HEAD, at)) >= 0 and begin + REPORT_BYTES <= len(buffer):
            self.rejected["stray"] += begin - at
            whole = bytes(buffer[begin : begin + REPORT_BYTES])
            if whole[-1] != TAIL:
                self.rejected["tail"] += 1
                at = begin + 1  # a byte of the data may look like a head
            elif checksum(whole[:-2]) != whole[-2]:
                self.rejected["checksum"] += 1
                at = begin + 1
            else:
                frames += (Frame(number, whole[8 * i : 8 * i + 8]) for i, number in enumerate(REPORTS))
                at = begin + REPORT_BYTES
        begin = len(buffer) if begin < 0 else begin
        self.rejected["stray"] += begin - at
        del buffer[:begin]
        return frames
