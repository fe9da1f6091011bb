"""The process that streams over UDP: ``python -m hil.record.udp_sender``, started by ``hil.record.udp``."""

import socket
import sys
import time

from hil.record.datagrams import DatagramWriter
from hil.record.decimate import Decimator
from hil.record.ring import RingReader
from hil.record.ring_child import Record, RefusedError, run

PERIOD_S = 0.01
_BATCH = 1000
_PAUSE_S = 0.0002  # between rows, so that a receiver's buffer outlasts a run in lockstep


class UdpSender:
    """Sends a row each 10 ms of scenario time, and waits for nobody.

    What the system does not take is lost, and counted, as is what it says that nobody listened to. Raises RefusedError
    when there is no way to the address.
    """

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
        """Send of the rows that have settled in the ring."""
        self._take(self._ring.settled())

    def line(self, _record: Record) -> None:
        """There are no lines but the last."""

    def finish(self, _record: Record | None) -> Record:
        """Send the rest."""
        self._take(self._ring.head)
        if self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._count_unheard()
        return {"sent": self._sent, "lost": self._lost, "why": self._why}

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _take(self, stop: int) -> None:
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
            except ConnectionError:  # of the datagram before: there was nobody; this one has not been tried
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


if __name__ == "__main__":
    sys.exit(run(UdpSender))
