"""Byte streams: serial lines as the framing sees them, and both ends of a link in memory."""

import queue
import time
from collections.abc import Callable
from typing import Generic, Protocol, Self, TypeVar

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.ports import Received


class ByteStream(Protocol):
    """A stream of bytes without boundaries.

    Attributes:
        lost_frames: frames dropped so far because nobody read them; 0 except for a pseudo-terminal.
    """

    lost_frames: int

    def write(self, data: bytes) -> None:
        """Send bytes. Raises LinkError when the line is lost."""

    def read(self, timeout_ns: int) -> bytes:
        """Return what has arrived, waiting at most ``timeout_ns`` for the first byte. Raises LinkError when lost."""

    def close(self) -> None:
        """Release the line. Closing twice is allowed."""


AT_ONCE = -1
"""As a timeout of ``HostStream.read``: take only what lies there, and not what the system is still passing on."""


class HostStream(Protocol):
    """The host's end of a line, which can be reopened after it was lost.

    ``read`` returns all that has arrived, or at least 2 KiB of it. With 0 that is all that was written before: lockstep
    counts on it. ``AT_ONCE`` does not wait for the system either: real time takes the rest in the next tick.
    """

    def write(self, data: bytes) -> None: ...
    def read(self, timeout_ns: int) -> bytes: ...
    def close(self) -> None: ...

    def reopen(self) -> None:
        """Close the line and open it again, without the bytes that had arrived. Raises LinkError when that fails."""

    def describe(self) -> str:
        """Return a description of the line, for a person."""


def closed() -> LinkError:
    return LinkError("the memory link was closed; open a new one")


class DirectStream:
    """The host's end of a line to a robot in the same thread, in lockstep: ``read`` calls the robot.

    ``answer`` takes all bytes written since the last read, and returns all bytes that the robot then sends.
    """

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        self._answer = answer
        self._written = b""
        self._is_open = True

    def write(self, data: bytes) -> None:
        if not self._is_open:
            raise closed()
        self._written += data

    def read(self, _timeout_ns: int) -> bytes:
        if not self._written or not self._is_open:
            return b""
        data, self._written = self._written, b""
        return self._answer(data)

    def reopen(self) -> None:
        """Do nothing: everything that the robot sent was read."""

    def describe(self) -> str:
        return "memory, both sides in one process"

    def close(self) -> None:
        self._is_open = False


T = TypeVar("T", bytes, Frame)


class _End(Generic[T]):
    """One end of a link in memory. Two threads may use it, if only one of them reads."""

    def __init__(self) -> None:
        self._received: queue.SimpleQueue[T] = queue.SimpleQueue()
        self._peer: Self | None = None

    def _put(self, item: T) -> None:
        if self._peer is None:
            raise closed()
        self._peer._received.put(item)

    def _receive(self, timeout_ns: int) -> list[T]:
        try:
            items = [self._received.get(timeout_ns > 0, max(0, timeout_ns) * 1e-9)]
        except queue.Empty:
            return []
        while not self._received.empty():
            items.append(self._received.get())
        return items

    def reopen(self) -> None:
        self._receive(0)

    def close(self) -> None:
        self._peer = None


class MemoryStream(_End[bytes]):
    """One end of a line in memory; ``memory_pair`` makes both."""

    lost_frames = 0

    def write(self, data: bytes) -> None:
        self._put(data)

    def read(self, timeout_ns: int) -> bytes:
        return b"".join(self._receive(timeout_ns))

    def describe(self) -> str:
        return "memory, both sides in one process"


class MemoryBus(_End[Frame]):
    """One end of a bus in memory, without a bit rate; ``memory_bus`` makes both. Bytes are those of payloads.

    Attributes:
        now_ns: the clock that stamps received frames.
        sent_frames, sent_bytes, received_frames, received_bytes: numbers so far.
    """

    def __init__(self) -> None:
        super().__init__()
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.sent_frames = self.sent_bytes = self.received_frames = self.received_bytes = 0
        self.begin_byte_counts()

    def send(self, frame: Frame) -> None:
        self._put(frame)
        self.sent_frames += 1
        self.sent_bytes += len(frame.payload)

    def receive(self, timeout_ns: int) -> Received | None:
        frames = self._receive(timeout_ns)
        if not frames:
            return None
        self.received_frames += len(frames)
        self.received_bytes += sum(len(frame.payload) for frame in frames)
        return Received(frames, self.now_ns())

    def begin_byte_counts(self) -> None:
        self._bytes_before = self.sent_bytes, self.received_bytes

    def byte_counts(self) -> tuple[float, float]:
        sent_before, received_before = self._bytes_before
        return self.sent_bytes - sent_before, self.received_bytes - received_before

    def rejected(self) -> dict[str, int]:
        return {}

    def describe(self) -> str:
        return "a bus in memory, with no bit rate"


def memory_pair() -> tuple[MemoryStream, MemoryStream]:
    return _connected(MemoryStream(), MemoryStream())


def memory_bus() -> tuple[MemoryBus, MemoryBus]:
    return _connected(MemoryBus(), MemoryBus())


End = TypeVar("End", MemoryStream, MemoryBus)


def _connected(one: End, other: End) -> tuple[End, End]:
    one._peer, other._peer = other, one
    return one, other
