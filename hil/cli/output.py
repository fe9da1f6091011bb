"""What commands print: results as JSON or as lines, tables, warnings, the progress of many runs; and how they end."""

import contextlib
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from types import FrameType
from typing import Any

from hil.core.errors import RunInterruptedError
from hil.core.json_lines import json_safe


def print_json(value: Any) -> None:
    """Print one JSON object on a line."""
    print(json.dumps(json_safe(value), allow_nan=False, default=str))


def print_result(as_json: bool, value: Any, lines: Iterable[str]) -> None:
    """Print a command's result: one JSON object with ``--json``, else the lines."""
    if as_json:
        print_json(value)
    else:
        for line in lines:
            print(line)


def say(line: str) -> None:
    """Print a line at once, for a reader that waits for it."""
    print(line, flush=True)


def rows(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield a line for each label and text."""
    return (f"  {label:<22} {text}".rstrip() for label, text in pairs)


def table(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield rows in columns; the last column is not padded. Nothing is cut, so that names can be copied."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-1]
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        yield "  ".join([*padded, row[-1]]).rstrip()


def warn(sentence: str) -> None:
    """Print a warning on stderr."""
    with contextlib.suppress(OSError):  # a closed stderr must not end a run; the recording has the sentence too
        print(f"hil: warning: {sentence}", file=sys.stderr)


def drop_output() -> None:
    """Send stdout to the null device, because its reader is gone or the disk is full.

    Otherwise the interpreter would report an error when it exits.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def flush_output() -> None:
    """Write the rest of stdout's buffer. Its reader may be gone, as after head."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        drop_output()


def on_signals(handler: Callable[[int, FrameType | None], None], *names: str) -> None:
    """Handle these signals; one that is ignored, as SIGHUP under nohup, stays ignored."""
    for name in names:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def end_in_order() -> None:
    """Make SIGTERM and SIGHUP end a command as Ctrl-C does: robots are stopped, files closed."""
    on_signals(_interrupt, "SIGTERM", "SIGHUP")


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class RunsProgress:
    """The progress of many runs on stderr, in one line that is overwritten: runs done and failed, rate, time left."""

    def __init__(self) -> None:
        self._first: tuple[int, float] | None = None  # runs done and time [s] at the first call
        self._trouble: str | None = None
        self._width = 0

    def __call__(self, done: int, total: int, trouble: str | None, failed: int | None = None) -> None:
        """Show how many runs are done and failed. A new ``trouble``, a sentence, stays on a line of its own."""
        if trouble not in (None, self._trouble):
            print("\r", f"{trouble:<{self._width}}", sep="", file=sys.stderr)
        self._trouble = trouble
        line = f"{done} of {total} runs" + ("" if failed is None else f", {failed} failed")
        done_before, began_s = self._first = self._first or (done, time.monotonic())
        new, since_s = done - done_before, time.monotonic() - began_s
        if new and since_s:
            line += f", {new / since_s:.3g} runs/s, {duration_words((total - done) * since_s / new)} left"
        print("\r", f"{line:<{self._width}}", sep="", end="", file=sys.stderr, flush=True)
        self._width = len(line)

    def end(self) -> None:
        """End the line, so that it stays."""
        if self._width:
            print(file=sys.stderr, flush=True)


@contextlib.contextmanager
def batch(*, as_json: bool) -> Iterator[RunsProgress | None]:
    """End the runs in order on an interrupt. Yield what shows progress; None with ``--json`` or without a terminal."""
    end_in_order()
    progress = None if as_json or not sys.stderr.isatty() else RunsProgress()
    try:
        yield progress
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the runs were ended") from None
    finally:
        if progress is not None:
            progress.end()


def duration_words(seconds: float) -> str:
    """Return a duration in s, min or h."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
