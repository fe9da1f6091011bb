"""The child's side of ``hil.record.ring_process``: takes rows and lines until "finish" comes or the run ends.

It sees the end of the run by the end of the pipe, or because its parent process has changed. In both cases it finishes
the file with all rows in the ring. SIGINT is ignored: the run handles it.
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
    """The process cannot do what the config asks for; the text is a sentence for the user."""


class RowWriter(Protocol):
    """What the child process does with rows and lines."""

    @property
    def failing(self) -> str | None:
        """Why nothing can be written at present, or None; the run is told when it changes."""

    def poll(self) -> None:
        """Look for rows in the ring; called every ``POLL_S`` and after each line."""

    def line(self, record: Record) -> None:
        """Take a line: a JSON object that the run sent."""

    def finish(self, record: Record | None) -> Record:
        """Drain the ring, close the file, return the report; ``record`` is None when the run ended without "finish"."""

    def close(self) -> None:
        """Release what is left."""


def run(make: Callable[[Record, RingReader], RowWriter], prepare: Callable[[], None] | None = None) -> int:
    """Read the config, make the writer, pass it rows and lines, and end the process when it is done.

    ``prepare`` is called before the config comes. ``make`` raises RefusedError for a config that the user must change.
    Returns an exit code only when there was nothing to write: 0 if no config came, 2 if it was refused.
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
    # Everything is written and the run waits: a normal exit, with the libraries' clean-up, would take 0.1 s or more.
    os._exit(0)


def _step_back() -> None:
    """Take a lower priority than the run, whose real-time priority this process may have inherited."""
    if sys.platform == "linux":
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if sys.platform != "win32":
        os.nice(5)


def _serve(writer: RowWriter, inbox: _Inbox, replies: LineWriter, parent_pid: int) -> None:
    told = None
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
        if writer.failing != told:
            told = writer.failing
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
