"""Reading a port that has no descriptor to wait on: Windows' COM ports, and pyserial's URLs that are no file."""

import threading
from typing import Protocol

_PATIENCE_S = 0.05  # how long one read blocks, and so how long stopping may take
_LONGEST = 1 << 20  # bytes that wait for a host that does not read; older ones are no use to it


class Port(Protocol):
    """The part of a pyserial port that is needed."""

    timeout: float | None

    @property
    def in_waiting(self) -> int: ...
    def read(self, size: int = 1, /) -> bytes: ...


class Reader:
    """A thread that blocks in the port's own read, so that ``read`` can wait for any time.

    The port's timeout is set once: for RFC 2217 each change of it is a negotiation over the network. ``unread_bytes``
    counts those that were dropped because nobody read them.
    """

    def __init__(self, port: Port) -> None:
        self._port = port
        self._arrived = threading.Condition()
        self._received = bytearray()
        self._failure: Exception | None = None
        self._stopping = False
        self.unread_bytes = 0
        port.timeout = _PATIENCE_S
        self._thread = threading.Thread(target=self._run, name="serial reader", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            while not self._stopping:
                # The first byte is waited for in the driver; in_waiting only says how many came with it.
                data = self._port.read(1)
                if data:
                    data += self._port.read(self._port.in_waiting)
                    with self._arrived:
                        self._received += data
                        self.unread_bytes += max(0, len(self._received) - _LONGEST)
                        del self._received[:-_LONGEST]
                        self._arrived.notify()
        except Exception as error:  # noqa: BLE001 - read() raises it where it is seen
            with self._arrived:
                self._failure = error
                self._arrived.notify()

    def read(self, timeout_ns: int) -> bytes:
        """Return what has arrived, waiting at most ``timeout_ns`` for it. Raises OSError when the port is lost."""
        with self._arrived:
            if not self._received and self._failure is None and timeout_ns > 0:
                self._arrived.wait(timeout_ns * 1e-9)
            data = bytes(self._received)
            self._received.clear()
        if not data and self._failure is not None:
            raise OSError(str(self._failure)) from self._failure
        return data

    def stop(self) -> None:
        """Ask the thread to end."""
        self._stopping = True

    def join(self) -> None:
        """Wait for it, after the port was closed."""
        self._thread.join()
