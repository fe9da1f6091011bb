"""A terminal device that does not make its reader wait. POSIX only."""

import time
from collections.abc import Callable

from firmware_protocol.built import BuildError
from firmware_protocol.fast_calls import fast_call
from hil.core.errors import BadInputError

_QUIET_NS = 20_000_000


class Terminal:
    """Reads and writes a non-blocking terminal device with few system calls; pyserial does what that leaves.

    Linux passes on what has come in a thread of the kernel, without real-time priority. While there is nothing to read,
    ``select`` and ``read`` wait for that thread, on a busy machine for milliseconds. So this asks first whether there
    is. Both calls are made in the host library, without letting other threads run: they do not wait.

    Raises BadInputError when the library cannot be loaded.
    """

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        try:
            self._read: Callable[[int], bytes | None] = fast_call("terminal_read")
            self._write: Callable[[int, bytes], int] = fast_call("terminal_write")
        except BuildError as error:
            raise BadInputError(str(error)) from error
        self._quiet_until_ns = 0

    def write(self, data: bytes) -> int:
        """Return how many bytes were written; 0 when the line is full or lost."""
        return self._write(self._descriptor, data)

    def read(self) -> bytes | None:
        """Return what has arrived; None when nothing has for 20 ms or the line is lost: a read by pyserial tells."""
        data = self._read(self._descriptor)
        if data:
            self._quiet_until_ns = 0
            return data
        now_ns = time.monotonic_ns()
        if not self._quiet_until_ns:
            self._quiet_until_ns = now_ns + _QUIET_NS
        return data if now_ns < self._quiet_until_ns else None
