"""The recorder process, ``python -m hil.record.recorder``, which ``hil.record.recording`` starts.

It reads rows from the ring and lines from its standard input, and writes them to files at full rate and to live viewers
at 50 Hz.
"""

import contextlib
import errno
import gc
import sys
import time
from typing import TYPE_CHECKING

from hil.record.ring import RingReader
from hil.record.ring_child import Record, RefusedError, run
from hil.record.run_files import BATCH_ROWS, RunFiles
from hil.record.started_process import WITH_RERUN, refuse_pandas

if TYPE_CHECKING:
    from hil.record.live import LiveServer

# With two polls and the write itself, a row is safe 150 ms after it was put.
BATCH_AGE_S = 0.08


class Recorder:
    """Moves rows from the ring to the files and the live server, and events to both.

    Raises RefusedError when the file cannot be written or the port cannot be bound. A recorder that replaces one that
    died (``restarts`` above 0) never raises it, because the run is under way.
    """

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
        self._files = None if config["path"] is None else RunFiles(config, ring)
        self._live: LiveServer | None = None
        self._live_error: str | None = None
        if config["live_port"] is not None:
            try:
                self._live = _open_live(config)
            except RefusedError as refusal:
                if not config["restarts"]:
                    raise
                self._live_error = str(refusal)
        # A batch must fit the ring, or a run that waits for room would wait for ever.
        self._batch_rows = min(BATCH_ROWS, (ring.capacity + 1) // 2)
        self._passed_on = ring.tail
        self._batch_since = time.monotonic()

    def poll(self) -> None:
        """Pass new rows to live viewers at once, and to the files when a batch is full or old enough."""
        settled = self._ring.settled()
        self._pass_to_live(settled)
        waiting = settled - self._ring.tail
        now = time.monotonic()
        if waiting <= 0:
            self._batch_since = now
        elif waiting >= self._batch_rows or now - self._batch_since >= BATCH_AGE_S:
            self._write_until(settled)
            self._batch_since = now
        if self._files is not None:
            self._files.check()

    @property
    def failing(self) -> str | None:
        """Why the files cannot be written at present, or None."""
        return None if self._files is None else self._files.failing

    def line(self, record: Record) -> None:
        """Write a line of the event log to the files and to live viewers."""
        if self._files is not None:
            self._files.event(*record["event"])
        else:
            self._ring.add_lines_saved(1)
        if self._live is not None:
            self._live.event(*record["event"])

    def finish(self, summary: Record | None) -> Record:
        """Write the rows still in the ring, close the file and return the report; live viewers are still served."""
        end = self._ring.head
        self._pass_to_live(end)
        if self._files is not None:
            self._files.finish(summary)
        else:
            self._write_until(end)
        if self._live is not None:
            self._live.finish(summary, {"rows_written": self._ring.saved, "rows_dropped": self._ring.dropped})
            self._live_error = self._live.error
        report: Record = {"rows_written": self._ring.saved, "live_error": self._live_error}
        if self._files is not None:
            report |= {"trouble": self._files.trouble, "error": self._files.summary_trouble}
        return report

    def close(self) -> None:
        """Stop serving live viewers."""
        if self._live is not None:
            self._live.close()

    def _pass_to_live(self, stop: int) -> None:
        if self._live is not None and stop > self._passed_on:
            self._live.rows(self._ring.rows(self._passed_on, stop))
            self._passed_on = stop

    def _write_until(self, stop: int) -> None:
        if self._files is not None:
            self._files.write_until(stop)
        else:
            self._ring.give_up(stop)


def main() -> int:
    """Record until the run sends "finish" or ends; returns an exit code only when there was nothing to record."""
    return run(Recorder, _import_rerun if WITH_RERUN in sys.argv else None)


def _import_rerun() -> None:
    """Import rerun before the config comes. If it is missing, opening a file or the port reports that later."""
    refuse_pandas()
    # Imported modules stay in memory, so the garbage collector need not scan them.
    gc.disable()
    with contextlib.suppress(ImportError):
        import hil.record.stream  # noqa: F401
    gc.freeze()
    gc.enable()


def _open_live(config: Record) -> "LiveServer":
    port = config["live_port"]
    try:
        from hil.record.live import LiveServer
    except ImportError as error:
        raise RefusedError(f"live port {port}: {error}; install rerun-sdk==0.41.*, or run without --live") from error
    try:
        return LiveServer(port, **{name: config[name] for name in ("recording_id", "signals", "properties")})
    except (RuntimeError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, OSError) and error.errno in (errno.EFBIG, errno.ENOSPC):
            raise RefusedError(f"live port {port}: {reason}; make room on the disk, or run without --live") from error
        raise RefusedError(
            f"live port {port}: {reason} on 127.0.0.1; end the program that uses it, or choose another port"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
