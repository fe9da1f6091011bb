"""The recorder process, ``python -m hil.record.recorder``, which ``hil.record.recording`` starts.

It reads rows from the ring and lines from its standard input, and writes them to files at full rate and to live viewers
at 50 Hz, until "finish" comes or the run ends. It sees the end of the run by the end of the pipe, or because its parent
process has changed. In both cases it finishes the file with all rows in the ring.
"""

import contextlib
import errno
import gc
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Sequence
from pkgutil import resolve_name
from typing import cast

from hil.core.json_lines import LineReader, LineWriter
from hil.record import viewing
from hil.record.ring import RingReader, SharedBlock
from hil.record.run_files import BATCH_ROWS, Record, RefusedError, RunFiles
from hil.record.started_process import WITH_RERUN, refuse_pandas

# With two polls and the write itself, a row is safe 150 ms after it was put.
BATCH_AGE_S = 0.08
POLL_S = 0.02
LAST_LINES_S = 0.5

_Inbox = queue.SimpleQueue[Record | None]


class Recorder:
    """Moves rows from the ring to the files and the live server, and events to both.

    Raises RefusedError when the file cannot be written or the port cannot be bound. A recorder that replaces one that
    died (``restarts`` above 0) never raises it, because the run is under way.
    """

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
        self._files = None if config["path"] is None else RunFiles(config, ring)
        self._live: viewing.LiveServer | None = None
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
    """Record until the run sends "finish" or ends; returns an exit code only when there was nothing to record.

    That is 0 if no config came, and 2 if it was refused.
    """
    _step_back()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run handles it
    inbox: _Inbox = queue.SimpleQueue()
    signal.signal(signal.SIGTERM, lambda _number, _frame: inbox.put(None))
    replies = LineWriter(os.dup(1))
    os.dup2(2, 1)  # output of a library must not get between the replies
    if WITH_RERUN in sys.argv:
        _import_rerun(sys.argv[2:])
    lines = LineReader(0)
    config: Record | None = lines.read()
    if config is None:
        return 0
    ring = RingReader(SharedBlock.attach(config["block"], config["block_bytes"]))
    try:
        recorder = Recorder(config, ring)
    except RefusedError as refusal:
        replies.send({"refused": str(refusal)})
        return 2
    replies.send({"ready": True})
    threading.Thread(target=_read_lines, args=(lines, inbox), name="lines", daemon=True).start()
    _serve(recorder, inbox, replies, config["parent_pid"])
    recorder.close()
    # Everything is written and the run waits: a normal exit, with the libraries' clean-up, would take 0.1 s or more.
    os._exit(0)


def _import_rerun(places: Sequence[str]) -> None:
    """Import rerun, and what draws, before the config comes. If one is missing, opening a file or the port says so."""
    refuse_pandas()
    # Imported modules stay in memory, so the garbage collector need not scan them.
    gc.disable()
    with contextlib.suppress(ImportError):
        import hil.record.stream  # noqa: F401

        for place in places:
            resolve_name(place)
    gc.freeze()
    gc.enable()


def _open_live(config: Record) -> viewing.LiveServer:
    port = config["live_port"]
    try:
        live = viewing.part("live", config["viewer"])
    except ImportError as error:
        raise RefusedError(f"live port {port}: {error}; install rerun-sdk==0.41.*, or run without --live") from error
    try:
        columns = {name: config[name] for name in ("recording_id", "signals", "properties")}
        return cast(viewing.LiveServer, live(port, **columns))
    except (RuntimeError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, OSError) and error.errno in (errno.EFBIG, errno.ENOSPC):
            raise RefusedError(f"live port {port}: {reason}; make room on the disk, or run without --live") from error
        raise RefusedError(
            f"live port {port}: {reason} on 127.0.0.1; end the program that uses it, or choose another port"
        ) from error


def _step_back() -> None:
    """Take a lower priority than the run, whose real-time priority this process may have inherited."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(5)


def _serve(recorder: Recorder, inbox: _Inbox, replies: LineWriter, parent_pid: int) -> None:
    told = None
    while True:
        record = _next(inbox, parent_pid)
        if record is None:
            recorder.finish(None)
            return
        if "finish" in record:
            replies.send(recorder.finish(record["finish"]))
            while record["keep_live"] and _next(inbox, parent_pid) is not None:
                pass
            return
        if record:
            recorder.line(record)
        recorder.poll()
        if recorder.failing != told:
            told = recorder.failing
            replies.send({"failing": told})


def _next(inbox: _Inbox, parent_pid: int) -> Record | None:
    """Return the next record, an empty one after POLL_S, or None when the run has ended."""
    try:
        return inbox.get(timeout=POLL_S)
    except queue.Empty:
        if sys.platform == "win32" or os.getppid() == parent_pid:
            return {}
    # The run has ended. A process that it forked may still hold the pipe open, so do not wait for the pipe's end; but
    # the run's last lines may be in it.
    try:
        return inbox.get(timeout=LAST_LINES_S)
    except queue.Empty:
        return None


def _read_lines(lines: LineReader, inbox: _Inbox) -> None:
    record: Record | None = {}
    while record is not None:
        record = lines.read()
        inbox.put(record)


if __name__ == "__main__":
    sys.exit(main())
