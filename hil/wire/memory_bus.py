"""A bus of two within a process: frames of a CAN dialect over ``memory:``, with no bus time and nobody else on it."""

import queue
import time
from collections.abc import Callable

from firmware_protocol.framing import Frame
from hil.core.errors import LinkError
from hil.core.ports import Received


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
            raise LinkError("the memory link was closed; open a new one")
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
