"""What is on the wire: a link that counts the frames of the link below it, exactly, and shows them to a trace.

It stands directly on the transport, below delays and all faults of frames, so that it sees what goes over the wire;
only the faults that spoil the bytes of a serial line are below it. Stamps are on the clock of the run. STATISTICS.md
says what each figure means.
"""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from firmware_protocol.framing import Frame
from hil.links.can_frame import classic_bits, fd_bits
from hil.links.url import CanUrl, LinkUrl, MemoryUrl, SerialUrl
from hil.ports import EXTENDED, REMOTE, Clock, Link, Received, make_received
from hil.types import NAN

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


_NOTHING = Usage(0, 0, 0)
_MOST_USAGES = 1024  # sizes of chunks that are remembered
_REMOTE_LENGTH = 8  # a request asks for as much as its answer may have
_NO_NOISE = ("lost", "unread_bytes")


class Meter(Protocol):
    """How a kind of link turns frames into bytes, bits and time on the wire."""

    duplex: bool
    """Whether the two directions have a line each, as serial has, or share one, as CAN does."""
    timed: bool
    """Whether the link has a bit rate."""

    @property
    def counts_frames(self) -> bool:
        """Whether the frames carry a count by which lost ones are noticed."""

    def sent(self, frame: Frame) -> Usage:
        """Return what a frame took that was just sent."""

    def received(self, frames: Sequence[Frame]) -> Usage:
        """Return what was received since the last call, these frames as the last of it."""


class ByteSource(Protocol):
    """The part of a link over a byte stream that tells how many bytes have come, whatever they were, and gone."""

    counts_frames: bool
    """Whether the frames carry a count by which lost ones are noticed."""

    received_bytes: int
    sent_bytes: int


class SerialMeter:
    """A serial line, or its like in memory, which has no bit rate (``baud`` None). Counts bytes of no frame too."""

    duplex = True

    def __init__(self, source: ByteSource, baud: int | None) -> None:
        self._source = source
        self._baud = baud
        self._seen = source.received_bytes
        self._seen_sent = source.sent_bytes
        self.timed = baud is not None
        self._usages: dict[int, Usage] = {}

    def sent(self, _frame: Frame) -> Usage:
        total = self._source.sent_bytes
        count, self._seen_sent = total - self._seen_sent, total
        return self._usages.get(count) or self._usage(count)

    def received(self, _frames: Sequence[Frame]) -> Usage:
        total = self._source.received_bytes
        count, self._seen = total - self._seen, total
        return self._usages.get(count) or self._usage(count)

    @property
    def counts_frames(self) -> bool:
        return self._source.counts_frames

    def _usage(self, count: int) -> Usage:
        bits = count * _BITS_PER_BYTE
        usage = Usage(count, bits, round(bits * 1_000_000_000 / self._baud) if self._baud else 0)
        if len(self._usages) < _MOST_USAGES:
            self._usages[count] = usage
        return usage


class CanMeter:
    """A CAN bus, classic or FD."""

    duplex = False
    timed = True
    counts_frames = False

    def __init__(self, url: CanUrl) -> None:
        self._url = url
        self._bit_ns = 1_000_000_000 / url.bitrate
        self._data_bit_ns = 1_000_000_000 / (url.data_bitrate or url.bitrate)

    def sent(self, frame: Frame) -> Usage:
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

    def received(self, frames: Sequence[Frame]) -> Usage:
        if len(frames) == 1:
            return self.sent(frames[0])
        return Usage(*map(sum, zip(*map(self.sent, frames), strict=True)))

    def foreign(self, message: Any) -> Usage:
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


class Count:
    """Frames, bytes and bits of one direction."""

    def __init__(self) -> None:
        self.frames = 0
        self.bytes = 0
        self.bits = 0

    def add(self, usage: Usage, frames: int = 1) -> None:
        """Count what frames took."""
        count, bits, _ = usage
        self.frames += frames
        self.bytes += count
        self.bits += bits

    def figures(self) -> dict[str, int]:
        """Return the counts by name."""
        return {"frames": self.frames, "bytes": self.bytes, "bits": self.bits}


class Statistics:
    """Counts and traces what a transport link sends and receives.

    Stamps of what it receives are turned to the clock of the run: in lockstep robot time, in real time the moment at
    which the transport had the frame.
    """

    def __init__(self, link: Link, meter: Meter, clock: Clock, *, lockstep: bool) -> None:
        self._link = link
        self._meter = meter
        self._clock = clock
        # What the transport's stamps, of the monotonic clock, are ahead of the run's.
        self._ahead_ns = None if lockstep else time.monotonic_ns() - clock.now_ns()
        self._trace: TraceSink | None = None
        self._noise_seen = 0
        self._begin()

    def _begin(self) -> None:
        self._since_ns = self._clock.now_ns()
        self.sent = Count()
        self.received = Count()
        self.foreign = Count()
        self._down = LoadWindow()
        self._up = LoadWindow() if self._meter.duplex else self._down

    def begin(self) -> None:
        """Count from now on: the first ACTIVE tick. What the handshake took depends on the wall clock."""
        self._begin()

    def trace_to(self, sink: TraceSink) -> None:
        """Show what is on the wire to a trace, from now on."""
        self._trace = sink
        self._noise_seen = self._noise()

    def send(self, frame: Frame) -> None:
        self._link.send(frame)
        usage = self._meter.sent(frame)
        self.sent.add(usage)
        if usage.busy_ns:
            self._down.add(self._clock.now_ns(), usage.busy_ns)
        if self._trace is not None:
            self._trace.frame(self._clock.now_ns(), frame, sent=True)

    def receive(self, timeout_ns: int) -> Received | None:
        received = self._link.receive(timeout_ns)
        trace = self._trace
        if trace is not None:
            self._trace_noise()
        if received is None:
            return None
        frames, stamp_ns = received
        stamp_ns = self._clock.now_ns() if self._ahead_ns is None else stamp_ns - self._ahead_ns
        usage = self._meter.received(frames)
        self.received.add(usage, len(frames))
        if usage.busy_ns:
            self._up.add(stamp_ns, usage.busy_ns)
        if trace is not None:
            for frame in frames:
                trace.frame(stamp_ns, frame, sent=False)
        return make_received((frames, stamp_ns))

    def overhear(self, message: Any) -> None:
        """Take a ``can.Message`` on the bus that is none of ours."""
        assert isinstance(self._meter, CanMeter)
        now_ns = self._clock.now_ns()
        usage = self._meter.foreign(message)
        self.foreign.add(usage)
        if usage.busy_ns:
            self._down.add(now_ns, usage.busy_ns)
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
        return {
            "lasted_s": lasted_ns * 1e-9,
            "sent": self.sent.figures(),
            "received": self.received.figures(),
            "foreign": None if self._meter.duplex else self.foreign.figures(),
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
            statistics = Statistics(link, CanMeter(url), clock, lockstep=lockstep)
            link.on_foreign = statistics.overhear
            return statistics
        case SerialUrl():
            return Statistics(link, SerialMeter(link, url.baud), clock, lockstep=lockstep)
        case MemoryUrl():
            return Statistics(link, SerialMeter(link, None), clock, lockstep=lockstep)
