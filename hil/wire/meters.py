"""What frames use on the wire: bytes, bits and time, on a serial line and on a CAN bus."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.core.ports import EXTENDED, REMOTE
from hil.wire.can_frame import classic_bits, fd_bits

if TYPE_CHECKING:
    from hil.wire.framed import StreamLink
    from hil.wire.streams import MemoryBus

_BITS_PER_BYTE = 10  # start, eight data bits, stop
_REMOTE_LENGTH = 8  # a remote frame requests the most that its answer may have


class Usage(NamedTuple):
    """What a frame used on the wire; ``bytes`` of a CAN frame counts its data field only."""

    bytes: int
    bits: int
    busy_ns: int


class Count(NamedTuple):
    """Frames, bytes and bits of one direction."""

    frames: int = 0
    bytes: int = 0
    bits: int = 0

    def and_one(self, usage: Usage) -> "Count":
        """Return the count with one more frame."""
        return Count(self.frames + 1, self.bytes + usage.bytes, self.bits + usage.bits)


class Meter(Protocol):
    """Converts the frames of a kind of link to bytes, bits and time on the wire.

    Attributes:
        duplex: whether each direction has its own line (serial), or both share one (CAN).
        timed: whether the link has a bit rate.
        byte_ns: time that a byte occupies a serial line [ns]; 0 without a bit rate.
    """

    duplex: bool
    timed: bool
    byte_ns: float

    @property
    def foreign(self) -> Count | None:
        """Frames of other nodes so far, or None if the link has only two ends."""

    @property
    def counts_frames(self) -> bool:
        """Whether frames carry a running number by which lost ones are noticed."""

    def begin(self) -> None:
        """Start all counts at zero."""

    def noise(self) -> int:
        """Return how many frames the framing could not decode; 0 for CAN, whose refused frames arrive one by one."""

    def counts(self) -> tuple[Count, Count]:
        """Return what was sent and what was received since ``begin``."""

    def byte_counts(self) -> tuple[float, float]:
        """Return only the bytes sent and received; fast, for every tick."""


class LineMeter:
    """A serial line, or a similar link without a bit rate (``baud`` None). Bytes outside frames count too."""

    duplex = True
    foreign = None

    def __init__(self, link: "StreamLink | MemoryBus", baud: int | None) -> None:
        self._link = link
        self.byte_ns = _BITS_PER_BYTE * 1_000_000_000 / baud if baud else 0.0
        self.timed = baud is not None
        self.byte_counts, self.noise = link.byte_counts, link.noise
        self.begin()

    def begin(self) -> None:
        link = self._link
        self._frames_before = link.sent_frames, link.received_frames
        link.begin_byte_counts()

    def counts(self) -> tuple[Count, Count]:
        link, (sent, received) = self._link, self._frames_before
        sent_bytes, received_bytes = map(int, self.byte_counts())
        return (
            Count(link.sent_frames - sent, sent_bytes, sent_bytes * _BITS_PER_BYTE),
            Count(link.received_frames - received, received_bytes, received_bytes * _BITS_PER_BYTE),
        )

    @property
    def counts_frames(self) -> bool:
        return self._link.counts_frames


class BusMeter:
    """A CAN bus, classic or FD, with its bit rates [bit/s]; ``data_bitrate`` is FD's second one, if it has one."""

    duplex = False
    byte_ns = 0.0
    timed = True
    counts_frames = False

    def __init__(self, bitrate: int, *, fd: bool = False, data_bitrate: int | None = None) -> None:
        self._is_fd = fd
        self._is_switched = data_bitrate is not None
        self._bit_ns = 1_000_000_000 / bitrate
        self._data_bit_ns = 1_000_000_000 / (data_bitrate or bitrate)
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
        """Return the count with these frames, and how long they occupied the bus [ns]."""
        busy_ns = 0
        for frame in frames:
            usage = self._ours(frame)
            count = count.and_one(usage)
            busy_ns += usage.busy_ns
        return count, busy_ns

    def overheard(self, message: Any) -> int:
        """Count a ``can.Message`` of another node; return how long it occupied the bus [ns]."""
        usage = self._others(message)
        self.foreign = self.foreign.and_one(usage)
        return usage.busy_ns

    def noise(self) -> int:
        return 0

    def counts(self) -> tuple[Count, Count]:
        return self._sent, self._received

    def byte_counts(self) -> tuple[float, float]:
        return self._sent.bytes, self._received.bytes

    def _ours(self, frame: Frame) -> Usage:
        number, payload = frame
        identifier, extended = number & ~(EXTENDED | REMOTE), number >= EXTENDED
        if number & REMOTE:
            return self._classic(identifier, b"", extended, _REMOTE_LENGTH)
        if self._is_fd:
            return self._fd(identifier, payload, extended, self._is_switched)
        return self._classic(identifier, payload, extended)

    def _others(self, message: Any) -> Usage:
        """Return what a ``can.Message`` of another node used; an error frame's bits cannot be known."""
        number, payload, extended = message.arbitration_id, bytes(message.data), message.is_extended_id
        if message.is_error_frame:
            return Usage(0, 0, 0)
        if message.is_fd:
            return self._fd(number, payload, extended, message.bitrate_switch)
        return self._classic(number, payload, extended, message.dlc if message.is_remote_frame else None)

    def _classic(self, number: int, payload: bytes, extended: bool, remote_length: int | None = None) -> Usage:
        bits = classic_bits(number, payload, extended=extended, remote_length=remote_length)
        return Usage(len(payload), bits, round(bits * self._bit_ns))

    def _fd(self, number: int, payload: bytes, extended: bool, switched: bool) -> Usage:
        nominal, data = fd_bits(number, payload, extended=extended, switched=switched)
        return Usage(len(payload), nominal + data, round(nominal * self._bit_ns + data * self._data_bit_ns))
