"""A link over a byte stream: the serial framing in both directions."""

import time
from collections import Counter, deque

from firmware_protocol.framing import Deframer, Frame, Framer
from hil.links.streams import HostStream
from hil.ports import Received, make_received


class StreamLink:
    """Frames over a byte stream. Wrong bytes are dropped and counted by cause, never raised."""

    def __init__(self, stream: HostStream) -> None:
        self._stream = stream
        self._framer = Framer()
        self._deframer = Deframer()
        self._earlier: Counter[str] = Counter()  # what was rejected before the link was reopened
        self._earlier_bytes = 0
        self._ready: deque[Received] = deque()

    def send(self, frame: Frame) -> None:
        self._stream.write(self._framer.encode(frame))

    def receive(self, timeout_ns: int) -> Received | None:
        ready = self._ready
        if not ready:
            self._fill(timeout_ns)
        return ready.popleft() if ready else None

    def _fill(self, timeout_ns: int) -> None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            data = self._stream.read(timeout_ns)
            if data:
                stamp_ns = time.monotonic_ns()
                self._ready.extend([make_received((frame, stamp_ns)) for frame in self._deframer.feed(data)])
            if self._ready or timeout_ns <= 0:
                return
            # Bytes came that completed no frame: wait on for what is left of the time.
            timeout_ns = deadline_ns - time.monotonic_ns()

    def received_bytes(self) -> int:
        """Return how many bytes have come so far, those that were no frame too."""
        return self._earlier_bytes + self._deframer.bytes

    def rejected(self) -> dict[str, int]:
        now = self._deframer.rejected | {"lost": self._deframer.lost}
        counts = {cause: count + self._earlier[cause] for cause, count in now.items()}
        return counts | {"unread_bytes": self._stream.unread_bytes()}

    def reopen(self) -> None:
        self._stream.reopen()
        # A new deframer: the half of a frame, and the gap in the numbers, belong to the line that was lost.
        self._earlier = Counter(self.rejected())
        self._earlier_bytes = self.received_bytes()
        self._deframer = Deframer()
        self._ready.clear()

    def describe(self) -> str:
        return self._stream.describe()

    def close(self) -> None:
        self._stream.close()
