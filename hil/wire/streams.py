"""Byte streams, which are to the framing what a serial line is; and links in memory, which stay within a process."""

import queue
import time
from collections.abc import Callable
from typing import Protocol

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.ports import Received


class ByteStream(Protocol):
    """A line of bytes with no boundaries."""

    def write(self, data: bytes) -> None:
        """Send bytes. Raises LinkError when the line is lost."""

    def read(self, timeout_ns: int) -> bytes:
        """Return what has arrived, waiting at most ``timeout_ns`` for the first byte. Raises LinkError when lost."""

    def close(self) -> None:
        """Release the line. Closing twice is allowed."""


class HostStream(ByteStream, Protocol):
    """The host's end of a line, which can be opened anew when it was lost."""

    def unread_bytes(self) -> int:
        """Return how many bytes that had arrived were dropped because nobody read them; it goes on when reopened."""

    def reopen(self) -> None:
        """Close the line and open it anew; bytes that had arrived are forgotten. Raises LinkError when that fails."""

    def describe(self) -> str:
        """Return what the line is, in words for a person."""


def closed() -> LinkError:
    """Return the error of who sends by a link in memory that was closed."""
    return LinkError("the memory link was closed; open a new one")


class DirectStream:
    """The host's end of a line to a robot in the same thread, in lockstep: a read lets it answer what was written.

    ``answer`` takes all that was written since, and returns all that the robot says to that.
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
        """Nothing to do: what the robot said was read."""

    def unread_bytes(self) -> int:
        return 0

    def describe(self) -> str:
        return "memory, both sides in one process"

    def close(self) -> None:
        self._is_open = False


class MemoryStream:
    """One end of a line within this process; made in pairs by ``memory_pair``. Safe between two threads."""

    def __init__(self) -> None:
        self._received: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._peer: MemoryStream | None = None

    def connect(self, peer: "MemoryStream") -> None:
        """Make ``peer`` the other end."""
        self._peer = peer

    def write(self, data: bytes) -> None:
        peer = self._peer
        if peer is None:
            raise closed()
        peer._received.put(data)

    def read(self, timeout_ns: int) -> bytes:
        received = self._received
        if received.empty():
            return self._await(timeout_ns) if timeout_ns > 0 else b""
        data = received.get()
        while not received.empty():  # one thread alone reads this end
            data += received.get()
        return data

    def _await(self, timeout_ns: int) -> bytes:
        try:
            return self._received.get(timeout=timeout_ns * 1e-9)
        except queue.Empty:
            return b""

    def reopen(self) -> None:
        while not self._received.empty():
            self._received.get()

    def unread_bytes(self) -> int:
        return 0

    def describe(self) -> str:
        return "memory, both sides in one process"

    def close(self) -> None:
        self._peer = None


def memory_pair() -> tuple[MemoryStream, MemoryStream]:
    """Return the two ends of a line within this process."""
    one, other = MemoryStream(), MemoryStream()
    one.connect(other)
    other.connect(one)
    return one, other


class MemoryBus:
    """One end; made in pairs by ``memory_bus``. Safe between two threads. Bytes are those of the payloads.

    Attributes:
        now_ns: the clock that stamps what is received.
        sent_frames, sent_bytes, received_frames, received_bytes: so far.
    """

    counts_frames = False

    def __init__(self) -> None:
        self._received: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._peer: MemoryBus | None = None
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.sent_frames = 0
        self.sent_bytes = 0
        self.received_frames = 0
        self.received_bytes = 0

    def connect(self, peer: "MemoryBus") -> None:
        """Make ``peer`` the other end."""
        self._peer = peer

    def send(self, frame: Frame) -> None:
        if self._peer is None:
            raise closed()
        self._peer._received.put(frame)
        self.sent_frames += 1
        self.sent_bytes += len(frame.payload)

    def receive(self, timeout_ns: int) -> Received | None:
        received = self._received
        try:
            frames = [received.get(timeout_ns > 0, max(0, timeout_ns) * 1e-9)]
        except queue.Empty:
            return None
        while not received.empty():  # one thread alone reads this end
            frames.append(received.get())
        self.received_frames += len(frames)
        self.received_bytes += sum(len(frame.payload) for frame in frames)
        return Received(frames, self.now_ns())

    def rejected(self) -> dict[str, int]:
        return {}

    def reopen(self) -> None:
        while not self._received.empty():
            self._received.get()

    def describe(self) -> str:
        return "a bus in memory, with no bit rate"

    def close(self) -> None:
        self._peer = None


def memory_bus() -> tuple[MemoryBus, MemoryBus]:
    """Return the two ends of a new bus."""
    one, other = MemoryBus(), MemoryBus()
    one.connect(other)
    other.connect(one)
    return one, other
