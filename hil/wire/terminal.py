"""A terminal device that does not make its reader wait. POSIX only."""

import fcntl
import os
import termios
import time
from functools import partial

_CHUNK = 4096  # as many bytes as Linux keeps for a reader of a terminal
_NONE = bytes(4)
_QUIET_NS = 20_000_000


class Terminal:
    """Reads and writes a non-blocking terminal device with few system calls; pyserial does what that leaves.

    Linux passes on what has come in a thread of the kernel, without real-time priority. While there is nothing to read,
    ``select`` and ``read`` wait for that thread, on a busy machine for milliseconds. So this asks first whether there
    is.
    """

    def __init__(self, descriptor: int) -> None:
        self._waiting = bytearray(4)  # how many bytes wait to be read: fcntl.ioctl is slower with bytes
        self._count_waiting = partial(fcntl.ioctl, descriptor, termios.FIONREAD, self._waiting)
        self._read = partial(os.read, descriptor, _CHUNK)
        self._write = partial(os.write, descriptor)
        self._quiet_until_ns = 0

    def write(self, data: bytes) -> int:
        """Return how many bytes were written; 0 when the line is full or lost."""
        try:
            return self._write(data)
        except OSError:
            return 0

    def read(self) -> bytes | None:
        """Return what has arrived; None when nothing has for 20 ms or the line is lost: a read by pyserial tells."""
        try:
            self._count_waiting()
            if self._waiting != _NONE:
                self._quiet_until_ns = 0
                return self._read()
        except OSError:
            return None
        now_ns = time.monotonic_ns()
        if not self._quiet_until_ns:
            self._quiet_until_ns = now_ns + _QUIET_NS
        return b"" if now_ns < self._quiet_until_ns else None
