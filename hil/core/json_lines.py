"""One JSON text a line over a pipe: how processes of ours talk to each other."""

import json
import math
import os
import select
import sys
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any

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


class LinePoll:
    """Reads the records that are at hand, without ever waiting; for a loop that has no time (0.6 µs when none is).

    ``ended`` is true once the pipe has ended and its last record was taken. (Windows cannot poll a pipe
    without waiting: there a thread reads.)
    """

    ended = False

    if sys.platform == "win32":

        def __init__(self, fd: int) -> None:
            self._arrived: deque[dict[str, object] | None] = deque()
            threading.Thread(target=self._read, args=(LineReader(fd),), name="lines", daemon=True).start()

        def _read(self, lines: LineReader) -> None:
            record: dict[str, object] | None = {}
            while record is not None:
                record = lines.read()
                self._arrived.append(record)

        def take(self) -> list[dict[str, object]]:
            """Return the records that have arrived, oldest first."""
            records = []
            while self._arrived:
                record = self._arrived.popleft()
                if record is None:
                    self.ended = True
                else:
                    records.append(record)
            return records

    else:

        def __init__(self, fd: int) -> None:
            self._fd = fd
            self._buffer = b""
            # Half as long as a read that fails for want of data, which raises.
            self._poll = select.poll()
            self._poll.register(fd, select.POLLIN)

        def take(self) -> list[dict[str, object]]:
            """Return the records that have arrived, oldest first."""
            if not self._poll.poll(0):
                return []
            data = os.read(self._fd, 65536)
            self.ended = not data
            *lines, self._buffer = (self._buffer + data).split(b"\n")
            return [json.loads(line) for line in lines]


def json_safe(value: Any) -> Any:
    """Return a value for JSON, which has neither NaN nor infinity: null takes their place."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
