"""The log of a service: lines on stderr, as text for a person or as JSON objects for a collector.

Logging never waits: a full pipe must not stall a control loop. When nobody reads stderr, lines are dropped, and the
next line that is written has their number. Of the same event 20 lines are written at once and then two a second; the
next of them has the number of those that were left out.
"""

import json
import logging
import os
import select
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Any

from hil.addons.service.messages import LogStyle
from hil.core.printable import printable

# A pipe takes this many bytes in one piece, if it takes any at once (POSIX: PIPE_BUF is at least 512, on Linux 4096).
_LONGEST_LINE_BYTES = 4096 if sys.platform == "linux" else 512
_AT_ONCE = 20.0
_PER_S = 2.0
_MOST_EVENTS = 1000
NAME = "hil.service"
"""The logger of a service."""
_LOGGER = logging.getLogger(NAME)


def configure(style: LogStyle, process: str, descriptor: int = 2) -> None:
    """Write the log of this process to stderr; ``process`` is its name in each line."""
    handler = _Handler(descriptor)
    handler.setFormatter(_Formatter(style, process))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(logging.WARNING)  # for libraries
    _LOGGER.setLevel(logging.INFO)


def log(level: str, event: str, /, **fields: object) -> None:
    """Log an event at a level: info, warning (solved, or it needs attention) or error (a failure).

    ``event`` is a constant text; varying values go into the fields.
    """
    _LOGGER.log(logging.getLevelName(level.upper()), event, extra={"fields": fields})


info, warning, error = (partial(log, level) for level in ("info", "warning", "error"))


class Rate:
    """A limit of ``per_s`` on average, and of ``at_once`` after a pause (a token bucket)."""

    def __init__(self, per_s: float, at_once: float) -> None:
        self._per_s, self._at_once = per_s, at_once
        self._left = at_once
        self._filled_s = time.monotonic()

    def take(self, number: float = 1.0) -> bool:
        """Take so many; return False, and take none, where there are fewer."""
        now_s = time.monotonic()
        self._left = min(self._at_once, self._left + (now_s - self._filled_s) * self._per_s)
        self._filled_s = now_s
        if self._left < number:
            return False
        self._left -= number
        return True


@dataclass
class _Allowance:
    """The rate of an event's lines, and how many were left out since the last one."""

    rate: Rate
    left_out: int = 0


class _Handler(logging.Handler):
    def __init__(self, descriptor: int) -> None:
        super().__init__()
        self._descriptor = descriptor
        self._dropped = 0
        self._allowances: dict[tuple[object, ...], _Allowance] = {}

    def _is_allowed(self, record: logging.LogRecord) -> bool:
        # Orders of each kind count apart, so that many of one do not hide another.
        event = (record.name, record.levelno, record.getMessage(), getattr(record, "fields", {}).get("action"))
        if len(self._allowances) >= _MOST_EVENTS:
            self._allowances.clear()  # a library puts values into its texts
        allowance = self._allowances.setdefault(event, _Allowance(Rate(_PER_S, _AT_ONCE)))
        if not allowance.rate.take():
            allowance.left_out += 1
            return False
        if allowance.left_out:
            record.left_out, allowance.left_out = allowance.left_out, 0
        return True

    def emit(self, record: logging.LogRecord) -> None:
        if not self._may_write_line():  # first: a line that is dropped takes no other's place
            self._dropped += 1
            return
        if not self._is_allowed(record):
            return
        if self._dropped:
            record.dropped = self._dropped
        line = self._line(record)
        if len(line) >= _LONGEST_LINE_BYTES:
            line = self._cut(record)
        try:
            os.write(self._descriptor, line + b"\n")
            self._dropped = 0
        except OSError:  # the reader is gone, or the disk is full
            self._dropped += 1 + getattr(record, "left_out", 0)

    def _line(self, record: logging.LogRecord) -> bytes:
        return self.format(record).encode("utf-8", "backslashreplace")

    def _cut(self, record: logging.LogRecord) -> bytes:
        """Return a line that is short enough: no fields, and of a traceback the end, which has the cause."""
        trace = "" if not record.exc_info else logging.Formatter().formatException(record.exc_info)
        record.exc_info, record.msg, record.args = None, f"{record.getMessage()[:200]}… (cut)", ()
        for characters in (_LONGEST_LINE_BYTES // 2, _LONGEST_LINE_BYTES // 16):  # of which each may be written as six
            record.fields = {"traceback": f"…{trace[-characters:]}"} if trace else {}
            if len(line := self._line(record)) < _LONGEST_LINE_BYTES:
                break
        return line

    def _may_write_line(self) -> bool:
        if sys.platform == "win32":
            return True  # Windows cannot poll a pipe
        poll = select.poll()
        poll.register(self._descriptor, select.POLLOUT)
        return bool(poll.poll(0))


class _Formatter(logging.Formatter):
    def __init__(self, style: LogStyle, process: str) -> None:
        super().__init__()
        self._is_json = style == "json"
        self._process = process

    def format(self, record: logging.LogRecord) -> str:
        fields: dict[str, Any] = dict(getattr(record, "fields", {}))
        if record.name != _LOGGER.name:
            fields["logger"] = record.name
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        for field, attribute in (("lines_dropped", "dropped"), ("left_out", "left_out")):
            if hasattr(record, attribute):
                fields[field] = getattr(record, attribute)
        stamp, level = datetime.fromtimestamp(record.created, UTC), record.levelname.lower()
        if not self._is_json:
            words = " ".join([record.getMessage(), *(f"{name}={_word(value)}" for name, value in fields.items())])
            time = stamp.astimezone().strftime("%H:%M:%S.%f")[:-3]
            return printable(f"{time} {level:7} {self._process}: {words}").replace("\n", "\\n")
        iso = stamp.isoformat(timespec="milliseconds").replace("+00:00", "Z")
        line = {"time": iso, "level": level, "process": self._process, "event": record.getMessage()}
        # A field cannot replace a key of the line itself.
        return json.dumps(fields | line, default=str)


def _word(value: object) -> str:
    text = str(value)
    return json.dumps(text, ensure_ascii=False) if not text or any(c in text for c in ' "=\n\t') else text
