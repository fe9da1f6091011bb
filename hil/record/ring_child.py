"""The child's side of ``hil.record.ring_process``: takes rows and lines until told to finish, or the run has gone.

It notices that at the end of the pipe, or when it has another parent. Either way its file is finished with all that was
in the ring. SIGINT is ignored: the run handles it.
"""

import os
import queue
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, Protocol

from hil.core.json_lines import LineReader, LineWriter
from hil.record.ring import RingReader, SharedBlock

POLL_S = 0.02
LAST_LINES_S = 0.5

Record = dict[str, Any]
_Inbox = queue.SimpleQueue[Record | None]


class RefusedError(Exception):
    """A file cannot be made as it was asked for; the text is a sentence for the user."""


class RowWriter(Protocol):
    """What such a process does with rows and lines."""

    def poll(self) -> None:
        """Look for rows in the ring; called every ``POLL_S`` and after each line."""

    def line(self, record: Record) -> None:
        """Take a line."""

    def finish(self, record: Record | None) -> Record:
        """Drain the ring, close the file, and return the report; ``record`` is None when the run has gone."""

    def close(self) -> None:
        """Release what is left."""


def run(make: Callable[[Record, RingReader], RowWriter], prepare: Callable[[], None] | None = None) -> int:
    """Make the writer from the run's config and serve it; ends the process when the writer is done.

    ``prepare`` does what needs no config; ``make`` raises RefusedError for what the user must change. Returns only
    when nothing was to be written, with the exit code: 0 without a config, 2 for a refused one.
    """
    _step_back()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    inbox: _Inbox = queue.SimpleQueue()
    signal.signal(signal.SIGTERM, lambda _number, _frame: inbox.put(None))
    replies = LineWriter(os.dup(1))
    os.dup2(2, 1)  # output of a library must not get between the replies
    if prepare is not None:
        prepare()

    lines = LineReader(0)
    config: Record | None = lines.read()
    if config is None:
        return 0
    ring = RingReader(SharedBlock.attach(config["block"], config["block_bytes"]))
    try:
        writer = make(config, ring)
    except RefusedError as refusal:
        replies.send({"refused": str(refusal)})
        return 2
    replies.send({"ready": True})
    threading.Thread(target=_read_lines, args=(lines, inbox), name="lines", daemon=True).start()
    _serve(writer, inbox, replies, config["parent_pid"])
    writer.close()
    # All is in the file, and the run waits: an orderly exit of the libraries would take 0.1 s and more.
    os._exit(0)


def _step_back() -> None:
    """Take a lower priority than the run, whose real-time priority this process may have inherited."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(5)


def _serve(writer: RowWriter, inbox: _Inbox, replies: LineWriter, parent_pid: int) -> None:
    while True:
        record = _next(inbox, parent_pid)
        if record is None:
            writer.finish(None)
            return
        if "finish" in record:
            replies.send(writer.finish(record["finish"]))
            while record["keep_live"] and _next(inbox, parent_pid) is not None:
                pass
            return
        if record:
            writer.line(record)
        writer.poll()


def _next(inbox: _Inbox, parent_pid: int) -> Record | None:
    """Return the next record, an empty one after POLL_S, or None when the run has gone."""
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
