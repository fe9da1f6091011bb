"""What is on the wire: a link that counts the frames of the link below it, exactly, and shows them to a trace.

It stands directly on the transport, below delays and all faults of frames, so that it sees what goes over the wire;
only the faults that spoil the bytes of a serial line are below it. Stamps are on the clock of the run. STATISTICS.md
says what each figure means.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.core.ports import EXTENDED, REMOTE, Clock, Link, Received, make_received
from hil.core.types import NAN
from hil.wire.can_frame import classic_bits, fd_bits
from hil.wire.url import CanUrl, LinkUrl, MemoryUrl, SerialUrl

_BUCKET_NS = 10_000_000
_BUCKETS = 10
WINDOW_NS = _BUCKET_NS * _BUCKETS
_BITS_PER_BYTE = 10  # start, eight data bits, stop


class TraceSink(Protocol):
    """Takes what was on the wire, in order; never delays a real-time tick."""

    def frame(self, stamp_ns: int, frame: Frame, *, sent: bool) -> None:
        """Take one of our frames."""

    def foreign(self, stamp_ns: int, message: Any) -> None:
        """Take a ``can.Message`` that is none of ours, an error frame among them."""

    def rejected(self, stamp_ns: int, count: int) -> None:
        """Take note of so many frames that the framing could not read."""


class LoadWindow:
    """How busy a line is: in the newest window of 100 ms, in the worst one, and in all.

    A window begins at a multiple of 10 ms on the clock.
    """

    def __init__(self) -> None:
        self._buckets = [0] * _BUCKETS
        self._newest = 0
        self._sum_ns = 0
        self._worst_ns = 0
        self._total_ns = 0

    def add(self, now_ns: int, busy_ns: int) -> None:
        """Count a frame that keeps the line busy for so long."""
        bucket = now_ns // _BUCKET_NS
        if bucket > self._newest:
            self._advance(bucket)
        self._buckets[self._newest % _BUCKETS] += busy_ns
        self._sum_ns += busy_ns
        self._total_ns += busy_ns
        if self._sum_ns > self._worst_ns:
            self._worst_ns = self._sum_ns

    def _advance(self, bucket: int) -> None:
        if bucket - self._newest >= _BUCKETS:
            self._buckets = [0] * _BUCKETS
            self._sum_ns = 0
        else:
            for place in range(self._newest + 1, bucket + 1):
                self._sum_ns -= self._buckets[place % _BUCKETS]
                self._buckets[place % _BUCKETS] = 0
        self._newest = bucket

    def percent(self, now_ns: int) -> float:
        """Return the load of the window that ends now [%]."""
        bucket = now_ns // _BUCKET_NS
        if bucket > self._newest:
            self._advance(bucket)
        return 100.0 * self._sum_ns / WINDOW_NS

    def figures(self, lasted_ns: int) -> dict[str, float | None]:
        """Return the mean over a time and the worst window [%]."""
        mean = 100.0 * self._total_ns / lasted_ns if lasted_ns > 0 else None
        return {"mean_percent": mean, "worst_100_ms_percent": 100.0 * self._worst_ns / WINDOW_NS}


class Usage(NamedTuple):
    """What something took on the wire. ``bytes`` of a CAN frame are those of its data field."""

    bytes: int
    bits: int
    busy_ns: int


class Count(NamedTuple):
    """Frames, bytes and bits of one direction."""

    frames: int = 0
    bytes: int = 0
    bits: int = 0

    def and_one(self, usage: Usage) -> "Count":
        """Return the count with a frame more."""
        return Count(self.frames + 1, self.bytes + usage.bytes, self.bits + usage.bits)


_NOTHING = Usage(0, 0, 0)
_REMOTE_LENGTH = 8  # a request asks for as much as its answer may have
_NO_NOISE = ("lost", "unread_bytes")


class Meter(Protocol):
    """How a kind of link turns frames into bytes, bits and time on the wire."""

    duplex: bool
    """Whether the two directions have a line each, as serial has, or share one, as CAN does."""
    timed: bool
    """Whether the link has a bit rate. One without need not be told of what was sent and received."""

    @property
    def counts_frames(self) -> bool:
        """Whether the frames carry a count by which lost ones are noticed."""

    def begin(self) -> None:
        """Count from now on."""

    def sent(self, frame: Frame) -> int:
        """Take a frame that was just sent; return for how long it keeps the wire busy [ns]."""

    def received(self, frames: Sequence[Frame]) -> int:
        """Take what was received since the last call, these frames as the last of it; return how long that took."""

    def counts(self) -> tuple[Count, Count]:
        """Return what was sent and what was received since ``begin``."""

    def byte_counts(self) -> tuple[int, int]:
        """Return the bytes of both alone, which is done at every tick."""


class StreamSource(Protocol):
    """The part of a serial line, or of a link in memory, that says what has come and gone since it was opened.

    Of what came over a byte stream all bytes count, whatever they were.
    """

    now_ns: Callable[[], int]
    """Stamps what it receives."""

    counts_frames: bool
    """Whether the frames carry a count by which lost ones are noticed."""

    sent_frames: int
    sent_bytes: int
    received_frames: int
    received_bytes: int


class SerialMeter:
    """A serial line, or its like in memory, which has no bit rate (``baud`` None). Counts bytes of no frame too."""

    duplex = True

    def __init__(self, source: StreamSource, baud: int | None) -> None:
        self._source = source
        self._byte_ns = _BITS_PER_BYTE * 1_000_000_000 / baud if baud else 0.0
        self.timed = baud is not None
        self._sent_bytes, self._received_bytes = source.sent_bytes, source.received_bytes  # that were taken
        self.begin()

    def begin(self) -> None:
        source = self._source
        self._before = source.sent_frames, source.sent_bytes, source.received_frames, source.received_bytes

    def sent(self, _frame: Frame) -> int:
        before, self._sent_bytes = self._sent_bytes, self._source.sent_bytes
        return round((self._sent_bytes - before) * self._byte_ns)

    def received(self, _frames: Sequence[Frame]) -> int:
        before, self._received_bytes = self._received_bytes, self._source.received_bytes
        return round((self._received_bytes - before) * self._byte_ns)

    def counts(self) -> tuple[Count, Count]:
        (sent, _, received, _), (sent_bytes, received_bytes) = self._before, self.byte_counts()
        return (
            Count(self._source.sent_frames - sent, sent_bytes, sent_bytes * _BITS_PER_BYTE),
            Count(self._source.received_frames - received, received_bytes, received_bytes * _BITS_PER_BYTE),
        )

    def byte_counts(self) -> tuple[int, int]:
        source, (_, sent, _, received) = self._source, self._before
        return source.sent_bytes - sent, source.received_bytes - received

    @property
    def counts_frames(self) -> bool:
        return self._source.counts_frames


class CanMeter:
    """A CAN bus, classic or FD."""

    duplex = False
    timed = True
    counts_frames = False

    def __init__(self, url: CanUrl) -> None:
        self._url = url
        self._bit_ns = 1_000_000_000 / url.bitrate
        self._data_bit_ns = 1_000_000_000 / (url.data_bitrate or url.bitrate)
        self.begin()

    def begin(self) -> None:
        self._sent = self._received = self._foreign = Count()

    def sent(self, frame: Frame) -> int:
        usage = self._ours(frame)
        self._sent = self._sent.and_one(usage)
        return usage.busy_ns

    def received(self, frames: Sequence[Frame]) -> int:
        busy_ns = 0
        for frame in frames:
            usage = self._ours(frame)
            self._received = self._received.and_one(usage)
            busy_ns += usage.busy_ns
        return busy_ns

    def overheard(self, message: Any) -> int:
        """Take a ``can.Message`` of somebody else; return for how long it kept the bus busy [ns]."""
        usage = self._others(message)
        self._foreign = self._foreign.and_one(usage)
        return usage.busy_ns

    def counts(self) -> tuple[Count, Count]:
        return self._sent, self._received

    def byte_counts(self) -> tuple[int, int]:
        return self._sent.bytes, self._received.bytes

    @property
    def foreign(self) -> Count:
        """What others said."""
        return self._foreign

    def _ours(self, frame: Frame) -> Usage:
        """Return what a frame takes."""
        number, payload = frame
        extended = number >= EXTENDED
        if extended or number >= REMOTE:
            return self._other(number, payload, extended=extended)
        if self._url.fd:
            return self._fd(number, payload, extended=False, switched=self._url.data_bitrate is not None)
        bits = classic_bits(number, payload)
        return Usage(len(payload), bits, round(bits * self._bit_ns))

    def _other(self, number: int, payload: bytes, *, extended: bool) -> Usage:
        """Return what a frame took that is not a standard data frame."""
        identifier = number & ~(EXTENDED | REMOTE)
        if number & REMOTE:
            bits = classic_bits(identifier, b"", extended=extended, remote_length=_REMOTE_LENGTH)
        elif self._url.fd:
            return self._fd(identifier, payload, extended=extended, switched=self._url.data_bitrate is not None)
        else:
            bits = classic_bits(identifier, payload, extended=extended)
        return Usage(len(payload), bits, round(bits * self._bit_ns))

    def _others(self, message: Any) -> Usage:
        """Return what a ``can.Message`` of somebody else took; an error frame's bits cannot be known."""
        number, payload, extended = message.arbitration_id, bytes(message.data), message.is_extended_id
        if message.is_error_frame:
            return _NOTHING
        if message.is_fd:
            return self._fd(number, payload, extended=extended, switched=message.bitrate_switch)
        remote_length = message.dlc if message.is_remote_frame else None
        bits = classic_bits(number, payload, extended=extended, remote_length=remote_length)
        return Usage(len(payload), bits, round(bits * self._bit_ns))

    def _fd(self, number: int, payload: bytes, *, extended: bool, switched: bool) -> Usage:
        nominal, data = fd_bits(number, payload, extended=extended, switched=switched)
        return Usage(len(payload), nominal + data, round(nominal * self._bit_ns + data * self._data_bit_ns))


class Statistics:
    """Counts and traces what a transport link sends and receives.

    A link without a bit rate and a trace sends and receives as the transport, with no step between. ``ahead_ns`` is
    what the stamps of the transport are ahead of the clock of the run; None where what is received has the time at
    which it is taken.
    """

    def __init__(self, link: Link, meter: Meter, clock: Clock, ahead_ns: int | None) -> None:
        self._link = link
        self._meter = meter
        self._clock = clock
        self._ahead_ns = ahead_ns
        self._trace: TraceSink | None = None
        self._noise_seen = 0
        self._begin()
        self.byte_counts = meter.byte_counts
        self.send = self._send if meter.timed else link.send
        self.receive = self._receive if meter.timed else link.receive

    def _begin(self) -> None:
        self._since_ns = self._clock.now_ns()
        self._meter.begin()
        self._down = LoadWindow()
        self._up = LoadWindow() if self._meter.duplex else self._down

    def begin(self) -> None:
        """Count from now on: the first ACTIVE tick. What the handshake took depends on the wall clock."""
        self._begin()

    def trace_to(self, sink: TraceSink) -> None:
        """Show what is on the wire to a trace, from now on; before anybody else makes use of the link."""
        self._trace = sink
        self._noise_seen = self._noise()
        self.send, self.receive = self._send, self._receive

    def _send(self, frame: Frame) -> None:
        self._link.send(frame)
        if self._meter.timed:
            self._down.add(self._clock.now_ns(), self._meter.sent(frame))
        if self._trace is not None:
            self._trace.frame(self._clock.now_ns(), frame, sent=True)

    def _receive(self, timeout_ns: int) -> Received | None:
        received = self._link.receive(timeout_ns)
        trace = self._trace
        if trace is not None:
            self._trace_noise()
        if received is None:
            return None
        frames, stamp_ns = received
        stamp_ns = self._clock.now_ns() if self._ahead_ns is None else stamp_ns - self._ahead_ns
        if self._meter.timed:
            self._up.add(stamp_ns, self._meter.received(frames))
        if trace is not None:
            for frame in frames:
                trace.frame(stamp_ns, frame, sent=False)
        return make_received((frames, stamp_ns))

    def overhear(self, message: Any) -> None:
        """Take a ``can.Message`` on the bus that is none of ours."""
        assert isinstance(self._meter, CanMeter)
        now_ns = self._clock.now_ns()
        self._down.add(now_ns, self._meter.overheard(message))
        if self._trace is not None:
            self._trace.foreign(now_ns, message)

    def _noise(self) -> int:
        """Return how many frames the framing could not read; what CAN refuses is heard one by one."""
        if not self._meter.duplex:
            return 0
        rejected = self._link.rejected()
        return sum(count for cause, count in rejected.items() if cause not in _NO_NOISE)

    def _trace_noise(self) -> None:
        count = self._noise()
        if count != self._noise_seen and self._trace is not None:
            self._trace.rejected(self._clock.now_ns(), count - self._noise_seen)
            self._noise_seen = count

    def load_percent(self) -> float:
        """Return the load of the last 100 ms [%], of the busier direction of a serial line; NaN without a bit rate."""
        if not self._meter.timed:
            return NAN
        now_ns = self._clock.now_ns()
        return max(self._down.percent(now_ns), self._up.percent(now_ns))

    @property
    def counts_frames(self) -> bool:
        """Whether the frames carry a count by which lost ones are noticed, as ours on a serial line do."""
        return self._meter.counts_frames

    def figures(self) -> dict[str, Any]:
        """Return the figures since ``begin``, by name."""
        lasted_ns = self._clock.now_ns() - self._since_ns
        sent, received = self._meter.counts()
        return {
            "lasted_s": lasted_ns * 1e-9,
            "sent": sent._asdict(),
            "received": received._asdict(),
            "foreign": self._meter.foreign._asdict() if isinstance(self._meter, CanMeter) else None,
            "load": self._load(lasted_ns),
        }

    def _load(self, lasted_ns: int) -> dict[str, Any] | None:
        if not self._meter.timed:
            return None
        if self._meter.duplex:
            return {"sent": self._down.figures(lasted_ns), "received": self._up.figures(lasted_ns)}
        return {"bus": self._down.figures(lasted_ns)}

    def rejected(self) -> dict[str, int]:
        return self._link.rejected()

    def reopen(self) -> None:
        self._link.reopen()

    def describe(self) -> str:
        return self._link.describe()

    def close(self) -> None:
        self._link.close()


def measured(link: Any, url: LinkUrl, clock: Clock, *, lockstep: bool) -> Statistics:
    """Return the statistics of a link, the transport that was opened from ``url``."""
    match url:
        case CanUrl():
            # Stamps of the transport are of the monotonic clock; in lockstep they mean nothing.
            ahead_ns = None if lockstep else time.monotonic_ns() - clock.now_ns()
            statistics = Statistics(link, CanMeter(url), clock, ahead_ns)
            link.on_foreign = statistics.overhear
            return statistics
        case SerialUrl() | MemoryUrl():
            link.now_ns = clock.now_ns
            baud = url.baud if isinstance(url, SerialUrl) else None
            return Statistics(link, SerialMeter(link, baud), clock, 0)
