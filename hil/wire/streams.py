"""Byte streams, which are to the framing what a serial line is; and the two ends of a link in memory."""

import queue
import time
from collections.abc import Callable
from typing import Generic, Protocol, Self, TypeVar

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.ports import Received


class ByteStream(Protocol):
    """A line of bytes with no boundaries.

    Attributes:
        lost_frames: frames that were lost so far because nobody read them; only a pseudo-terminal knows.
    """

    lost_frames: int

    def write(self, data: bytes) -> None:
        """Send bytes. Raises LinkError when the line is lost."""

    def read(self, timeout_ns: int) -> bytes:
        """Return what has arrived, waiting at most ``timeout_ns`` for the first byte. Raises LinkError when lost."""

    def close(self) -> None:
        """Release the line. Closing twice is allowed."""


class HostStream(Protocol):
    """The host's end of a line, which can be opened anew after it was lost."""

    def write(self, data: bytes) -> None: ...
    def read(self, timeout_ns: int) -> bytes: ...
    def close(self) -> None: ...

    def unread_bytes(self) -> int:
        """Return how many bytes were dropped because nobody read them; the count goes on when it is reopened."""

    def reopen(self) -> None:
        """Close the line and open it anew; bytes that had arrived are forgotten. Raises LinkError when that fails."""

    def describe(self) -> str:
        """Return what the line is, in words for a person."""


def closed() -> LinkError:
    """Return the error of sending on a link in memory that was closed."""
    return LinkError("the memory link was closed; open a new one")


class DirectStream:
    """The host's end of a line to a robot in the same thread, in lockstep: a read lets it answer what was written.

    ``answer`` takes all bytes written since the last read, and returns all that the robot sends then.
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
        """Nothing to do: all that the robot sent was read."""

    def unread_bytes(self) -> int:
        return 0

    def describe(self) -> str:
        return "memory, both sides in one process"

    def close(self) -> None:
        self._is_open = False


T = TypeVar("T", bytes, Frame)


class _End(Generic[T]):
    """One end of a link in memory. Safe between two threads, where one alone reads this end."""

    def __init__(self) -> None:
        self._received: queue.SimpleQueue[T] = queue.SimpleQueue()
        self._peer: Self | None = None

    def connect(self, peer: Self) -> None:
        """Make ``peer`` the other end."""
        self._peer = peer

    def _put(self, item: T) -> None:
        if self._peer is None:
            raise closed()
        self._peer._received.put(item)

    def _take(self, timeout_ns: int) -> list[T]:
        """Return all that has arrived, waiting at most ``timeout_ns`` for the first."""
        received = self._received
        try:
            items = [received.get(timeout_ns > 0, max(0, timeout_ns) * 1e-9)]
        except queue.Empty:
            return []
        while not received.empty():
            items.append(received.get())
        return items

    def reopen(self) -> None:
        self._take(0)

    def close(self) -> None:
        self._peer = None


class MemoryStream(_End[bytes]):
    """One end of a line in memory; made in pairs by ``memory_pair``."""

    lost_frames = 0

    def write(self, data: bytes) -> None:
        self._put(data)

    def read(self, timeout_ns: int) -> bytes:
        return b"".join(self._take(timeout_ns))

    def unread_bytes(self) -> int:
        return 0

    def describe(self) -> str:
        return "memory, both sides in one process"


class MemoryBus(_End[Frame]):
    """One end of a bus of two in memory, with no bit rate; made in pairs by ``memory_bus``. Bytes are of payloads.

    Attributes:
        now_ns: the clock that stamps what is received.
        sent_frames, sent_bytes, received_frames, received_bytes: so far.
    """

    counts_frames = False

    def __init__(self) -> None:
        super().__init__()
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.sent_frames = self.sent_bytes = self.received_frames = self.received_bytes = 0

    def send(self, frame: Frame) -> None:
        self._put(frame)
        self.sent_frames += 1
        self.sent_bytes += len(frame.payload)

    def receive(self, timeout_ns: int) -> Received | None:
        frames = self._take(timeout_ns)
        if not frames:
            return None
        self.received_frames += len(frames)
        self.received_bytes += sum(len(frame.payload) for frame in frames)
        return Received(frames, self.now_ns())

    def rejected(self) -> dict[str, int]:
        return {}

    def describe(self) -> str:
        return "a bus in memory, with no bit rate"


def memory_pair() -> tuple[MemoryStream, MemoryStream]:
    """Return the two ends of a line within this process."""
    one, other = MemoryStream(), MemoryStream()
    one.connect(other)
    other.connect(one)
    return one, other


def memory_bus() -> tuple[MemoryBus, MemoryBus]:
    """Return the two ends of a bus within this process."""
    one, other = MemoryBus(), MemoryBus()
    one.connect(other)
    other.connect(one)
    return one, other
