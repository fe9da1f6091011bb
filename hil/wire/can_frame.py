"""The length of a CAN frame on the bus in bits, including stuff bits, by ISO 11898-1:2015.

Counted from the start of frame to the end of the three bits between frames. After five equal bits a transmitter inserts
their complement: in a classic frame from the start of frame to the end of the CRC, in an FD frame to the end of the
data; the FD frame's CRC field has its stuff bits at fixed places. So the length of a classic frame depends on its CRC,
which is computed here with tables, a byte at a time.
"""

from bisect import bisect_left
from functools import lru_cache
from typing import NamedTuple

_CRC_POLYNOMIAL = 0x4599  # CRC-15/CAN
_CRC_BITS = 15
_CLASSIC_TAIL = 13  # CRC delimiter, acknowledgement and its delimiter, end of frame 7, intermission 3
_FD_TAIL = 12  # the same without the CRC delimiter, which still belongs to the data phase
_FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


class FrameBits(NamedTuple):
    """Bits of an FD frame at the nominal bit rate, and at the data phase's own bit rate (0 if it has none)."""

    nominal: int
    data: int


class _Run(NamedTuple):
    """The last bit on the bus, and the number of equal bits that end with it: 1 to 4, because after the fifth comes a
    stuff bit.
    """

    bit: int
    length: int


class _Header(NamedTuple):
    """A frame up to its data: all bits, stuff bits at the nominal bit rate and after it, run, whether a stuff bit ends
    it, and CRC.
    """

    bits: int
    stuffed: int
    stuffed_fast: int
    run: int
    ends_stuffed: bool
    crc: int


def _stuff(run: _Run, bit: int) -> tuple[_Run, bool]:
    length = run.length + 1 if bit == run.bit else 1
    return (_Run(1 - bit, 1), True) if length == 5 else (_Run(bit, length), False)


_RUNS = tuple(_Run(bit, length) for bit in (0, 1) for length in (1, 2, 3, 4))
_PLACES = {run: place for place, run in enumerate(_RUNS)}


def _stuffing(width: int) -> tuple[bytes, bytes, bytes]:
    """Return tables by ``run << width | bits``: the run after the bits, the number of stuff bits, whether the last bit
    is one.
    """
    after, count, last = bytearray(), bytearray(), bytearray()
    for start in _RUNS:
        for value in range(1 << width):
            run, total, stuffed = start, 0, False
            for place in reversed(range(width)):
                run, stuffed = _stuff(run, value >> place & 1)
                total += stuffed
            after.append(_PLACES[run])
            count.append(total)
            last.append(stuffed)
    return bytes(after), bytes(count), bytes(last)


def _crc(bits: str) -> int:
    crc = 0
    for bit in bits:
        carry = crc >> (_CRC_BITS - 1) ^ (bit == "1")
        crc = (crc << 1 & 0x7FFF) ^ (_CRC_POLYNOMIAL if carry else 0)
    return crc


_AFTER, _COUNT, _LAST = _stuffing(8)
_AFTER_7, _COUNT_7, _ = _stuffing(7)
_CRC_OF = tuple(_crc(f"{byte:08b}") for byte in range(256))


@lru_cache(maxsize=4096)  # other nodes' frames may have any identifier
def _header(bits: str, slow: int) -> _Header:
    """Process a header from its start of frame; the first ``slow`` bits have the nominal bit rate."""
    run, stuffed = _Run(0, 1), False
    slowly = fast = 0
    for place, bit in enumerate(bits[1:], start=1):
        run, stuffed = _stuff(run, int(bit))
        if place < slow - 1:
            slowly += stuffed
        else:
            fast += stuffed
    return _Header(len(bits), slowly, fast, _PLACES[run], stuffed, _crc(bits))


def _identifier(number: int, extended: bool, classic_remote: int) -> str:
    """Return start of frame, arbitration field and the bit that gives the identifier format."""
    if extended:
        return f"0{number >> 18:011b}11{number & 0x3FFFF:018b}{classic_remote}"
    return f"0{number:011b}{classic_remote}0"


def classic_bits(number: int, payload: bytes, *, extended: bool = False, remote_length: int | None = None) -> int:
    """Return the bits of a classic frame; ``remote_length`` is the data length that a remote frame requests."""
    if remote_length is None:
        bits = _classic_header(number, extended, 0, len(payload))
    else:
        bits = _classic_header(number, extended, 1, remote_length)
    header = _header(bits, len(bits))
    run, crc = header.run, header.crc
    stuffed = header.stuffed + header.stuffed_fast
    for byte in payload:
        place = run << 8 | byte
        stuffed += _COUNT[place]
        run = _AFTER[place]
        crc = (crc << 8 & 0x7FFF) ^ _CRC_OF[crc >> 7 ^ byte]
    place = run << 8 | crc >> 7
    stuffed += _COUNT[place] + _COUNT_7[_AFTER[place] << 7 | crc & 0x7F]
    return header.bits + 8 * len(payload) + _CRC_BITS + stuffed + _CLASSIC_TAIL


@lru_cache(maxsize=4096)
def _classic_header(number: int, extended: bool, remote: int, length: int) -> str:
    return f"{_identifier(number, extended, remote)}{'00' if extended else '0'}{min(length, 15):04b}"


def fd_bits(number: int, payload: bytes, *, extended: bool = False, switched: bool) -> FrameBits:
    """Return the bits of an FD frame; ``switched``: its data phase has its own bit rate."""
    length_code = bisect_left(_FD_LENGTHS, len(payload))
    arbitration = f"{_identifier(number, extended, 0)}10{int(switched)}"
    header = _header(f"{arbitration}0{length_code:04b}", len(arbitration))
    run, stuffed, ends_stuffed = header.run, header.stuffed_fast, header.ends_stuffed
    for byte in payload:
        place = run << 8 | byte
        stuffed += _COUNT[place]
        ends_stuffed = bool(_LAST[place])
        run = _AFTER[place]
    # The fixed stuff bit before the CRC field replaces a stuff bit that would come there.
    stuffed -= ends_stuffed
    crc_field = 4 + (17 if len(payload) <= 16 else 21)
    fixed = -(-crc_field // 4)
    nominal = len(arbitration) + header.stuffed + _FD_TAIL
    data = header.bits - len(arbitration) + 8 * len(payload) + stuffed + crc_field + fixed + 1
    return FrameBits(nominal, data) if switched else FrameBits(nominal + data, 0)
