"""The output of a child process: read without delay, stored in bounded memory, shown as plain text."""

import threading
from collections import deque
from collections.abc import Iterable

from hil.core.ports import Note

_LOGGED_TROUBLE = ("log (warning)", "log (discard)", "log (error)", "log (fatal)")  # as callbacks.c writes them
_FIRST_LINES = 100
_NEWEST_LINES = 20
_LONGEST_LINE = 300  # characters that are kept of a line
_KEPT_BYTES = 8192  # of a line that has not ended, and of the newest lines


class ChildOutput:
    """The first lines and the newest lines of a process's output, and the number of lines between them.

    One thread calls ``feed``, another one ``new_lines``; neither waits for the other. Memory is bounded, also for a
    process that prints without end.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()  # never held for longer than a few lines take
        self._waiting: deque[str] = deque()
        self._begun = b""  # a line that has not ended
        self._newest = b""
        self._lines = 0
        self._passed_on = 0

    def feed(self, printed: bytes) -> None:
        """Add bytes that the process has printed."""
        with self._lock:
            self._newest = (self._newest + printed)[-_KEPT_BYTES:]
            self._lines += printed.count(b"\n")
            if self._passed_on >= _FIRST_LINES:
                return
            *lines, rest = (self._begun + printed).split(b"\n")
            self._begun = rest[:_KEPT_BYTES]
            for line in lines[: _FIRST_LINES - self._passed_on]:
                self._passed_on += 1
                self._waiting.append(_words(line))

    def __bool__(self) -> bool:
        """Return whether ``new_lines`` has lines to return."""
        return bool(self._waiting)

    def forget_newest(self) -> None:
        """Discard the newest lines, because another process prints from now on."""
        with self._lock:
            self._newest = b""

    def new_lines(self) -> list[str]:
        """Return the lines since the last call, as long as the limit of first lines is not reached."""
        lines = [self._waiting.popleft() for _ in range(len(self._waiting))]
        return [line for line in lines if line]

    def end(self) -> list[str]:
        """Return a summary at the end: the number of omitted lines, and the newest lines."""
        with self._lock:
            *whole, unfinished = self._newest.split(b"\n")
            rest = self._lines - self._passed_on
            newest = whole[-min(rest, _NEWEST_LINES, len(whole)) :] if rest else []
            self._passed_on = self._lines
            self._begun = b""
            left_out = rest - len(newest)
            note = [f"{left_out} lines are left out here"] if left_out else []
            lines = [*map(_words, newest), _words(unfinished)]
            return self.new_lines() + note + [line for line in lines if line]

    def last(self) -> str:
        """Return the last line that is not blank; empty when there is none."""
        with self._lock:
            newest = self._newest
        lines = (_words(line) for line in reversed(newest.split(b"\n")))
        return next((line for line in lines if line), "")


def log_lines(lines: Iterable[str], t_s: float, note: Note) -> None:
    """Write lines that a plant has printed into the event log of a run."""
    for line in lines:
        note(t_s, "warning" if line.startswith(_LOGGED_TROUBLE) else "info", f"the plant says: {line}")


def _words(line: bytes) -> str:
    return one_line(line[: 4 * _LONGEST_LINE].decode(errors="replace"))[:_LONGEST_LINE]


def one_line(text: str) -> str:
    """Return the text in one line, without the control characters of a terminal.

    >>> one_line("red: \\x1b[31m,\\nend")
    'red: [31m, end'
    """
    return " ".join("".join(sign if sign.isprintable() else " " for sign in text).split())
