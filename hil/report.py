"""What the commands print for a person."""

import shutil
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import BadInputError, nearest
from hil.results import RunResult

if TYPE_CHECKING:
    from hil.assembly import Watch
    from hil.loop import Loop
    from hil.plant.tools import FmuInfo

_REFRESH_S = 0.1


def recording_path(name: str, asked: str | None) -> Path | None:
    """Return where to record: ``none`` for nowhere, by default a new file in ``runs/``, which is made."""
    if asked == "none":
        return None
    if asked is not None:
        return Path(asked)
    folder = Path("runs")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"recording folder {folder.absolute()}: it cannot be made ({error.strerror}); name a file with --record, "
            "or --record none"
        ) from error
    return folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}.rrd"  # noqa: DTZ005 - the user's own time


def progress(duration_s: float) -> "Watch":
    """Return a watcher that shows a bar on stderr while a run goes on."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    @contextmanager
    def watch(loop: "Loop") -> Iterator[None]:
        columns = (
            TextColumn("{task.completed:6.2f} s of {task.total:g} s"),
            BarColumn(),
            TimeRemainingColumn(),
        )
        done = threading.Event()
        with Progress(*columns, console=Console(stderr=True), transient=True, auto_refresh=False) as bar:
            task = bar.add_task("run", total=duration_s)

            def follow() -> None:
                while not done.wait(_REFRESH_S):
                    bar.update(task, completed=loop.t_s, refresh=True)

            follower = threading.Thread(target=follow, name="progress", daemon=True)
            follower.start()
            try:
                yield
            finally:
                done.set()
                follower.join()

    def make(loop: "Loop") -> AbstractContextManager[object]:
        return watch(loop)

    return make


def announce_live(port: int) -> None:
    """Say on stderr how a viewer reaches the run, and open one when a person watches and there is a display."""
    from hil.telemetry.view import live_hint, show_live

    print(live_hint(port), file=sys.stderr)
    if sys.stderr.isatty():
        show_live(port)


def linger() -> None:
    """Wait for Ctrl-C: a run in lockstep is over before a viewer has opened."""
    print("done; live viewers are served until Ctrl-C", file=sys.stderr)
    with suppress(KeyboardInterrupt):
        threading.Event().wait()


def print_result(result: RunResult) -> None:
    """Print the figures of a run, its expectations, and what to do next."""
    print_figures(result.metrics)
    path = result.metrics["recording"]
    print()
    print("Next:")
    hil = _command()
    hints = [(f"  {hil} show {result.scenario.path or result.scenario.name}", "# every value and where it came from")]
    if path is not None:
        hints.insert(0, (f"  {hil} view {path}", "# see it in the rerun viewer; --web for a browser"))
        hints.insert(1, (f"  {hil} review {path}", "# the figures again, from the recording alone"))
    print_table(hints)


def _command() -> str:
    """Return how this user reaches the command: by name, or by the path of a virtual environment not activated."""
    called = Path(sys.argv[0])
    return "hil" if shutil.which("hil") or called.name != "hil" else str(called)


def print_figures(metrics: Mapping[str, Any]) -> None:
    """Print the figures of a run or of a recording, with the reason where there is none."""
    reasons = metrics.get("reasons", {})
    for label, name, unit, scale in _FIGURES:
        value = metrics.get(name)
        if value is not None:
            print(f"  {label:<22} {value * scale:.5g} {unit}")
        elif name in reasons:
            print(f"  {label:<22} -      {reasons[name]}")
    tick = metrics.get("tick_us")
    if tick is not None:
        print(f"  {'tick p50, p99':<22} {tick['p50']:.1f}, {tick['p99']:.1f} µs")
    frames = metrics.get("frames")
    if frames is not None:
        rejected = ", ".join(f"{cause} {count}" for cause, count in frames["rejected"].items()) or "none"
        print(f"  {'frames':<22} {frames['sent']} sent, {frames['received']} received, rejected: {rejected}")
    for row in metrics.get("fault") or ():
        print(f"  {'fault':<22} {row['kind']} {row['target']}: applied {row['applied']} times")
    for row in metrics.get("expect") or ():
        print(f"  {'expect':<22} {row['text']}")
    recorded = metrics.get("recorded")
    if recorded is not None and (recorded["error"] or recorded["dropped"] or recorded["lost"]):
        lost = f"{recorded['dropped']} rows dropped, {recorded['lost']} lost"
        print(f"  {'recording':<22} incomplete: {lost}; {recorded['error'] or 'the recorder was too slow'}")
    if (passed := metrics.get("passed")) is not None:
        print(f"  {'passed':<22} {'yes' if passed else 'no'}")


_FIGURES = (
    ("tracked after", "tracked_s", "s", 1.0),
    ("within 10 mm after", "t10_s", "s", 1.0),
    ("steady error rms", "steady_rms_m", "mm", 1e3),
    ("steady error max", "steady_max_m", "mm", 1e3),
    ("ticks", "ticks", "", 1),
    ("deadline misses", "deadline_misses", "", 1),
    ("times real time", "realtime_factor", "", 1.0),
)


def listing(what: str) -> tuple[tuple[str, ...], Sequence[tuple[str, ...]]]:
    """Return the column names and the rows of ``hil list``. Raises BadInputError for a list that there is not."""
    if what == "signals":
        from hil.signals import SIGNALS

        return SIGNALS[0]._fields, [(s.name, s.unit, s.meaning) for s in SIGNALS]
    if what == "laws":
        from hil.controllers.registry import laws

        return ("law", "meaning"), list(laws().items())
    if what == "scenarios":
        from hil.scenario import shipped

        return ("scenario", "meaning"), list(shipped().items())
    if what == "links":
        from hil.links.url import LINK_FORMS

        return ("link", "meaning"), list(LINK_FORMS.items())
    raise BadInputError(f"there is no list of {what!r}{nearest(what, ('signals', 'laws', 'scenarios', 'links'))}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns; the last column is not padded. Nothing is cut, so that names can be copied."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        print("  ".join([*padded, row[-1]]).rstrip())


def print_fmu(info: "FmuInfo") -> None:
    """Print an FMU's description and its variables."""
    print(f"{info.path}{' (shipped)' if info.shipped else ''}")
    print(f"{info.model_name}: {info.description or 'no description'}")
    kinds = {"co-simulation": info.co_simulation, "model exchange": info.model_exchange}
    print(f"FMI {info.fmi_version}, {' and '.join(kind for kind, name in kinds.items() if name)}")
    print(f"platforms: {', '.join(info.platforms) or 'none'}")
    print(f"capabilities: {', '.join(info.capabilities) or 'none'}")
    print(f"sha256: {info.sha256}")
    print()
    rows = [("name", "causality", "type", "unit", "start", "description")]
    rows += [(v.name, v.causality, v.type, v.unit or "", v.start or "", v.description or "") for v in info.variables]
    print_table(rows)
