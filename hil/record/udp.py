"""A run as JSON datagrams over UDP, as PlotJuggler's UDP server reads them (STREAMS.md).

``UdpStream`` is the run's side. It passes rows to a separate process, ``python -m hil.record.udp``, which sends them.
"""

import json
import math
import socket
import sys
import time
from collections.abc import Iterator, Sequence
from typing import Any

from hil.core.subprocesses import child_environment
from hil.estimation.localisation.message import parse_address
from hil.record.decimate import Decimator
from hil.record.ring import RingReader
from hil.record.ring_child import Record, RefusedError, run
from hil.record.ring_process import RingProcess
from hil.record.started_process import StartedProcess

_CAPACITY = 16384
PERIOD_S = 0.01
_BATCH = 1000
_PAUSE_S = 0.0002  # between rows, so that a receiver's buffer outlasts a run in lockstep
MOST_BYTES = 1400  # a row does not fit into one Ethernet frame, and some receivers take at most 2048 bytes
_LONGEST = -1.2345678901234567e-100  # as many characters as a float can have


def parse_destination(url: str) -> tuple[str, int]:
    """Return host and port of ``udp://127.0.0.1:9870``; the host is 127.0.0.1 by default.

    Raises BadInputError for anything else.
    """
    expected = "expected udp://127.0.0.1:PORT with a port from 1 to 65535, or the address of another machine in numbers"
    return parse_address(url, "--stream", expected)


class UdpStream(RingProcess):
    """A sink that sends about 100 rows per second of scenario time as JSON, in a separate process; a context manager.

    With ``blocking`` (for lockstep) ``put`` waits while the ring is full; otherwise it drops the row and counts it.

    Raises BadInputError when there is no route to the address, DeviceError when the process does not start.
    """

    def __init__(self, destination: tuple[str, int], *, signals: Sequence[str], blocking: bool) -> None:
        self._destination = destination
        self._figures: dict[str, Any] | None = None
        super().__init__(
            StartedProcess("hil.record.udp", child_environment()),
            {"host": destination[0], "port": destination[1], "signals": list(signals)},
            width=len(signals),
            capacity=_CAPACITY,
            blocking=blocking,
            name="the sender of the stream",
            remedy="run without --stream to go on",
        )

    def finish(self) -> dict[str, Any]:
        """Send the remaining rows, end the process and return its counts; never raises for a process that died.

        ``sent`` counts the datagrams that the system accepted, ``lost`` those that it refused or that nobody listened
        to; both are None when the process died. ``rows_dropped`` counts rows for which the ring had no room. A receiver
        that is too slow sees its own losses in ``sequence``.
        """
        if self._figures is None:
            reply = self.end({})
            self._figures = {
                "url": "udp://{}:{}".format(*self._destination),
                "sent": reply.get("sent"),
                "lost": reply.get("lost"),
                "rows_dropped": self.ring.dropped,
                "error": reply.get("error") or reply.get("why"),
            }
            self.close()
        return self._figures


class UdpSender:
    """Sends one row per 10 ms of scenario time; never waits for a receiver.

    A datagram that the system does not accept, or that nobody listened to, is counted as lost. Raises RefusedError when
    there is no route to the address.
    """

    failing = None

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
        self._time = config["signals"].index("loop.t_s")
        self._writer = DatagramWriter(config["signals"])
        self._decimator = Decimator(PERIOD_S)
        self._sent = 0
        self._lost = 0
        self._why: str | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect((config["host"], config["port"]))
        except OSError as error:
            raise RefusedError(
                f"--stream udp://{config['host']}:{config['port']}: {error.strerror}; name an address of this network"
            ) from error

    def poll(self) -> None:
        """Send the rows that are safe to read."""
        self._send_until(self._ring.settled())

    def line(self, _record: Record) -> None:
        """Ignore lines: a run sends none before "finish"."""

    def finish(self, _record: Record | None) -> Record:
        """Send the remaining rows and return the counts."""
        self._send_until(self._ring.head)
        if self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._count_unheard()
        return {"sent": self._sent, "lost": self._lost, "why": self._why}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send_until(self, stop: int) -> None:
        while self._ring.tail < stop:
            end = min(stop, self._ring.tail + _BATCH)
            rows = self._ring.rows(self._ring.tail, end)
            self._ring.release(end)
            for row in rows[self._decimator.keep(rows[:, self._time])].tolist():
                for datagram in self._writer.datagrams(row):
                    self._send(datagram)
                time.sleep(_PAUSE_S)

    def _send(self, datagram: bytes) -> None:
        try:
            try:
                self._socket.send(datagram)
            except ConnectionError:  # about the last datagram, to which nobody listened; this one was not sent
                self._count_unheard()
                self._socket.send(datagram)
            self._sent += 1
        except OSError as error:
            self._lost += 1
            self._why = self._why or f"the system did not take it ({error.strerror})"

    def _count_unheard(self) -> None:
        self._sent -= 1
        self._lost += 1
        self._why = self._why or "nobody listened there"


class DatagramWriter:
    """Splits rows into datagrams of at most ``MOST_BYTES``; ``loop.t_s`` must be among the signals.

    Every row is split at the same signals. Each datagram has ``timestamp``, the scenario's time [s], and ``sequence``,
    which counts datagrams from 0, so that a receiver sees its losses. A missing value is null, which PlotJuggler skips.
    """

    def __init__(self, signals: Sequence[str]) -> None:
        self._time = list(signals).index("loop.t_s")
        self._pieces: list[list[tuple[int, tuple[str, ...]]]] = [[]]
        self._sequence = 0
        for index, signal in enumerate(signals):
            place = (index, tuple(signal.split(".")))
            if self._pieces[-1] and len(_encoded(1e9, 10**12, [*self._pieces[-1], place], None)) > MOST_BYTES:
                self._pieces.append([])
            self._pieces[-1].append(place)

    def datagrams(self, row: Sequence[float]) -> Iterator[bytes]:
        """Yield the datagrams of one row."""
        for piece in self._pieces:
            yield _encoded(row[self._time], self._sequence, piece, row)
            self._sequence += 1


def _encoded(t_s: float, sequence: int, piece: list[tuple[int, tuple[str, ...]]], row: Sequence[float] | None) -> bytes:
    """Return a datagram as JSON; without a row, the longest that these signals can give."""
    tree: dict[str, object] = {"timestamp": t_s, "sequence": sequence}
    for index, (*groups, name) in piece:
        table = tree
        for group in groups:
            below = table.setdefault(group, {})
            assert isinstance(below, dict), f"{group} is a signal and a group"
            table = below
        value = _LONGEST if row is None else row[index]
        table[name] = value if math.isfinite(value) else None
    return json.dumps(tree, separators=(",", ":")).encode()


if __name__ == "__main__":
    sys.exit(run(UdpSender))
