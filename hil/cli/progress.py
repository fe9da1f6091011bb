"""How far many runs are, on stderr: one line that is written over."""

import sys
import time
from collections.abc import Callable
from typing import TypeVar

A = TypeVar("A")


def runs_progress(trouble: Callable[[A], str | None]) -> Callable[[int, int, A], None]:
    """Return what to call with how many runs are done, of how many, and what became of the newest.

    ``trouble`` is a sentence about one that is not as it should be, which stays to be read; None for any other.
    """

    def tell(done: int, of: int, newest: A) -> None:
        if (sentence := trouble(newest)) is not None:
            print(f"\r{sentence}", file=sys.stderr)
        print(f"\r{done} of {of} runs", end="\n" if done == of else "", file=sys.stderr, flush=True)

    return tell


class RateProgress:
    """How far many runs are, on stderr: how many of how many, how fast, how many failed, how long it will take.

    ``before`` were done earlier. Troubles are said once, each on a line that stays.
    """

    def __init__(self, of: int, before: int) -> None:
        self._of = of
        self._before = self._done = before
        self._failed = 0
        self._began_s = time.monotonic()
        self._trouble: str | None = None
        self._shown = 0

    def count(self, done: int, failed: int) -> None:
        """Count so many more runs."""
        self._done += done
        self._failed += failed
        self._show()

    def say(self, trouble: str | None) -> None:
        """Say what is waited for, when it is something else than before."""
        if trouble != self._trouble and trouble is not None:
            print(f"\r{trouble:<{self._shown}}", file=sys.stderr)
        self._trouble = trouble
        self._show()

    def end(self) -> None:
        """Leave the line as it is."""
        print(file=sys.stderr, flush=True)

    def _show(self) -> None:
        line = self._line()
        print(f"\r{line:<{self._shown}}", end="", file=sys.stderr, flush=True)
        self._shown = len(line)

    def _line(self) -> str:
        told = f"{self._done} of {self._of} runs, {self._failed} failed"
        new, since_s = self._done - self._before, time.monotonic() - self._began_s
        if not new or not since_s:
            return told
        left = duration_words((self._of - self._done) * since_s / new)
        return f"{told}, {new / since_s:.3g} runs/s, {left} left"


def duration_words(seconds: float) -> str:
    """Return a time as a person says it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
