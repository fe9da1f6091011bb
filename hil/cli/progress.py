"""The progress of many runs on stderr, in one line that is overwritten."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from hil.cli.options import end_in_order
from hil.core.errors import RunInterruptedError


def runs_progress(done: int, total: int, trouble: str | None) -> None:
    """Show how many runs are done; ``trouble``, a sentence on the newest run, stays on a line of its own."""
    if trouble is not None:
        print(f"\r{trouble}", file=sys.stderr)
    print(f"\r{done} of {total} runs", end="\n" if done == total else "", file=sys.stderr, flush=True)


@contextlib.contextmanager
def batch(*, as_json: bool) -> Iterator[Callable[[int, int, str | None], None] | None]:
    """Make interrupts end the runs in order; yield a function that shows progress, or None with ``--json`` or without a
    terminal.
    """
    end_in_order()
    try:
        yield None if as_json or not sys.stderr.isatty() else runs_progress
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the runs were ended") from None


class RateProgress:
    """The progress of many runs, on stderr: runs done, failed and left, their rate, and the time left.

    ``before`` is the number of runs done earlier. A trouble is shown once, on a line that stays.
    """

    def __init__(self, of: int, before: int) -> None:
        self._of = of
        self._before = self._done = before
        self._failed = 0
        self._began_s = time.monotonic()
        self._trouble: str | None = None
        self._shown = 0

    def count(self, done: int, failed: int) -> None:
        """Add ``done`` finished runs, of which ``failed`` failed."""
        self._done += done
        self._failed += failed
        self._show()

    def say(self, trouble: str | None) -> None:
        """Show the cause of waiting when it has changed; None when there is none."""
        if trouble != self._trouble and trouble is not None:
            print(f"\r{trouble:<{self._shown}}", file=sys.stderr)
        self._trouble = trouble
        self._show()

    def end(self) -> None:
        """End the line, so that it stays."""
        print(file=sys.stderr, flush=True)

    def _show(self) -> None:
        line = self._line()
        print(f"\r{line:<{self._shown}}", end="", file=sys.stderr, flush=True)
        self._shown = len(line)

    def _line(self) -> str:
        counts = f"{self._done} of {self._of} runs, {self._failed} failed"
        new, since_s = self._done - self._before, time.monotonic() - self._began_s
        if not new or not since_s:
            return counts
        left = duration_words((self._of - self._done) * since_s / new)
        return f"{counts}, {new / since_s:.3g} runs/s, {left} left"


def duration_words(seconds: float) -> str:
    """Return a duration as a person would say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
