"""The run's side of a stream over UDP: gives rows to a process that sends them."""

from collections.abc import Sequence
from types import TracebackType
from typing import Any, NamedTuple, Self

from hil.core.subprocesses import child_environment
from hil.estimation.localisation.address import parse_address
from hil.record.ring_process import RingProcess
from hil.record.ring_start import Started

_CAPACITY = 16384


class Destination(NamedTuple):
    """Where a stream goes."""

    host: str
    port: int


def parse_destination(url: str) -> Destination:
    """Return where ``udp://127.0.0.1:9870`` leads; without a host it is 127.0.0.1.

    Raises BadInputError for anything else.
    """
    expected = "expected udp://127.0.0.1:PORT with a port from 1 to 65535, or the address of another machine in numbers"
    return Destination(*parse_address(url, "--stream", expected))


class UdpStream:
    """A sink that sends about 100 rows a second of scenario time as JSON, in a process of its own; a context manager.

    With ``blocking``, as in lockstep, ``put`` waits for room in the ring; else it drops the row and counts.

    Raises BadInputError when there is no way to the address, DeviceError when the process does not start.
    """

    def __init__(self, destination: Destination, *, signals: Sequence[str], blocking: bool) -> None:
        self._destination = destination
        self._figures: dict[str, Any] | None = None
        self._process = RingProcess(
            Started("hil.record.udp_sender", child_environment()),
            {**destination._asdict(), "signals": list(signals)},
            width=len(signals),
            capacity=_CAPACITY,
            blocking=blocking,
            name="the sender of the stream",
            remedy="run without --stream to go on",
        )

    @property
    def pid(self) -> int:
        """Process id of the sender."""
        return self._process.pid

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row in the order of the signals."""
        self._process.put(row)

    def finish(self) -> dict[str, Any]:
        """Have the rest sent, end the process, and return what became of it; never raises for one that died.

        ``sent`` counts the datagrams that the system took and ``lost`` those that it did not, or that nobody listened
        to; None where the process died. ``rows_dropped`` counts rows for which the ring had no room. What a receiver
        is too slow for, nobody here can know: it sees that in ``sequence``.
        """
        if self._figures is None:
            process = self._process
            reply = process.finish({"finish": {}, "keep_live": False})
            self._figures = {
                "url": f"udp://{self._destination.host}:{self._destination.port}",
                "sent": reply.get("sent"),
                "lost": reply.get("lost"),
                "rows_dropped": process.rows_dropped,
                "error": reply.get("error") or reply.get("why"),
            }
            process.close()
        return self._figures

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.finish()
