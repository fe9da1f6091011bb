"""The host's end of a serial line, in the firmware's C: takes a fifth of the time of ``framer``."""

from collections.abc import Iterator, Sequence
from typing import overload

from firmware_protocol.extension import library, wheel
from firmware_protocol.framing import CAUSES, PACKED_HEADERS, Frame, pack, unsendable

_MOST_AT_ONCE = 1 << 12  # bytes passed to the library in one call
_MOST_TO_SEND = 1 << 10  # packed bytes


class PackedFrames(Sequence[Frame]):
    """Frames stored one after the other in ``packed``, in C's layout: id16 LE, length8, payload.

    Each becomes a ``Frame`` when it is accessed. They are counted when their number is asked for and not given.
    """

    __slots__ = ("_count", "packed")

    def __init__(self, packed: bytes, count: int | None = None) -> None:
        self.packed = packed
        self._count = count

    def __len__(self) -> int:
        if self._count is None:
            self._count = len(self._unpacked())
        return self._count

    def __bool__(self) -> bool:
        return bool(self.packed)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self._unpacked())

    @overload
    def __getitem__(self, place: int) -> Frame: ...
    @overload
    def __getitem__(self, place: slice) -> list[Frame]: ...
    def __getitem__(self, place: int | slice) -> Frame | list[Frame]:
        return list(self)[place]

    def _unpacked(self) -> tuple[Frame, ...]:
        return wheel.frames(self.packed, Frame)


def split(frames: PackedFrames, limit: int) -> tuple[PackedFrames | None, PackedFrames | None]:
    """Return the frames with an id below ``limit``, and the others, each in their order; None for none."""
    below, others = wheel.split(frames.packed, limit)
    if not others:
        return frames, None
    return (PackedFrames(below), PackedFrames(others)) if below else (None, frames)


def packed_of(frames: Sequence[Frame]) -> bytes:
    """Return frames packed.

    Raises TypeError for an id of more than 16 bits, or a payload of more than 255 bytes.
    """
    return frames.packed if type(frames) is PackedFrames else pack(frames)


class HostLine(wheel.Line):
    """Both directions of one serial line; each may be used by one thread at a time.

    It numbers the frames that it sends, modulo 256. Received bytes raise no error: what is not a valid frame is dropped
    and counted. Memory is bounded. ``handle`` is the C struct, for cffi; it is valid as long as this object.
    """

    def __init__(self) -> None:
        super().__init__()
        ffi, lib = library()
        self._counts = ffi.new("wheel_line_counts *")
        self.handle = ffi.cast("wheel_line *", self.address)
        self._packed, self._used = ffi.new("uint8_t[]", _MOST_AT_ONCE + lib.WHEEL_LINE_OPEN), ffi.new("size_t *")
        self._received = ffi.buffer(self._packed)
        self._encoded = ffi.new("uint8_t[]", lib.WHEEL_LINE_GROWTH * _MOST_TO_SEND)
        self._sent = ffi.buffer(self._encoded)
        # Attributes are looked up once, because a lookup costs as much as the call.
        self._feed, self._encode, self._count = lib.wheel_line_feed, lib.wheel_line_encode, lib.wheel_line_count

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire, with the final zero; an ESTOP also has a zero before it.

        Raises ValueError when no message has the frame's id, or when the payload does not have the id's length: the
        other side would drop it.
        """
        number, payload = frame
        header = PACKED_HEADERS.get((number, len(payload)))
        if header is None:
            raise unsendable(frame)
        return self.encode_packed(header + payload)

    def encode_packed(self, packed: bytes) -> bytes:
        """Return the bytes for the wire of packed frames, which must be messages.

        Raises ValueError for more than 1024 bytes of them.
        """
        if len(packed) > _MOST_TO_SEND:
            raise ValueError(f"{len(packed)} bytes of frames at once: expected at most {_MOST_TO_SEND}")
        count = self._encode(self.handle, packed, len(packed), self._encoded)
        data: bytes = self._sent[:count]
        return data

    def feed(self, data: bytes) -> PackedFrames:
        """Take the bytes that arrived, in pieces of any size, and return the frames that they complete."""
        if len(data) > _MOST_AT_ONCE:
            return self._feed_much(data)
        count = self._feed(self.handle, data, len(data), self._packed, self._used)
        return PackedFrames(self._received[: self._used[0]], count)

    def _feed_much(self, data: bytes) -> PackedFrames:
        pieces = [self.feed(data[at : at + _MOST_AT_ONCE]) for at in range(0, len(data), _MOST_AT_ONCE)]
        return PackedFrames(b"".join(piece.packed for piece in pieces), sum(map(len, pieces)))

    @property
    def rejected(self) -> dict[str, int]:
        """How many pieces were no frame, by cause (``CAUSES``). ``lost`` counts frames that the other side counted and
        that did not arrive whole, except losses of 128 or more in a row.
        """
        counts = self._counts
        self._count(self.handle, counts)
        return {cause: getattr(counts, cause) for cause in (*CAUSES, "lost")}
