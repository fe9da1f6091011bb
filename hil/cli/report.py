"""What the commands print for a person."""

import contextlib
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.core.errors import BadInputError, nearest
from hil.judge.results import RunResult
from hil.judge.words import belief_rows, figure_rows, link_rows, outcome_rows, recorded_at
from hil.plant.words import one_line
from hil.record.runs_folder import new_in_runs

if TYPE_CHECKING:
    from hil.cli.checks import Finding
    from hil.plant.info import FmuInfo, VariableInfo
    from hil.plant.tools import CheckResult
    from hil.references import Feasibility
    from hil.runtime.assembly import Watch
    from hil.runtime.loop import Loop

_REFRESH_S = 0.1


def recording_path(name: str, asked: str | None) -> Path | None:
    """Return where to record: ``none`` for nowhere, by default a new file in ``runs/``, which is made."""
    if asked == "none":
        return None
    if asked is not None:
        return Path(asked)
    return new_in_runs(name, ".rrd", "name a file with --record, or --record none")


def catalogue_folder() -> Path:
    """Return a new folder's path in ``runs/``, for the recordings of the runs that are not as they should be."""
    return new_in_runs("catalogue", "", "go where you may write")


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


def warn(sentence: str) -> None:
    """Say on stderr what a user should know before a run, or when its robot has come back."""
    # Whoever read them may be gone, which is no reason to end a run; the recording has the sentence too.
    with contextlib.suppress(OSError):
        print(f"hil: warning: {sentence}", file=sys.stderr)


def announce_live(port: int) -> None:
    """Say on stderr how a viewer reaches the run, and open one when a person watches and there is a display."""
    from hil.record.view import live_hint, show_live

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
    """Return how this user reaches the command: by name, or by the path of a virtual environment not activated."""
    called = Path(sys.argv[0])
    return "hil" if shutil.which("hil") or called.name != "hil" else str(called)


def print_figures(metrics: Mapping[str, Any]) -> None:
    """Print the figures of a run, with the reason where there is none, its expectations, and whether it passed."""
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
    """Return what became of a stream."""
    if stream["sent"] is None:
        return f"to {stream['url']} incomplete: {stream['error']}"
    text = f"{stream['sent']} datagrams to {stream['url']}"
    if stream["lost"]:
        text += f", {stream['lost']} lost: {stream['error']}"
    if stream["rows_dropped"]:
        text += f", {stream['rows_dropped']} rows dropped: the sender was too slow"
    return text


def print_rows(rows: Iterable[tuple[str, str]]) -> None:
    """Print what is said of a run: a label and a text a line."""
    for label, text in rows:
        print(f"  {label:<22} {text}".rstrip())


def listing(what: str) -> tuple[tuple[str, ...], Sequence[tuple[str, ...]]]:
    """Return the column names and the rows of ``hil list``. Raises BadInputError for a list that there is not."""
    if what == "signals":
        from hil.core.signals import SIGNALS

        return SIGNALS[0]._fields, [(s.name, s.unit, s.meaning) for s in SIGNALS]
    if what == "laws":
        from hil.laws.registry import laws

        return ("law", "package", "meaning"), laws()
    if what == "references":
        from hil.references import kinds

        return ("reference", "meaning"), list(kinds().items())
    if what == "scenarios":
        from hil.scenario import shipped

        return ("scenario", "meaning"), list(shipped().items())
    if what == "links":
        from hil.wire.url import LINK_FORMS

        return ("link", "meaning"), list(LINK_FORMS.items())
    if what == "faults":
        from hil.faults.kinds import kinds as fault_kinds

        rows = [(k.name, k.acts_on, k.target_words.replace("`", ""), k.unit, k.meaning) for k in fault_kinds()]
        return ("kind", "acts on", "target", "value", "meaning"), rows
    if what == "drivers":
        from hil.scenario.drivers import COLUMNS, driver_rows

        return COLUMNS, driver_rows()
    known = ("signals", "laws", "references", "scenarios", "links", "faults", "drivers")
    raise BadInputError(f"there is no list of {what!r}{nearest(what, known)}")


def print_demands(demands: "Feasibility") -> None:
    """Print what a reference asks of the wheels, and what of it they cannot."""
    for label, demand in (("wheel speed", demands.speed), ("wheel torque", demands.torque)):
        most = f"at most {demand.worst:.3g} {demand.unit}, of wheel {demand.worst_wheel} at t = {demand.worst_s:.3g} s"
        print(f"  {label:<22} {most}; the limit is {demand.limit:g} {demand.unit}")
    for sentence in demands.sentences:
        print(f"  {'not feasible':<22} {sentence}")
    for sentence in demands.notes:
        print(f"  {'note':<22} {sentence}")


def print_findings(findings: Sequence["Finding"]) -> None:
    """Print what was found of this machine, the verdict first, and below it what to do."""
    for verdict, subject, sentence, remedy in findings:
        print(f"{verdict:<8} {subject:<15} {sentence}")
        if remedy:
            print(f"{'':<24} -> {remedy}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns; the last column is not padded. Nothing is cut, so that names can be copied."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        print("  ".join([*padded, row[-1]]).rstrip())


def print_fmu(info: "FmuInfo") -> None:
    """Print an FMU's description, and its variables as a table."""
    print(f"{info.path}{f' (shipped as {info.shipped})' if info.shipped else ''}")
    facts = [("model", info.model_name), *info.about.items(), ("FMI version", info.fmi_version)]
    for interface, identifier in info.interfaces.items():
        claims = ", ".join(info.capabilities[interface]) or "no optional capabilities"
        facts.append((interface, f"{identifier}: {claims}"))
    experiment = ", ".join(f"{name} {value}" for name, value in info.experiment.items())
    facts += [("platforms", ", ".join(info.platforms) or "none"), ("default experiment", experiment or "none")]
    facts.append(("sha256", info.sha256))
    print_table([(f"  {name}", one_line(value)) for name, value in facts])
    print()
    header = ("name", "causality", "variability", "type", "unit", "start", "range", "description")
    rows = [
        (v.name, v.causality, v.variability, _type(v), v.unit or "", v.start or "", _range(v), v.description or "")
        for v in info.variables
    ]
    _print_rich_table(header, rows)


def print_check(fmu: Path, result: "CheckResult") -> None:
    """Print the parts of a check as a table, then what was found, violations of the standard first."""
    from hil.plant.conformance.findings import Kind

    rows = []
    for part in result.parts:
        kinds = {finding.kind for finding in part.findings}
        found = next((kind for kind in Kind if kind in kinds), None)
        outcome = "fail" if found == Kind.VIOLATION else found or ("skip" if part.skipped else "pass")
        rows.append((part.name, outcome, part.skipped or ""))
    _print_rich_table(("part", "outcome", "reason"), rows)
    for kind in Kind:
        for finding in result.told(kind):
            print(one_line(f"{kind}: {finding}"))
    counts = {kind: len(result.told(kind)) for kind in Kind}
    violations = counts[Kind.VIOLATION]
    words = [f"{violations or 'no'} violation{'' if violations == 1 else 's'} of the standard"]
    if count := counts[Kind.ADVICE]:
        words.append(f"{count} piece{'' if count == 1 else 's'} of advice")
    if count := counts[Kind.NEED]:
        words.append(f"{count} thing{'' if count == 1 else 's'} that this importer needs otherwise")
    print(f"{fmu}: {', '.join(words)}")


def _print_rich_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table; names are never cut, and where no terminal is, nothing is folded, so that it can be searched."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="bold")
    for place, name in enumerate(header):
        table.add_column(name, no_wrap=place == 0, overflow="fold")
    for row in rows:
        table.add_row(*(Text(one_line(cell)) for cell in row))
    console = Console()
    if not console.is_terminal:
        console = Console(
            width=max(80, 4 * len(header) + sum(max(map(len, column)) for column in zip(header, *rows, strict=True)))
        )
    console.print(table)


def _type(variable: "VariableInfo") -> str:
    size = ", ".join(map(str, variable.dimensions))
    return f"{variable.type}[{size}]" if size else variable.type


def _range(variable: "VariableInfo") -> str:
    if variable.items:
        return " | ".join(f"{value} {name}" for name, value in variable.items)
    low, high = variable.min, variable.max
    if low is None and high is None:
        return ""
    if high is None:
        return f"from {low}"
    return f"up to {high}" if low is None else f"{low} to {high}"
