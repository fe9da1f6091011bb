"""Messages between the processes of this project: one JSON object per line over a pipe."""

import json
import math
import os
import sys
from collections.abc import Mapping
from typing import Any

KEPT_BACK_BYTES = 256 * 1024


class LineWriter:
    """Writes lines to another process without waiting for it to read.

    Bytes that do not fit into the pipe are kept in a buffer of ``KEPT_BACK_BYTES`` and written before the next line.
    ``lost`` counts the lines that did not fit into the buffer or came after the end of the process.
    (On Windows, Python before 3.12 cannot write to a pipe without waiting: a full pipe then blocks.)
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._kept_back = b""
        self._broken = False
        self.lost = 0
        if sys.platform != "win32":
            os.set_blocking(fd, False)

    @property
    def kept_back(self) -> int:
        """Bytes in the buffer, which the pipe has not taken yet."""
        return len(self._kept_back)

    def send(self, record: Mapping[str, object], *, always: bool = False) -> bool:
        """Write or buffer one record; with ``always`` the buffer grows as needed.

        Return False if the record was lost because the buffer is full.
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
        """Write as much of the buffer as the pipe accepts. Return whether the buffer is empty."""
        while self._kept_back and not self._broken:
            try:
                self._kept_back = self._kept_back[os.write(self._fd, self._kept_back) :]
            except BlockingIOError:
                return False
            except OSError:
                # The reader has ended. Lines that are still in the buffer are lost.
                self._broken = True
                self.lost += self._kept_back.count(b"\n")
                self._kept_back = b""
        return True


class LineReader:
    """Reads records from a file descriptor, without a buffered file: a thread that waits in one holds a lock, which is
    fatal when the interpreter ends.
    """

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._buffer = b""

    def read(self) -> dict[str, object] | None:
        """Wait for the next record; None at the end of the pipe. A last line that is cut short is dropped."""
        while b"\n" not in self._buffer:
            data = os.read(self._fd, 65536)
            if not data:
                return None
            self._buffer += data
        line, _, self._buffer = self._buffer.partition(b"\n")
        record: dict[str, object] = json.loads(line)
        return record


def json_safe(value: Any) -> Any:
    """Return a value with None in place of every NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
