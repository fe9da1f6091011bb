"""The recorder process: ``python -m hil.telemetry.recorder``, started by ``hil.telemetry.session``.

It reads rows from the ring and lines from its standard input, and writes them to a file at full rate and to
live viewers at about 100 Hz. It ends when it is told to, or when the run has gone: end of the pipe, or
another parent. Either way the file is finished with all that was in the ring. SIGINT is the run's business
and ignored here.
"""

import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rerun as rr

from hil.telemetry.channel import LineReader, LineWriter
from hil.telemetry.live import LiveServer
from hil.telemetry.memory import SharedBlock
from hil.telemetry.ring import RingReader
from hil.telemetry.stream import Stream

POLL_S = 0.02
BATCH_ROWS = 1000
BATCH_AGE_S = 0.5

Record = dict[str, Any]
Inbox = queue.SimpleQueue[Record | None]


class RefusedError(Exception):
    """A recording cannot be made as it was asked for; the text is a sentence for the user."""


class Recorder:
    """Moves rows from the ring to the file and the live server, and events to both.

    Raises RefusedError when the file cannot be written or the port not be bound.
    """

    def __init__(self, config: Record, ring: RingReader) -> None:
        self._ring = ring
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

    def event(self, t_s: float, level: str, text: str) -> None:
        """Pass a line of the event log on."""
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
            self._error = str(error)
            return False
        return True


def main() -> int:
    """Record until told to finish, or until the run has gone; 0 when the file was finished."""
    _step_back()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    inbox: Inbox = queue.SimpleQueue()
    signal.signal(signal.SIGTERM, lambda _number, _frame: inbox.put(None))
    replies = LineWriter(os.dup(1))
    os.dup2(2, 1)  # what a library prints must not get between the replies
    rr.set_strict_mode(True)

    lines = LineReader(0)
    config: Record | None = lines.read()
    if config is None:
        return 0
    block = SharedBlock.attach(config["block"], config["block_bytes"])
    ring = RingReader(block)
    try:
        recorder = Recorder(config, ring)
    except RefusedError as refusal:
        replies.send({"refused": str(refusal)})
        return 2
    replies.send({"ready": True})
    threading.Thread(target=_read_lines, args=(lines, inbox), name="lines", daemon=True).start()
    _serve(recorder, inbox, replies, config["parent_pid"])
    recorder.close()
    return 0


def _step_back() -> None:
    """Take a lower priority than the run, whose loop may have a real-time one for us to inherit."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(5)


def _serve(recorder: Recorder, inbox: Inbox, replies: LineWriter, parent_pid: int) -> None:
    while True:
        record = _next(inbox, parent_pid)
        if record is None:
            recorder.finish(None)
            return
        if "event" in record:
            recorder.event(*record["event"])
        if "finish" in record:
            replies.send(recorder.finish(record["finish"]))
            while record["keep_live"] and _next(inbox, parent_pid) is not None:
                pass
            return
        recorder.poll()


def _next(inbox: Inbox, parent_pid: int) -> Record | None:
    """Return the next record, an empty one after POLL_S, or None when the run has gone."""
    try:
        return inbox.get(timeout=POLL_S)
    except queue.Empty:
        # A process that the run forked may still hold the pipe open after the run's own end.
        orphaned = sys.platform != "win32" and os.getppid() != parent_pid
        return None if orphaned else {}


def _read_lines(lines: LineReader, inbox: Inbox) -> None:
    record: Record | None = {}
    while record is not None:
        record = lines.read()
        inbox.put(record)


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
