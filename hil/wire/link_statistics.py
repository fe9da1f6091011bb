"""Statistics of a link: a meter of what frames use on the wire, and an observer that counts and traces them.

It observes the transport itself, below latency and faults of frames. Only the faults that corrupt the bytes of a serial
line are below it. Time stamps are by the run's clock. STATISTICS.md explains each figure.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from firmware_protocol.built import BuildError
from firmware_protocol.extension import library, wheel
from firmware_protocol.framing import Frame
from firmware_protocol.host_line import PackedFrames
from hil.core.errors import BadInputError
from hil.core.ports import Clock, Link, Received
from hil.wire.link import LinkUrl

if TYPE_CHECKING:
    from hil.wire.framed import StreamLink
    from hil.wire.streams import MemoryBus
    from hil.wire.trace import Trace

_BITS_PER_BYTE = 10  # start, eight data bits, stop


class Count(NamedTuple):
    """Frames and bytes of one direction; the bytes of a CAN frame are those of its data field."""

    frames: int = 0
    bytes: int = 0


class Meter(Protocol):
    """Converts the frames of a kind of link to bytes, bits and time on the wire.

    Attributes:
        duplex: whether each direction has its own line (serial), or both share one (CAN).
        timed: whether the link has a bit rate.
        byte_ns: time that a byte occupies a serial line [ns]; 0 without a bit rate.
    """

    duplex: bool
    timed: bool
    byte_ns: float

    @property
    def foreign(self) -> Count | None:
        """Frames of other nodes so far, or None if the link has only two ends."""

    def begin(self) -> None:
        """Start all counts at zero."""

    def counts(self) -> tuple[Count, Count]:
        """Return the counts of sent and of received frames since ``begin``."""

    def byte_counts(self) -> tuple[float, float]:
        """Return only the bytes sent and received; fast, for every tick."""


class LineMeter:
    """A serial line, or a similar link without a bit rate (``baud`` None). Bytes outside frames count too."""

    duplex = True
    foreign = None

    def __init__(self, link: "StreamLink | MemoryBus", baud: int | None) -> None:
        self._link = link
        self.byte_ns = _BITS_PER_BYTE * 1e9 / baud if baud else 0.0
        self.timed = baud is not None
        self.byte_counts = link.byte_counts
        self.begin()

    def begin(self) -> None:
        link = self._link
        self._frames_before = link.sent_frames, link.received_frames
        link.begin_byte_counts()

    def counts(self) -> tuple[Count, Count]:
        link, (sent, received) = self._link, self._frames_before
        sent_bytes, received_bytes = map(int, self.byte_counts())
        return (
            Count(link.sent_frames - sent, sent_bytes),
            Count(link.received_frames - received, received_bytes),
        )


class LoadWindow(wheel.Load):
    """The load of a line: in the newest window of 100 ms, in the worst one, and in total (``client/wheel_load.h``).

    What occupies the line is counted in units of ``unit_ns``. Windows begin at multiples of 10 ms on the clock. Raises
    BuildError without the extension module.
    """

    def __init__(self, unit_ns: float = 1.0) -> None:
        _, lib = library()
        self._unit_ns = unit_ns
        self._unit_percent = 100.0 * unit_ns / (lib.WHEEL_LOAD_BUCKET_NS * lib.WHEEL_LOAD_BUCKETS)
        super().__init__(self._unit_percent)

    def add(self, now_ns: int, units: float) -> None:
        self.count(now_ns, self.total + units)

    def percent(self, now_ns: int) -> float:
        """Return the load of the window that ends now [%]."""
        return self.count(now_ns, self.total)

    def figures(self, lasted_ns: int) -> dict[str, float | None]:
        """Return the mean load over ``lasted_ns`` and that of the worst window [%]."""
        mean = 100.0 * self.total * self._unit_ns / lasted_ns if lasted_ns > 0 else None
        return {"mean_percent": mean, "worst_100_ms_percent": self.most * self._unit_percent}


class LinkStatistics:
    """Counts what a transport sends and receives, with the ``meter`` of its kind, and traces it.

    Attributes:
        byte_counts: returns the bytes sent and received since ``begin``.
        is_timed: whether the link has a bit rate, and so a load.
        is_needed: whether ``sent`` and ``received`` must be called: they are for a bus, and for a trace.
    """

    def __init__(self, link: Link, meter: Meter, clock: Clock, trace: "Trace | None" = None) -> None:
        self._link = link
        self._meter = meter
        self._clock = clock
        self._trace = trace
        self._bus = None
        if not meter.duplex:
            from hil.wire.can_meter import BusMeter

            self._bus = meter if isinstance(meter, BusMeter) else None
        self.is_needed = self._bus is not None or trace is not None
        self.byte_counts, self.is_timed = meter.byte_counts, meter.timed
        self.begin()

    def begin(self) -> None:
        """Start all counts at zero, at the first ACTIVE tick: the handshake's traffic depends on the wall clock."""
        self._since_ns = self._clock.now_ns()
        self._meter.begin()
        unit_ns = self._meter.byte_ns if self._bus is None else 1.0
        self._down = LoadWindow(unit_ns)
        self._up = LoadWindow(unit_ns) if self._meter.duplex else self._down

    def sent(self, frames: Sequence[Frame]) -> None:
        """Count and trace frames that were just sent."""
        now_ns = self._clock.now_ns()
        if self._bus is not None:
            self._down.add(now_ns, self._bus.sent(frames))
        if self._trace is not None:
            self._trace.frames(now_ns, frames, sent=True)

    def received(self, received: Received | None) -> None:
        """Count and trace the result of one call of the transport's ``receive``."""
        if received is None:
            return
        frames, stamp_ns = received
        if self._bus is not None:
            self._up.add(stamp_ns, self._bus.received(frames))
        if self._trace is not None:
            self._trace.frames(stamp_ns, frames, sent=False)

    def exchanged(self, sent: bytes, sent_count: int, answer: bytes, count: int, stamp_ns: int) -> None:
        """Count and trace packed frames, and their number, that crossed to a robot in this thread, and its answer."""
        if sent:
            self.sent(PackedFrames(sent, sent_count))
        self.received(Received(PackedFrames(answer, count), stamp_ns) if answer else None)

    def overhear(self, message: Any) -> None:
        """Count and trace a ``can.Message`` that is not of this link's protocol."""
        assert self._bus is not None, "a line between two ends has no other nodes"
        now_ns = self._clock.now_ns()
        self._down.add(now_ns, self._bus.overheard(message))
        if self._trace is not None:
            self._trace.foreign(now_ns, message)

    def load_percent(self, byte_counts: tuple[float, float]) -> float:
        """Return the load of the last 100 ms [%] of a link with a bit rate; ``byte_counts`` are the present ones.

        The load of a serial line is that of its busier direction. A line is observed only here: call it in every tick.
        """
        now_ns = self._clock.now_ns()
        if self._bus is not None:
            return self._down.percent(now_ns)
        return self._down.count_both(self._up, now_ns, byte_counts)

    def figures(self) -> dict[str, Any]:
        """Return the figures since ``begin``, by name."""
        if self._bus is None:  # also what no tick has counted: that of the stop
            self._down.total, self._up.total = self._meter.byte_counts()
        lasted_ns = self._clock.now_ns() - self._since_ns
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
    """Return the statistics of a transport opened from ``url``. Its time stamps are from now on by the run's clock.

    Raises BadInputError when the host library cannot be loaded.
    """
    try:
        statistics = LinkStatistics(link, url.meter(link), clock, trace)
    except BuildError as error:
        raise BadInputError(str(error)) from error
    link.now_ns = clock.now_ns
    if url.is_bus:
        link.on_foreign = statistics.overhear
    return statistics
