"""Counts what frames use on a CAN bus. Their length in bits, including stuff bits, is by ISO 11898-1:2015.

Counted from the start of frame to the end of the three bits between frames. After five equal bits a transmitter inserts
their complement: in a classic frame from the start of frame to the end of the CRC, in an FD frame to the end of the
data. The FD frame's CRC field has its stuff bits at fixed places. So the length of a classic frame depends on its CRC.
Both are computed with tables, a byte at a time.
"""

from bisect import bisect_left
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from firmware_protocol.framing import Frame
from hil.core.ports import EXTENDED, REMOTE
from hil.wire.link_statistics import Count

_CRC_POLYNOMIAL, _CRC_BITS = 0x4599, 15  # CRC-15/CAN
_CLASSIC_TAIL = 13  # CRC delimiter, acknowledgement and its delimiter, end of frame 7, intermission 3
_FD_TAIL = 12  # the same without the CRC delimiter, which still belongs to the data phase
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
_RUNS = tuple(bit * length for bit in "01" for length in (1, 2, 3, 4))  # after the fifth comes a stuff bit


class FrameBits(NamedTuple):
    """Bits of an FD frame at the nominal bit rate, and at the data phase's own bit rate (0 if it has none)."""

    nominal: int
    data: int


def _stuffing(run: str, byte: int) -> tuple[int, int]:
    """Return how many stuff bits a byte gets after a run, and 256 times the number of the run that it ends with."""
    stuffed = 0
    for bit in f"{byte:08b}":
        run = run + bit if bit == run[0] else bit
        if len(run) == 5:
            run, stuffed = "10"[int(bit)], stuffed + 1
    return stuffed, _RUNS.index(run) << 8


def _crc_of(byte: int) -> int:
    crc = byte << _CRC_BITS - 8
    for _ in range(8):
        crc = (crc << 1 ^ (_CRC_POLYNOMIAL if crc >> _CRC_BITS - 1 else 0)) & 0x7FFF
    return crc


_STUFFING = tuple(_stuffing(run, byte) for run in _RUNS for byte in range(256))
_CRC_OF = tuple(_crc_of(byte) for byte in range(256))


def _crc(bits: int, length: int) -> int:
    """Return the CRC-15. Zeros before the first bit do not change it, so the bits may be taken as whole bytes."""
    crc = 0
    for byte in bits.to_bytes(length + 7 >> 3):
        crc = (crc << 8 & 0x7FFF) ^ _CRC_OF[crc >> 7 ^ byte]
    return crc


def _stuff_bits(bits: int, length: int) -> int:
    """Return the number of stuff bits of a frame's beginning. Changing bits before it, which get none, fill a byte."""
    total = run = 0
    padded = bits | (0x55 & 0xFF >> (length & 7)) << length
    for byte in padded.to_bytes((length >> 3) + 1):
        stuffed, run = _STUFFING[run | byte]
        total += stuffed
    return total


@lru_cache(maxsize=4096)  # other nodes' frames may have any identifier
def _header(number: int, extended: bool, remote: int, rest: str) -> tuple[int, int]:
    """Return bits and length of a frame up to its data; ``rest`` follows the bit with the identifier format."""
    identifier = f"{number >> 18:011b}11{number & 0x3FFFF:018b}{remote}" if extended else f"{number:011b}{remote}0"
    return int(identifier + rest, 2), 1 + len(identifier) + len(rest)


def classic_bits(number: int, payload: bytes, *, extended: bool = False, remote_length: int | None = None) -> int:
    """Return the bits of a classic frame; ``remote_length`` is the data length that a remote frame requests."""
    remote, code = (0, len(payload)) if remote_length is None else (1, min(remote_length, 15))
    bits, length = _header(number, extended, remote, f"{'00' if extended else '0'}{code:04b}")
    bits, length = bits << 8 * len(payload) | int.from_bytes(payload), length + 8 * len(payload)
    bits, length = bits << _CRC_BITS | _crc(bits, length), length + _CRC_BITS
    return length + _stuff_bits(bits, length) + _CLASSIC_TAIL


def fd_bits(number: int, payload: bytes, *, extended: bool = False, switched: bool) -> FrameBits:
    """Return the bits of an FD frame; ``switched``: its data phase has its own bit rate."""
    arbitration, slow = _header(number, extended, 0, f"10{int(switched)}")
    header = arbitration << 5 | bisect_left(_FD_LENGTHS, len(payload))
    bits, length = header << 8 * len(payload) | int.from_bytes(payload), slow + 5 + 8 * len(payload)
    # No stuff bit follows the last bit: the CRC field begins with a fixed one.
    crc_field = 4 + (17 if len(payload) <= 16 else 21)
    total = length + _stuff_bits(bits >> 1, length - 1) + crc_field + -(-crc_field // 4) + 1 + _FD_TAIL
    # A stuff bit that follows the arbitration belongs to the data phase.
    nominal = slow + _stuff_bits(arbitration >> 1, slow - 1) + _FD_TAIL if switched else total
    return FrameBits(nominal, total - nominal)


_REMOTE_LENGTH = 8  # a remote frame requests the most that its answer may have


class BusMeter:
    """A CAN bus, classic or FD, with its bit rates [bit/s]; ``data_bitrate`` is FD's second one, if it has one."""

    duplex = False
    byte_ns = 0.0
    timed = True

    def __init__(self, bitrate: int, *, fd: bool = False, data_bitrate: int | None = None) -> None:
        self._is_fd = fd
        self._is_switched = data_bitrate is not None
        self._bit_ns = 1e9 / bitrate
        self._data_bit_ns = 1e9 / (data_bitrate or bitrate)
        self.begin()

    def begin(self) -> None:
        self._sent = self._received = self.foreign = Count()

    def sent(self, frames: Sequence[Frame]) -> int:
        """Count the ``frames`` that were sent since the last call; return how long they occupy the wire [ns]."""
        self._sent, busy_ns = self._counted(self._sent, frames)
        return busy_ns

    def received(self, frames: Sequence[Frame]) -> int:
        """Count the ``frames`` that were received since the last call; return how long they occupied the wire [ns]."""
        self._received, busy_ns = self._counted(self._received, frames)
        return busy_ns

    def _counted(self, count: Count, frames: Sequence[Frame]) -> tuple[Count, int]:
        payload_bytes = sum(len(frame.payload) for frame in frames)
        counted = Count(count.frames + len(frames), count.bytes + payload_bytes)
        return counted, sum(map(self._ours_ns, frames))

    def overheard(self, message: Any) -> int:
        """Count a ``can.Message`` of another node; return how long it occupied the bus [ns].

        An error frame's length cannot be known.
        """
        foreign, is_error = self.foreign, message.is_error_frame
        self.foreign = Count(foreign.frames + 1, foreign.bytes + (0 if is_error else len(message.data)))
        return 0 if is_error else self._others_ns(message)

    def counts(self) -> tuple[Count, Count]:
        return self._sent, self._received

    def byte_counts(self) -> tuple[float, float]:
        return self._sent.bytes, self._received.bytes

    def _ours_ns(self, frame: Frame) -> int:
        number, payload = frame
        identifier, extended = number & ~(EXTENDED | REMOTE), number >= EXTENDED
        if number & REMOTE:
            return self._classic_ns(identifier, b"", extended, _REMOTE_LENGTH)
        if self._is_fd:
            return self._fd_ns(identifier, payload, extended, self._is_switched)
        return self._classic_ns(identifier, payload, extended)

    def _others_ns(self, message: Any) -> int:
        number, payload, extended = message.arbitration_id, bytes(message.data), message.is_extended_id
        if message.is_fd:
            return self._fd_ns(number, payload, extended, message.bitrate_switch)
        return self._classic_ns(number, payload, extended, message.dlc if message.is_remote_frame else None)

    def _classic_ns(self, number: int, payload: bytes, extended: bool, remote_length: int | None = None) -> int:
        return round(classic_bits(number, payload, extended=extended, remote_length=remote_length) * self._bit_ns)

    def _fd_ns(self, number: int, payload: bytes, extended: bool, switched: bool) -> int:
        nominal, data = fd_bits(number, payload, extended=extended, switched=switched)
        return round(nominal * self._bit_ns + data * self._data_bit_ns)
