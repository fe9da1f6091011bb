"""What commands print: results as JSON or as lines, tables, warnings, the progress of many runs; and how they end."""

import contextlib
import itertools
import json
import os
import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path, PurePath
from types import FrameType
from typing import Any, TextIO

from hil.core.errors import RunInterruptedError
from hil.core.json_lines import json_safe
from hil.core.printable import command, raw_stream
from hil.core.subprocesses import on_signals

WIDEST = 120
"""Columns of the widest help."""
_NARROWEST = 40
_GAP = 2
_READABLE = 20
_COMMAND = re.compile(r"""\s*(['"]?)(?:.*[/\\])?(?:hil|pytest)(?:\.exe)?\1 """)


def print_json(value: Any) -> None:
    """Print one JSON object on a line."""
    print(json.dumps(json_safe(value), allow_nan=False, default=str))


def print_result(as_json: bool, value: Any, lines: Iterable[str]) -> None:
    """Print a command's result: one JSON object with ``--json``, else the lines."""
    if as_json:
        print_json(value)
    else:
        for line in lines:
            for part in folded(line):
                print(part)


def next_command(program: str, *words: str | PurePath) -> str:
    """Return a command of this installation, to be typed next in this folder and this shell.

    ``program`` is hil or pytest. It is named with its folder where hil itself was called so, as from a virtual
    environment that is not activated.
    """
    called = Path(sys.argv[0])
    beside = called.stem == "hil" and not shutil.which("hil")
    return command(called.with_name(f"{program}{called.suffix}") if beside else program, *words)


def say(line: str) -> None:
    """Print a line at once, for a reader that waits for it."""
    print(line, flush=True)


def rows(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield a line for each label and text."""
    return (f"  {label:<22} {text}".rstrip() for label, text in pairs)


def table(rows: Sequence[Sequence[str]], *, has_head: bool = True) -> Iterator[str]:
    """Yield rows in columns as wide as the terminal allows; the last column is not padded. No word is cut.

    Where columns of prose would be too narrow to read, each row becomes a paragraph under the names of the columns.
    """
    columns = [*zip(*rows, strict=True)]
    widths = [max(map(len, column)) for column in columns]
    limit = terminal_width()
    if limit is not None:
        least = [max(len(word) for text in column for word in text.split() or [""]) for column in columns]
        room = limit - _GAP * (len(widths) - 1)
        cap = next((cap for cap in range(room, 0, -1) if sum(_capped(widths, least, cap)) <= room), 0)
        if has_head and (cap == 0 or (cap < _READABLE and max(widths) > 3 * _READABLE)):
            yield from _paragraphs(rows, limit)
            return
        widths = _capped(widths, least, cap)
    for row in rows:
        cells = [_wrapped(text, width) for text, width in zip(row, widths, strict=True)]
        for parts in itertools.zip_longest(*cells, fillvalue=""):
            padded = [part.ljust(width) for part, width in zip(parts[:-1], widths, strict=False)]
            yield (" " * _GAP).join([*padded, parts[-1]]).rstrip()


def terminal_width(stream: TextIO | None = None) -> int | None:
    """Return the columns of the terminal; None where a stream goes to a file or a program.

    The stream is stdout unless another one is given.
    """
    if not (stream or sys.stdout).isatty():
        return None
    return max(_NARROWEST, shutil.get_terminal_size().columns)


def folded(line: str, stream: TextIO | None = None) -> list[str]:
    """Return a line as lines that fit the terminal, indented to its text. A command stays whole, to be copied."""
    limit = terminal_width(stream)
    if limit is None or len(line) <= limit or _COMMAND.match(line):
        return [line]
    texts = [found.end() for found in re.finditer(r"\S\s{2,}(?=\S)", line) if found.end() <= limit // 2]
    indent = texts[-1] if texts else min(len(line) - len(line.lstrip()) + 2, limit // 2)
    return _wrapped(line, limit, indent)


def _capped(widths: Sequence[int], least: Sequence[int], cap: int) -> list[int]:
    return [max(word, min(width, cap)) for width, word in zip(widths, least, strict=True)]


def _paragraphs(rows: Sequence[Sequence[str]], limit: int) -> Iterator[str]:
    head, *others = rows
    label = max(map(len, head[1:]))
    for row in others:
        yield from _wrapped(row[0], limit)
        for name, text in zip(head[1:], row[1:], strict=True):
            if text:
                yield from _wrapped(f"  {name:<{label}}  {text}", limit, label + 4)


def _wrapped(text: str, width: int, indent: int = 0) -> list[str]:
    if len(text) <= width:
        return [text]
    return textwrap.wrap(text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False)


def say_on_stderr(text: str) -> None:
    """Print lines on stderr, folded to its terminal. A stderr that is closed changes neither run nor exit code."""
    with contextlib.suppress(OSError):
        for line in text.splitlines():
            print(*folded(line, sys.stderr), sep="\n", file=sys.stderr)


def warn(sentence: str) -> None:
    """Print a warning on stderr. The recording has the sentence too."""
    say_on_stderr(f"hil: warning: {sentence}")


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


def end_in_order() -> None:
    """Make SIGTERM and SIGHUP end a command as Ctrl-C does: robots are stopped, files closed."""
    on_signals(_interrupt, "SIGTERM", "SIGHUP")


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


_LINE_EVERY_S = 10.0


class RunsProgress:
    """The progress of many runs on stderr: runs done and failed, rate, time left.

    On a terminal it is one line that is overwritten. Elsewhere, as in a pipe or in the log of a CI, it is a line each
    10 s.
    """

    def __init__(self) -> None:
        self._is_terminal = sys.stderr.isatty()
        self._first: tuple[int, float] | None = None  # runs done and time [s] at the first call
        self._trouble: str | None = None
        self._width = 0
        self._shown_s = 0.0

    def __call__(self, done: int, total: int, trouble: str | None, failed: int | None = None) -> None:
        """Show how many runs are done and failed. A new ``trouble``, a sentence, stays on a line of its own."""
        now_s = time.monotonic()
        if trouble not in (None, self._trouble):
            print("\r" if self._is_terminal else "", f"{trouble:<{self._width}}", sep="", file=sys.stderr, flush=True)
        self._trouble = trouble
        line = f"{done} of {total} runs" + ("" if failed is None else f", {failed} failed")
        if self._first is None:
            self._first, self._shown_s = (done, now_s), now_s
        new, since_s = done - self._first[0], now_s - self._first[1]
        if new and since_s:
            line += f", {new / since_s:.3g} runs/s, {duration_words((total - done) * since_s / new)} left"
        if self._is_terminal:
            print("\r", f"{line:<{self._width}}", sep="", end="", file=sys.stderr, flush=True)
            self._width = len(line)
        elif now_s - self._shown_s >= _LINE_EVERY_S:
            print(line, file=sys.stderr, flush=True)
            self._shown_s = now_s

    def end(self) -> None:
        """End the line, so that it stays."""
        if self._width:
            print(file=sys.stderr, flush=True)


@contextlib.contextmanager
def batch(*, as_json: bool) -> Iterator[RunsProgress | None]:
    """End the runs in order on an interrupt. Yield what shows progress; None with ``--json``."""
    end_in_order()
    progress = None if as_json else RunsProgress()
    try:
        yield progress
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the runs were ended") from None
    finally:
        if progress is not None:
            progress.end()


@contextlib.contextmanager
def slowly(text: str) -> Iterator[Callable[[str], None]]:
    """Show the present step of a command that takes long, on a line of stderr's terminal that goes again.

    Yield a function that changes the text. Where stderr is no terminal nothing is printed.
    """
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console

    with Console(file=raw_stream(sys.stderr)).status(text) as shown:
        yield shown.update


def duration_words(seconds: float) -> str:
    """Return a duration in s, min or h."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
