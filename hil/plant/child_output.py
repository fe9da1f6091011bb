"""The output of a child process: read without delay, stored in bounded memory, shown as plain text."""

import threading
from collections import deque
from collections.abc import Iterable

from hil.core.ports import Note

_LOGGED_TROUBLE = ("log (warning)", "log (discard)", "log (error)", "log (fatal)")  # as callbacks.c writes them
_FIRST_LINES = 100
_NEWEST_LINES = 20
_LONGEST_LINE = 300  # characters that are kept of a line
_KEPT_BYTES = 8192  # of a line


class ChildOutput:
    """The first lines and the newest lines of a process's output, and the number of lines between them.

    One thread calls ``feed``, another one ``new_lines``; neither waits for the other. Memory is bounded, also for a
    process that prints without end.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()  # never held for longer than a few lines take
        self._waiting: deque[str] = deque()
        self._begun = b""  # a line that has not ended
        self._first = self._left_out = 0
        self._newest: deque[bytes] = deque(maxlen=_NEWEST_LINES)  # of those that were left out
        self._last = b""  # that is not blank

    def feed(self, printed: bytes) -> None:
        with self._lock:
            *lines, rest = (self._begun + printed).split(b"\n")
            self._begun = rest[:_KEPT_BYTES]
            for line in lines:
                self._last = line[:_KEPT_BYTES] if line.strip() else self._last
                if self._first < _FIRST_LINES:
                    self._first += 1
                    self._waiting.append(_words(line))
                else:
                    self._left_out += 1
                    self._newest.append(line[:_KEPT_BYTES])

    def __bool__(self) -> bool:
        """Return whether ``new_lines`` has lines to return."""
        return bool(self._waiting)

    def forget_newest(self) -> None:
        """Forget the last line, because another process prints from now on."""
        with self._lock:
            self._last = self._begun = b""

    def new_lines(self) -> list[str]:
        """Return the lines since the last call, as long as the limit of first lines is not reached."""
        lines = [self._waiting.popleft() for _ in range(len(self._waiting))]
        return [line for line in lines if line]

    def end(self) -> list[str]:
        """Return a summary at the end: the number of omitted lines, and the newest lines."""
        with self._lock:
            left_out = self._left_out - len(self._newest)
            note = [f"{left_out} lines are left out here"] if left_out else []
            lines = [*map(_words, self._newest), _words(self._begun)]
            self._newest.clear()
            self._begun, self._left_out = b"", 0
            return self.new_lines() + note + [line for line in lines if line]

    def last(self) -> str:
        """Return the last line that is not blank; empty when there is none."""
        with self._lock:
            return _words(self._begun) or _words(self._last)


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
