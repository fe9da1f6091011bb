"""The recorder process: ``python -m hil.telemetry.recorder``, started by ``hil.telemetry.session``.

It reads rows from the ring and lines from its standard input, and writes them to a file at full rate and to
live viewers at about 100 Hz.
"""

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import rerun as rr

from hil.telemetry.files import why_not_written
from hil.telemetry.live import LiveServer
from hil.telemetry.ring import RingReader
from hil.telemetry.ring_child import Record, RefusedError, run
from hil.telemetry.stream import Stream

BATCH_ROWS = 1000
BATCH_AGE_S = 0.5


class Recorder:
    """Moves rows from the ring to the file and the live server, and events to both.

    Raises RefusedError when the file cannot be written or the port not be bound.
    """

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
        self._config = config
        self._file = None if config["path"] is None else _open_file(config)
        self._live = None if config["live_port"] is None else _open_live(config)
        # A run that waits for room must not wait for a batch that its ring cannot hold.
        self._batch_rows = min(BATCH_ROWS, (ring.capacity + 1) // 2)
        self._head_seen = 0
        self._passed_on = 0
        self._batch_since = time.monotonic()
        self._error: str | None = None

    def poll(self) -> None:
        """Take the rows that the ring held at the last poll; younger ones may not have settled in memory."""
        settled, self._head_seen = self._head_seen, self._ring.head
        self._pass_to_live(settled)
        waiting = settled - self._ring.tail
        now = time.monotonic()
        if waiting == 0:
            self._batch_since = now
        elif waiting >= self._batch_rows or now - self._batch_since >= BATCH_AGE_S:
            self._take(settled)
            self._batch_since = now

    def line(self, record: Record) -> None:
        """Pass a line of the event log on."""
        t_s, level, text = record["event"]
        self._write(lambda file: file.event(t_s, level, text))
        if self._live is not None:
            self._live.event(t_s, level, text)

    def finish(self, summary: Record | None) -> Record:
        """Drain the ring, close the file, and return the report; live viewers stay served."""
        end = self._ring.head
        self._pass_to_live(end)
        self._take(end)
        counts = {"rows_written": self._ring.saved, "rows_dropped": self._ring.dropped}
        self._write(lambda file: file.finish(summary, counts))
        self._write(Stream.close)
        if self._live is not None:
            self._live.finish(summary, counts)
        live_error = None if self._live is None else self._live.error
        return {"rows_written": self._ring.saved, "error": self._error, "live_error": live_error}

    def close(self) -> None:
        """Stop serving live viewers."""
        if self._live is not None:
            self._live.close()

    def _pass_to_live(self, stop: int) -> None:
        if self._live is not None and stop > self._passed_on:
            self._live.rows(self._ring.rows(self._passed_on, stop))
            self._passed_on = stop

    def _take(self, stop: int) -> None:
        while self._ring.tail < stop:
            end = min(stop, self._ring.tail + BATCH_ROWS)
            if self._write(partial(Stream.rows, rows=self._ring.rows(self._ring.tail, end))):
                self._ring.mark_saved(end)
            self._ring.release(end)

    def _write(self, write: Callable[[Stream], None]) -> bool:
        """Write and flush; after the first failure rows are only taken, so that the run never waits."""
        if self._file is None or self._error is not None:
            return False
        try:
            write(self._file)
            self._file.flush()
        except (RuntimeError, OSError) as error:
            self._error = why_not_written(Path(self._config["path"]), error)
            return False
        return True


def main() -> int:
    """Record until told to finish, or until the run has gone; 0 when the file was finished."""
    rr.set_strict_mode(True)
    return run(Recorder)


def _open_file(config: Record) -> Stream:
    path = Path(config["path"])
    try:
        return Stream(
            rr.FileSink(path),
            recording_id=config["recording_id"],
            signals=config["signals"],
            properties=config["properties"],
            live=False,
        )
    except (RuntimeError, OSError) as error:
        raise RefusedError(f"recording {path}: {error}; choose a path that can be written") from error


def _open_live(config: Record) -> LiveServer:
    port = config["live_port"]
    try:
        return LiveServer(
            port,
            recording_id=config["recording_id"],
            signals=config["signals"],
            properties=config["properties"],
        )
    except (RuntimeError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RefusedError(
            f"live port {port}: {reason} on 127.0.0.1; end the program that uses it, or choose another port"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
