"""Statistics of a link: an observer that counts exactly what crosses the wire, and passes it to a trace.

It observes the transport itself, below latency and faults of frames. Only the faults that corrupt the bytes of a serial
line are below it. Time stamps are by the run's clock. STATISTICS.md explains each figure.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from firmware_protocol.framing import Frame
from hil.core.ports import Clock, Link, Received
from hil.core.types import NAN
from hil.wire.link import LinkUrl
from hil.wire.meters import Meter

if TYPE_CHECKING:
    from hil.wire.trace import Trace

_BUCKET_NS = 10_000_000
_BUCKETS = 10
WINDOW_NS = _BUCKET_NS * _BUCKETS


class LoadWindow:
    """The load of a line: in the newest window of 100 ms, in the worst one, and in total.

    Windows begin at multiples of 10 ms on the clock.
    """

    def __init__(self) -> None:
        self._buckets = [0] * _BUCKETS
        self._newest = 0
        self._sum_ns = 0
        self._worst_ns = 0
        self._total_ns = 0

    def add(self, now_ns: int, busy_ns: int) -> None:
        """Count a frame that occupies the line for ``busy_ns``."""
        self._advance(now_ns)
        self._buckets[self._newest % _BUCKETS] += busy_ns
        self._sum_ns += busy_ns
        self._total_ns += busy_ns
        self._worst_ns = max(self._worst_ns, self._sum_ns)

    def _advance(self, now_ns: int) -> None:
        newest, bucket = self._newest, now_ns // _BUCKET_NS
        if bucket <= newest:
            return
        self._newest = bucket
        for place in range(newest + 1, min(bucket, newest + _BUCKETS) + 1):
            self._sum_ns -= self._buckets[place % _BUCKETS]
            self._buckets[place % _BUCKETS] = 0

    def percent(self, now_ns: int) -> float:
        """Return the load of the window that ends now [%]."""
        self._advance(now_ns)
        return 100.0 * self._sum_ns / WINDOW_NS

    def figures(self, lasted_ns: int) -> dict[str, float | None]:
        """Return the mean load over ``lasted_ns`` and that of the worst window [%]."""
        mean = 100.0 * self._total_ns / lasted_ns if lasted_ns > 0 else None
        return {"mean_percent": mean, "worst_100_ms_percent": 100.0 * self._worst_ns / WINDOW_NS}


class LinkStatistics:
    """Counts what a transport sends and receives, with the ``meter`` of its kind, and traces it.

    Attributes:
        byte_counts: a function that returns the bytes sent and received since ``begin``.
        is_needed: whether ``sent`` and ``received`` must be called: they are for a bus, and for a trace.
    """

    def __init__(self, link: Link, meter: Meter, clock: Clock, trace: "Trace | None" = None) -> None:
        self._link = link
        self._meter = meter
        self._clock = clock
        self._trace = trace
        self.byte_counts = meter.byte_counts
        self.is_needed = meter.by_frame or trace is not None
        self._noise_seen = meter.noise()
        self.begin()

    def begin(self) -> None:
        """Start all counts at zero, at the first ACTIVE tick: the handshake's traffic depends on the wall clock."""
        self._since_ns = self._clock.now_ns()
        self._meter.begin()
        self._down = LoadWindow()
        self._up = LoadWindow() if self._meter.duplex else self._down

    def sent(self, frames: Sequence[Frame]) -> None:
        """Count and trace frames that were just sent."""
        now_ns = self._clock.now_ns()
        if self._meter.by_frame:
            self._down.add(now_ns, self._meter.sent(frames))
        if self._trace is not None:
            self._trace.frames(now_ns, frames, sent=True)

    def received(self, received: Received | None) -> None:
        """Count and trace the result of one call of the transport's ``receive``."""
        trace = self._trace
        if trace is not None:
            self._trace_noise(trace)
        if received is None:
            return
        frames, stamp_ns = received
        if self._meter.by_frame:
            self._up.add(stamp_ns, self._meter.received(frames))
        if trace is not None:
            trace.frames(stamp_ns, frames, sent=False)

    def overhear(self, message: Any) -> None:
        """Count and trace a ``can.Message`` that is not of this link's protocol."""
        now_ns = self._clock.now_ns()
        self._down.add(now_ns, self._meter.overheard(message))
        if self._trace is not None:
            self._trace.foreign(now_ns, message)

    def _trace_noise(self, trace: "Trace") -> None:
        count = self._meter.noise()
        if count != self._noise_seen:
            trace.rejected(self._clock.now_ns(), count - self._noise_seen)
            self._noise_seen = count

    def _count_bytes(self, now_ns: int) -> None:
        """Add to the load of a line what went over it since the last call."""
        meter = self._meter
        if meter.timed and not meter.by_frame:
            self._down.add(now_ns, meter.sent(()))
            self._up.add(now_ns, meter.received(()))

    def load_percent(self) -> float:
        """Return the load of the last 100 ms [%], on a serial line of the busier direction; NaN without a bit rate."""
        if not self._meter.timed:
            return NAN
        now_ns = self._clock.now_ns()
        self._count_bytes(now_ns)
        return max(self._down.percent(now_ns), self._up.percent(now_ns))

    @property
    def counts_frames(self) -> bool:
        """Whether frames carry a running number by which lost ones are noticed, as ours do on a serial line."""
        return self._meter.counts_frames

    def figures(self) -> dict[str, Any]:
        """Return the figures since ``begin``, by name."""
        now_ns = self._clock.now_ns()
        self._count_bytes(now_ns)
        lasted_ns = now_ns - self._since_ns
        sent, received = self._meter.counts()
        foreign = self._meter.foreign
        lines = {"sent": self._down, "received": self._up} if self._meter.duplex else {"bus": self._down}
        load = {name: line.figures(lasted_ns) for name, line in lines.items()}
        return {
            "lasted_s": lasted_ns * 1e-9,
            "sent": sent._asdict(),
            "received": received._asdict(),
            "foreign": None if foreign is None else foreign._asdict(),
            "load": load if self._meter.timed else None,
        }


def observe(link: Any, url: LinkUrl, clock: Clock, trace: "Trace | None" = None) -> LinkStatistics:
    """Return the statistics of a transport opened from ``url``. Its time stamps are from now on by the run's clock."""
    statistics = LinkStatistics(link, url.meter(link), clock, trace)
    link.now_ns = clock.now_ns
    if url.is_bus:
        link.on_foreign = statistics.overhear
    return statistics
