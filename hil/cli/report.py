"""Texts and tables that the commands print."""

import contextlib
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.judge.results import RunResult
from hil.judge.words import belief_rows, figure_rows, link_rows, outcome_rows, recorded_at
from hil.record.files import new_in_runs

if TYPE_CHECKING:
    from hil.runtime.assembly import Watch
    from hil.runtime.loop import Loop

_REFRESH_HZ = 10


def recording_path(name: str, requested: str | None) -> Path | None:
    """Return the file to record to: None for ``none``; by default a new one in ``runs/``, which is made if missing."""
    if requested == "none":
        return None
    if requested is not None:
        return Path(requested)
    return new_in_runs(name, ".rrd", "name a file with --record, or --record none")


def catalogue_folder() -> Path:
    """Return the path of a new folder in ``runs/``, for the recordings of runs that failed the catalogue's checks."""
    return new_in_runs("catalogue", "", "go where you may write")


def progress(duration_s: float) -> "Watch":
    """Return a context manager that shows a progress bar on stderr during a run."""
    from rich.console import Console
    from rich.live import Live
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    @contextmanager
    def watch(loop: "Loop") -> Iterator[None]:
        text = TextColumn("{task.completed:6.2f} s of {task.total:g} s")
        bar = Progress(text, BarColumn(), TimeRemainingColumn(), auto_refresh=False)
        task = bar.add_task("run", total=duration_s)

        def updated() -> Progress:
            bar.update(task, completed=loop.t_s)
            return bar

        with Live(get_renderable=updated, console=Console(stderr=True), transient=True, refresh_per_second=_REFRESH_HZ):
            yield

    return watch


def warn(sentence: str) -> None:
    """Print a warning on stderr."""
    # A closed stderr must not end a run; the recording has the sentence too.
    with contextlib.suppress(OSError):
        print(f"hil: warning: {sentence}", file=sys.stderr)


def announce_live(port: int) -> None:
    """Print on stderr how to open a viewer; open one if stderr is a terminal and there is a display."""
    from hil.record.viewer import live_hint, show_live

    print(live_hint(port), file=sys.stderr)
    if sys.stderr.isatty():
        show_live(port)


def linger() -> None:
    """Wait for Ctrl-C, because a run in lockstep is over before a viewer has opened."""
    print("done; live viewers are served until Ctrl-C", file=sys.stderr)
    with suppress(KeyboardInterrupt):
        threading.Event().wait()


def print_result(result: RunResult) -> None:
    """Print the figures of a run, its expectations, and the next commands to use."""
    print_figures(result.metrics)
    recorded = result.metrics.get("recorded")
    path = None if recorded is None else recorded_at(recorded, result.metrics["recording"])
    print()
    print("Next:")
    hil = _command()
    hints = [(f"  {hil} show {result.scenario.path or result.scenario.name}", "# every value and where it came from")]
    if path is not None:
        hints.insert(0, (f"  {hil} review {path}", "# how it went, from the recording alone"))
        if path.endswith(".rrd"):
            hints.insert(0, (f"  {hil} view {path}", "# see it in the rerun viewer; --web for a browser"))
    print_table(hints)


def _command() -> str:
    """Return the command as this user can call it: its name, or its path if it is in a virtual environment not
    activated.
    """
    called = Path(sys.argv[0])
    return "hil" if shutil.which("hil") or called.name != "hil" else str(called)


def print_figures(metrics: Mapping[str, Any]) -> None:
    """Print the figures of a run (or why one is missing), its expectations, and whether it passed."""
    print_rows(figure_rows(metrics))
    print_rows(belief_rows(metrics))
    print_rows(link_rows(metrics))
    for sentence in (metrics.get("reference") or {}).get("warnings", ()):
        print_rows([("warning", sentence)])
    print_rows(outcome_rows(metrics))
    if (trace := metrics.get("trace")) is not None:
        written = f"{trace['frames']} frames in {trace['path']}"
        print_rows([("trace", trace["trouble"] or written)])
    if (stream := metrics.get("streamed")) is not None:
        print_rows([("stream", _streamed(stream))])
    if (passed := metrics.get("passed")) is not None:
        print_rows([("passed", "yes" if passed else "no")])


def _streamed(stream: Mapping[str, Any]) -> str:
    """Return a text on the result of a stream."""
    if stream["sent"] is None:
        return f"to {stream['url']} incomplete: {stream['error']}"
    text = f"{stream['sent']} datagrams to {stream['url']}"
    if stream["lost"]:
        text += f", {stream['lost']} lost: {stream['error']}"
    if stream["rows_dropped"]:
        text += f", {stream['rows_dropped']} rows dropped: the sender was too slow"
    return text


def print_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Print one line for each label and text."""
    for label, text in rows:
        print(f"  {label:<22} {text}".rstrip())


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns; the last column is not padded. Nothing is cut, so that names can be copied."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        print("  ".join([*padded, row[-1]]).rstrip())
