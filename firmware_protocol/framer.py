"""The framing of a serial line in Python, without I/O: frames to bytes, and any bytes back to frames.

On the wire a frame is ``COBS(id16 LE | sequence8 | payload | CRC16-CCITT-FALSE LE) 00`` (PROTOCOL.md, "Serial
framing"). A zero byte ends a frame and occurs nowhere else, so that a receiver resynchronises at the next zero after a
disturbance.

Runs use ``firmware_protocol.host_line`` instead, which calls the firmware's C code. This module is independent of that
code, so that it can be used to check a firmware.
"""

from binascii import crc_hqx
from struct import Struct

from cobs import cobs

from firmware_protocol.framing import CAUSES, CRC_START, Frame, unsendable
from firmware_protocol.generated.messages import LENGTHS, Estop

_HEADER = 3  # id16, sequence8
_CRC = 2
_SIZES = {number: _HEADER + length + _CRC for number, length in LENGTHS.items()}  # of a frame before COBS
MAX_ENCODED = _HEADER + max(LENGTHS.values()) + _CRC + 1
"""Bytes of the longest frame on the wire without its zero; COBS adds one byte to less than 254."""

_UNPACK = [Struct(f"<HB{max(0, size - _HEADER - _CRC)}sH").unpack for size in range(MAX_ENCODED)]
# By the size of a frame before COBS, which is at least one byte less than after it.


class Framer:
    """The sending side of one serial line: counts the frames that it sends, modulo 256."""

    def __init__(self) -> None:
        self._sequence = 0

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire, with the final zero; an ESTOP also has a zero before it.

        Raises ValueError when no message has the frame's id, or when the payload does not have the id's length: the
        other side would drop it.
        """
        number, payload = frame
        if LENGTHS.get(number) != len(payload):
            raise unsendable(frame)
        body = (number | self._sequence << 16).to_bytes(_HEADER, "little") + payload
        self._sequence = (self._sequence + 1) & 0xFF
        encoded: bytes = cobs.encode(body + crc_hqx(body, CRC_START).to_bytes(_CRC, "little"))
        # The leading zero ends a partial frame that the line may still hold, so that an emergency stop is not lost
        # behind it.
        return b"\0" + encoded + b"\0" if number == Estop.ID else encoded + b"\0"


class Deframer:
    """The receiving side of one serial line. Raises no error: what is not a valid frame is dropped and counted.

    ``rejected`` counts dropped frames by cause: ``cobs`` (not a COBS encoding), ``crc``, ``length`` (not the length of
    its id, or too short for a frame), ``unknown_id``, and ``overrun`` (more bytes without a zero than the longest frame
    has). ``lost`` counts the frames that the sender numbered but that did not arrive intact; 128 and more in a row go
    unnoticed. ``bytes`` and ``frames`` count received bytes and returned frames. Memory is bounded by one frame.
    """

    def __init__(self) -> None:
        self.rejected: dict[str, int] = dict.fromkeys(CAUSES, 0)
        self.bytes = 0
        self.frames = 0
        self.lost = 0
        self._open = b""
        self._overrun = False
        self._expected_sequence: int | None = None

    def feed(self, data: bytes) -> list[Frame]:
        """Take the bytes that arrived, in pieces of any size, and return the frames that they complete."""
        self.bytes += len(data)
        *ended, rest = data.split(b"\0")
        if ended and (self._open or self._overrun):
            self._append(ended[0])
            ended[0], self._open, self._overrun = self._open, b"", False
        frames = []
        decode, expected = cobs.decode, self._expected_sequence
        for encoded in ended:
            if not encoded:
                continue  # two zeros in a row are no error: a sender may start with one to clear the line
            if len(encoded) > MAX_ENCODED:
                self.rejected["overrun"] += 1
                continue
            try:
                body: bytes = decode(encoded)
            except cobs.DecodeError:
                self.rejected["cobs"] += 1
                continue
            size = len(body)
            if size < _HEADER + _CRC:
                self.rejected["length"] += 1
                continue
            number, sequence, payload, crc = _UNPACK[size](body)
            if crc_hqx(body[:-_CRC], CRC_START) != crc:
                self.rejected["crc"] += 1
                continue
            if sequence != expected:
                self._count_lost(sequence, expected)  # the CRC is right, so the sender has sent it, whatever its id
            expected = (sequence + 1) & 0xFF
            if _SIZES.get(number) == size:
                frames.append(Frame(number, payload))
            else:
                self.rejected["length" if number in _SIZES else "unknown_id"] += 1
        self._expected_sequence = expected
        self.frames += len(frames)
        if rest:
            self._append(rest)
        return frames

    def _append(self, piece: bytes) -> None:
        if self._overrun:
            return
        self._open += piece[: MAX_ENCODED + 1]
        if len(self._open) > MAX_ENCODED:
            self.rejected["overrun"] += 1
            self._overrun = True
            self._open = b""

    def _count_lost(self, sequence: int, expected: int | None) -> None:
        """Count the frames missing before this one. ``expected`` is the expected number, None before the first
        frame.
        """
        if expected is not None:
            missing = (sequence - expected) & 0xFF
            # Half the circle or more is a repeated frame or a restarted sender: nothing was lost.
            self.lost += missing if missing < 128 else 0
