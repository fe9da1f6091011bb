"""The process that writes a trace: ``python -m hil.wire.trace.writer``, started by ``hil.wire.trace.session``."""

import struct
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import can

from hil.record.files import why_not_written
from hil.record.ring import RingReader
from hil.record.ring_child import Record, RefusedError, run
from hil.wire.trace import packing

_BATCH = 1000


class TraceWriter:
    """Moves frames from the ring to python-can's writer for the file's ending. It counts frames as the ring's lines.

    Raises RefusedError when the file cannot be opened.
    """

    failing = None
    """Of a ``RowWriter``. A trace that fails is told when it ends, since the run goes on without it."""

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
        self._error: str | None = None
        self._frames = 0  # of the batch that is written
        self._path = Path(config["path"])
        try:
            self._file: Any = can.Logger(self._path)
        except OSError as error:
            raise RefusedError(f"trace {self._path}: {error.strerror}; choose a path that can be written") from error

    def poll(self) -> None:
        """Write the frames that are complete in the ring buffer."""
        self._write_until(self._ring.settled())

    def line(self, _record: Record) -> None:
        """Do nothing: no lines come before the last."""

    def finish(self, _record: Record | None) -> Record:
        """Write the rest and close the file."""
        self._write_until(self._ring.head)
        self._attempt(self._file.stop)
        return {"frames_written": self._ring.lines_saved, "error": self._error}

    def close(self) -> None:
        """Do nothing: nothing is left to release."""

    def _write_until(self, stop: int) -> None:
        while self._ring.tail < stop:
            end = min(stop, self._ring.tail + _BATCH)
            table = self._ring.rows(self._ring.tail, end)
            # After the first failure frames are only discarded, so that the run never waits.
            if self._error is None and self._attempt(partial(self._write, table)):
                self._ring.release(end)
                self._ring.add_lines_saved(self._frames)
            else:
                self._ring.give_up(end)

    def _write(self, table: Any) -> None:
        self._frames = 0
        for row in table:
            for message in packing.unpack(row.tobytes()):
                self._file.on_message_received(can.Message(**message))
                self._frames += 1
        # Keeps the file valid up to here if the machine or this process dies. A BLF file is written in blocks.
        self._file.file.flush()

    def _attempt(self, write: Callable[[], None]) -> bool:
        """Write to the file; keep the text of the first failure. Return whether it succeeded."""
        try:
            write()
        except OSError as error:
            self._error = self._error or why_not_written(self._path, error)
        except (ValueError, struct.error) as error:  # a number that the file's format cannot hold
            self._error = self._error or f"python-can's writer refused a frame: {error}"
        else:
            return True
        return False


if __name__ == "__main__":
    sys.exit(run(TraceWriter))
