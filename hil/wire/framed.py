"""A link over a byte stream, with the framing of its protocol in both directions."""

import time
from collections import Counter
from collections.abc import Callable, Sequence

from firmware_protocol.client import Client
from firmware_protocol.framing import Frame
from firmware_protocol.host_line import HostLine, PackedFrames, packed_of
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock, Framing, Received
from hil.wire.streams import AT_ONCE, HostStream

_MOST_AT_ONCE = 50
"""The most frames that one call returns: those of a few ticks. The caller decides how often it calls."""

_MOST_READS = 2
"""The most reads of one ``receive_waiting``. The rest is read in the next tick: a host that is slower than its robot
would never finish.
"""
_SHORT = 2048  # bytes; a read of fewer has emptied the line (HostStream)

_MOST_NOISE = 65536  # bytes without a frame in one call: more than any buffer of a line holds


def _own(framing: Framing) -> HostLine:
    assert isinstance(framing, HostLine), "a client speaks our own protocol"
    return framing


class StreamLink:
    """Frames over a byte stream. Wrong bytes are dropped and counted by cause; they raise no error.

    Attributes:
        now_ns: the clock that stamps received frames.
        sent_frames, sent_bytes, received_frames, received_bytes: numbers so far. received_frames counts the frames that
            ``receive`` returned, received_bytes all bytes.
    """

    # These are set by ``serve``.
    _client: Client
    _clock: Clock
    _attend: Callable[[bytes, int, int], None]
    _encode: Callable[[Client], bytes]
    _take: Callable[[Client, bytes, int], int | tuple[bytes, int]]

    def __init__(self, stream: HostStream, protocol: LinkProtocol = WHEEL_DBC) -> None:
        self._stream = stream
        assert protocol.make_framing is not None, "a protocol of buses only"
        self._make_framing = protocol.make_framing
        self._framing = protocol.make_framing()  # for received bytes
        self._sender = protocol.make_framing()  # kept over ``reopen``: the running number continues
        self._earlier: Counter[str] = Counter()  # rejected before the link was reopened
        self._waiting: tuple[Sequence[Frame], int] | None = None
        self.now_ns: Callable[[], int] = time.monotonic_ns
        self.sent_frames = 0
        self.sent_bytes = 0
        self.received_frames = 0
        self.received_bytes = 0
        self.begin_byte_counts()

    def send(self, frame: Frame) -> None:
        self._write(self._sender.encode(frame), 1)

    def serve(self, client: Client, clock: Clock, attend: Callable[[bytes, int, int], None]) -> None:
        """Set the client: ``send_waiting`` sends its frames, ``receive_waiting`` gives it the bytes that arrive.

        Call it before either. ``clock`` is that of the run. Where the client stops, as its view says, ``attend`` is
        called with packed frames, the offset of the first one not taken, and their time of arrival [ns]. It must give
        the client that frame and all after it.
        """
        self._client, self._clock, self._attend = client, clock, attend
        self._encode, self._take = _own(self._sender).encode_for, _own(self._framing).receive_for

    def send_waiting(self) -> None:
        """Send what the client has queued. Raises LinkError when the link is lost; it stays queued then."""
        client = self._client
        data = self._encode(client)
        if data:
            self._stream.write(data)
            self.sent_frames += client.sent()
            self.sent_bytes += len(data)

    def receive_waiting(self) -> int | None:
        """Give the client the bytes that have arrived, without waiting; it queues its replies.

        Return the time [ns] just after the read that emptied the line; None if there may be more. Raises LinkError when
        the link is lost.
        """
        if self._waiting is not None:
            (frames, stamp_ns), self._waiting = self._waiting, None
            self.received_frames += len(frames)
            self._attend(packed_of(frames), 0, stamp_ns)
        for _ in range(_MOST_READS):
            data = self._stream.read(AT_ONCE)
            now_ns = self._clock.now_ns()
            taken = self._take(self._client, data, now_ns)
            self.received_bytes += len(data)
            if isinstance(taken, int):
                self.received_frames += taken
            else:
                packed, at = taken
                self.received_frames += len(PackedFrames(packed))
                self._attend(packed, at, now_ns)
            if len(data) < _SHORT:
                return now_ns
        return None

    def send_packed(self, frames: PackedFrames) -> None:
        assert isinstance(self._sender, HostLine)  # frames of another protocol are not packed
        self._write(self._sender.encode_packed(frames.packed), len(frames))

    def _write(self, data: bytes, frames: int) -> None:
        self._stream.write(data)
        self.sent_frames += frames
        self.sent_bytes += len(data)

    def receive(self, timeout_ns: int) -> Received | None:
        if self._waiting is not None:
            return self._batch_of(*self._waiting)
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        of_no_frame = 0
        while True:
            if data := self._stream.read(timeout_ns):
                stamp_ns = self.now_ns()
                self.received_bytes += len(data)
                frames = self._framing.feed(data)
                if count := len(frames):
                    if count > _MOST_AT_ONCE:
                        return self._batch_of(frames, stamp_ns)
                    self.received_frames += count
                    return Received(frames, stamp_ns)
                # These bytes completed no frame; the rest may come within the timeout. But a line full of noise must
                # not hold up a tick.
                of_no_frame += len(data)
                if of_no_frame > _MOST_NOISE:
                    return None
            elif timeout_ns <= 0:
                return None
            if timeout_ns > 0:
                timeout_ns = deadline_ns - time.monotonic_ns()

    def begin_byte_counts(self) -> None:
        self._bytes_before = self.sent_bytes, self.received_bytes

    def byte_counts(self) -> tuple[float, float]:
        """Return the bytes sent and received since ``begin_byte_counts``."""
        sent_before, received_before = self._bytes_before
        return self.sent_bytes - sent_before, self.received_bytes - received_before

    def _batch_of(self, frames: Sequence[Frame], stamp_ns: int) -> Received:
        part, rest = frames[:_MOST_AT_ONCE], frames[_MOST_AT_ONCE:]
        self._waiting = (rest, stamp_ns) if rest else None
        self.received_frames += len(part)
        return Received(part, stamp_ns)

    def rejected(self) -> dict[str, int]:
        return {cause: count + self._earlier[cause] for cause, count in self._framing.rejected.items()}

    def reopen(self) -> None:
        self._stream.reopen()
        # A new framing: a partial frame and the gap in the running number belong to the line that was lost.
        self._earlier = Counter(self.rejected())
        self._framing = self._make_framing()
        if isinstance(self._framing, HostLine):
            self._take = self._framing.receive_for
        self._waiting = None

    def describe(self) -> str:
        return self._stream.describe()

    def close(self) -> None:
        self._stream.close()
