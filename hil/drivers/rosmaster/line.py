"""The frames of a Rosmaster board on its serial line: ``FF FC`` or ``FF FB``, length, function, data, sum.

The board receives into one buffer, which a task looks at once a millisecond: of two frames within that time both may be
lost, even two that ask for a stop. So each frame is followed by a pause, made of bytes that begin none.
"""

from firmware_protocol.framing import Frame

PAUSE = bytes(18)
"""1.6 ms at 115200 baud; the maker's library, which waits 2 ms from write to write, leaves half of that."""

_TO_BOARD = b"\xff\xfc"
_FROM_BOARD = b"\xff\xfb"
_LEAST = 3  # length, function, sum
_MOST = 32  # the longest report, of an IMU, has 21


class RosmasterFraming:
    """The host's side. ``rejected`` counts lengths and sums that are wrong, and bytes that belong to no frame."""

    def __init__(self) -> None:
        self.rejected = {"length": 0, "checksum": 0, "stray": 0}
        self._buffer = bytearray()

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire. Raises ValueError for a payload that the board has no room for."""
        length = _LEAST + len(frame.payload)
        if length > _MOST:
            raise ValueError(f"a payload of {len(frame.payload)} bytes: expected at most {_MOST - _LEAST}")
        body = bytes([length, frame.id]) + frame.payload
        return _TO_BOARD + body + bytes([sum(body) & 0xFF]) + PAUSE

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes in pieces of any size, and return the frames that they complete."""
        buffer = self._buffer
        buffer += data
        frames: list[Frame] = []
        at = 0
        while (begin := buffer.find(_FROM_BOARD, at)) >= 0:
            self.rejected["stray"] += begin - at
            at = begin
            if begin + 2 >= len(buffer):
                break
            length = buffer[begin + 2]
            end = begin + 2 + length
            if not _LEAST <= length <= _MOST:
                self.rejected["length"] += 1
                at += 2
            elif end > len(buffer):
                break
            elif sum(buffer[begin + 2 : end - 1]) & 0xFF != buffer[end - 1]:
                # A frame that was cut may have the next one's beginning in it: look for it there.
                self.rejected["checksum"] += 1
                at += 2
            else:
                frames.append(Frame(buffer[begin + 3], bytes(buffer[begin + 4 : end - 1])))
                at = end
        else:
            keep = 1 if buffer[at:].endswith(_FROM_BOARD[:1]) else 0
            self.rejected["stray"] += len(buffer) - keep - at
            at = len(buffer) - keep
        del buffer[:at]
        return frames
