"""One JSON text a line over a pipe: what the run tells the recorder besides rows, and what it answers."""

import json
import os
import sys
import time
from collections.abc import Mapping

KEPT_BACK_BYTES = 256 * 1024


class LineWriter:
    """Writes lines to a process that may not be reading, without ever waiting for it.

    What the pipe does not take is kept back and written before the next line, up to ``KEPT_BACK_BYTES``; a
    line beyond that, or to a process that has ended, is lost and counted in ``lost``. (Windows before Python
    3.12 cannot write to a pipe without waiting: there, a full pipe waits for the reader.)
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._kept_back = b""
        self._broken = False
        self.lost = 0
        if sys.platform != "win32":
            os.set_blocking(fd, False)

    def send(self, record: Mapping[str, object], *, always: bool = False) -> bool:
        """Write one record, or keep it back, or count it as lost; ``always`` keeps it back whatever its size.

        Return False when it was lost because too much is kept back already.
        """
        line = json.dumps(record).encode() + b"\n"
        full = len(self._kept_back) + len(line) > KEPT_BACK_BYTES and not always
        if self._broken or full:
            self.lost += 1
        else:
            self._kept_back += line
            self.flush()
        return self._broken or not full

    def flush(self) -> bool:
        """Write what was kept back as far as the pipe takes it; True when there is nothing left to write."""
        while self._kept_back and not self._broken:
            try:
                self._kept_back = self._kept_back[os.write(self._fd, self._kept_back) :]
            except BlockingIOError:
                return False
            except OSError:
                # The reader has ended. What it never took is lost.
                self._broken = True
                self.lost += self._kept_back.count(b"\n")
                self._kept_back = b""
        return True


class LineReader:
    """Reads records from a descriptor; the pipe's end, and only that, ends the iteration.

    ``os.read`` and not a buffered file: a thread that waits here must not hold a lock at the interpreter's
    end.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._buffer = b""

    def read(self) -> dict[str, object] | None:
        """Return the next record, or None at the end of the pipe. A last line cut short is dropped."""
        while b"\n" not in self._buffer:
            data = os.read(self._fd, 65536)
            if not data:
                return None
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        record: dict[str, object] = json.loads(line)
        return record


class Patience:
    """Counts waits without progress: a suspended program must not mistake its own absence for a dead peer."""

    def __init__(self, waits: int, wait_s: float = 0.0005) -> None:
        self._waits = waits
        self._wait_s = wait_s
        self._left = waits
        self._progress: object = None

    def wait(self, progress: object) -> bool:
        """Wait a little; False when ``progress`` has stayed the same for all the waits that were granted."""
        if progress != self._progress:
            self._progress = progress
            self._left = self._waits
        self._left -= 1
        time.sleep(self._wait_s)
        return self._left > 0
