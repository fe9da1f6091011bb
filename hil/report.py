"""What the commands print for a person."""

import math
import shutil
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.errors import BadInputError, nearest
from hil.plant.words import one_line
from hil.results import RunResult, applied_words

if TYPE_CHECKING:
    from hil.assembly import Watch
    from hil.catalogue.runs import Verdict
    from hil.comparison import Comparison
    from hil.loop import Loop
    from hil.plant.info import FmuInfo, VariableInfo
    from hil.plant.tools import CheckResult
    from hil.references import Feasibility

_REFRESH_S = 0.1


def recording_path(name: str, asked: str | None) -> Path | None:
    """Return where to record: ``none`` for nowhere, by default a new file in ``runs/``, which is made."""
    if asked == "none":
        return None
    if asked is not None:
        return Path(asked)
    return _runs_folder("name a file with --record, or --record none") / f"{_stamped(name)}.rrd"


def catalogue_folder() -> Path:
    """Return a new folder's path in ``runs/``, for the recordings of the runs that are not as they should be."""
    return _runs_folder("go where you may write") / _stamped("catalogue")


def _runs_folder(remedy: str) -> Path:
    folder = Path("runs")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"recording folder {folder.absolute()}: it cannot be made ({error.strerror}); {remedy}"
        ) from error
    return folder


def _stamped(name: str) -> str:
    return f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}"  # noqa: DTZ005 - the user's own time


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
    """Say on stderr what a user should know before a run."""
    print(f"hil: warning: {sentence}", file=sys.stderr)


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
    if (link := metrics.get("link_statistics")) is not None:
        _print_link(link)
    for sentence in (metrics.get("reference") or {}).get("warnings", ()):
        print(f"  {'warning':<22} {sentence}")
    for row in metrics.get("fault") or ():
        print(f"  {'fault':<22} {applied_words(row)}")
    for row in metrics.get("shadows") or ():
        if row["dropped"] is not None:
            print(f"  {'shadow':<22} {row['dropped']}")
    for row in metrics.get("recoveries") or ():
        print(f"  {'recovery':<22} lost at {row['lost_s']:.3f} s, ACTIVE again at {row['armed_s']:.3f} s: {row['why']}")
    for row in metrics.get("expect") or ():
        print(f"  {'expect':<22} {row['text']}")
    recorded = metrics.get("recorded")
    if recorded is not None and (text := _what_became_of(recorded, metrics["recording"])):
        print(f"  {'recording':<22} {text}")
    if (trace := metrics.get("trace")) is not None:
        written = f"{trace['frames']} frames in {trace['path']}"
        print(f"  {'trace':<22} {trace['trouble'] or written}")
    if (stream := metrics.get("streamed")) is not None:
        print(f"  {'stream':<22} {_streamed(stream)}")
    if (passed := metrics.get("passed")) is not None:
        print(f"  {'passed':<22} {'yes' if passed else 'no'}")


def _what_became_of(recorded: Mapping[str, Any], path: str | None) -> str:
    """Return what a recording lacks, why, and where the rest is; empty when all of it is in one file."""
    parts = f" in {len(recorded['parts'])} parts" if len(recorded["parts"]) > 1 else ""
    if recorded["error"] or recorded["dropped"] or recorded["lost"] or recorded["events_lost"]:
        why = recorded["error"] or "the recorder was too slow"
        events = f", {recorded['events_lost']} events lost" if recorded["events_lost"] else ""
        rest = "" if path is None else f", {recorded['rows']} are safe in {path}{parts}"
        counts = f"{recorded['dropped']} rows were dropped and {recorded['lost']} lost{events}"
        return f"incomplete: {why}; {counts}{rest}"
    if recorded["troubles"]:
        return f"complete{parts}, though {'; '.join(recorded['troubles'])}"
    return f"complete{parts}" if parts else ""


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


def _print_link(link: Mapping[str, Any]) -> None:
    """Print what became of the link, as far as there is something to say."""
    ways = [way for way in ("sent", "received", "foreign") if link[way] is not None and link[way]["frames"]]
    rows = [("on the wire", ", ".join(_traffic(link, way) for way in ways) or "nothing")]
    for way, load in (link["load"] or {}).items():
        if load["mean_percent"] is not None:
            worst = load["worst_100_ms_percent"]
            rows.append((f"load, {way}", f"{load['mean_percent']:.1f} %, in the worst 100 ms {worst:.1f} %"))
    lost = {name.replace("_", " "): count for name, count in link["lost"].items() if count}
    if lost:
        rows.append(("lost", ", ".join(f"{name} {count}" for name, count in lost.items())))
    for label, name in (("feedback age p50, p99", "feedback_age_ms"), ("round trip p50, p99", "round_trip_ms")):
        if (figure := link[name]) is not None:
            rows.append((label, f"{figure['p50']:.3g}, {figure['p99']:.3g} ms"))
    if (clock := link["clock"]) is not None:
        drift_ppm = clock["drift_ppm"]  # NaN, or null in a recording, while the run is too short for it
        drift = "" if drift_ppm is None or math.isnan(drift_ppm) else f", drift {drift_ppm:+.1f} ppm"
        rows.append(("robot's clock", f"{clock['offset_us'] * 1e-3:+.3f} ms{drift}"))
        way = clock["round_trip_us"]
        rows.append(("TIME_SYNC p50, p99", f"{way['p50']:.0f}, {way['p99']:.0f} µs"))
    for label, text in rows:
        print(f"  {label:<22} {text}")


def _traffic(link: Mapping[str, Any], way: str) -> str:
    return f"{way} {link[way]['frames']} frames, {link[way]['bytes'] * 1e-3:.1f} kB"


_FIGURES = (
    ("tracked after", "tracked_s", "s", 1.0),
    ("within 10 mm after", "t10_s", "s", 1.0),
    ("steady error rms", "steady_rms_m", "mm", 1e3),
    ("steady error max", "steady_max_m", "mm", 1e3),
    ("overshoot", "overshoot_m", "mm", 1e3),
    ("effort", "effort_n_m_s", "N·m·s", 1.0),
    ("torque variation", "torque_variation_n_m_per_s", "N·m/s a wheel", 1.0),
    ("saturated for", "saturation_s", "s", 1.0),
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

        return ("law", "package", "meaning"), laws()
    if what == "references":
        from hil.references import kinds

        return ("reference", "meaning"), list(kinds().items())
    if what == "scenarios":
        from hil.scenario import shipped

        return ("scenario", "meaning"), list(shipped().items())
    if what == "links":
        from hil.links.url import LINK_FORMS

        return ("link", "meaning"), list(LINK_FORMS.items())
    if what == "faults":
        from hil.faults.kinds import KINDS

        rows = [(k.name, k.acts_on, k.target_words.replace("`", ""), k.unit, k.meaning) for k in KINDS]
        return ("kind", "acts on", "target", "value", "meaning"), rows
    known = ("signals", "laws", "references", "scenarios", "links", "faults")
    raise BadInputError(f"there is no list of {what!r}{nearest(what, known)}")


def print_demands(demands: "Feasibility") -> None:
    """Print what a reference asks of the wheels, and what of it they cannot."""
    for label, demand in (("wheel speed", demands.speed), ("wheel torque", demands.torque)):
        most = f"at most {demand.worst:.3g} {demand.unit}, of wheel {demand.worst_wheel} at t = {demand.worst_s:.3g} s"
        print(f"  {label:<22} {most}; the limit is {demand.limit:g} {demand.unit}")
    for sentence in demands.sentences:
        print(f"  {'not feasible':<22} {sentence}")


def print_table(rows: Sequence[Sequence[str]]) -> None:
    """Print rows in columns; the last column is not padded. Nothing is cut, so that names can be copied."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
    for row in rows:
        padded = [text.ljust(width) for text, width in zip(row, widths, strict=False)]
        print("  ".join([*padded, row[-1]]).rstrip())


def print_catalogue(verdicts: Sequence["Verdict"]) -> None:
    """Print a row for each run of the catalogue, and how many were as they should be."""
    head = ("fault", "link", "re-arm", "outcome", "applied", "recoveries", "after silence", "wall s", "verdict")
    print_table([head, *(_catalogue_row(verdict) for verdict in verdicts)])
    failed = [verdict for verdict in verdicts if not verdict.is_ok]
    wall_s = sum(verdict.wall_s for verdict in verdicts)
    print(f"\n{len(verdicts) - len(failed)} of {len(verdicts)} runs are as they should be, {wall_s:.0f} s of runs")
    for verdict in failed:
        where = "" if verdict.recording is None else f" (hil view {verdict.recording})"
        print(f"  {verdict.fault} over {verdict.link}: {verdict.verdict}{where}")


def _catalogue_row(verdict: "Verdict") -> tuple[str, ...]:
    realtime = ", real time" if verdict.mode == "realtime" else ""
    silence = "-" if verdict.silent_rad_s is None else f"{verdict.silent_rad_s:g} rad/s"
    return (
        verdict.fault,
        verdict.link + realtime,
        "yes" if verdict.rearm else "no",
        verdict.outcome or "-",
        "-" if verdict.applied is None else " ".join(map(str, verdict.applied)),
        "-" if verdict.recoveries is None else str(verdict.recoveries),
        silence,
        f"{verdict.wall_s:.1f}",
        "ok" if verdict.is_ok else verdict.verdict.partition(":")[0],
    )


def print_comparison(comparison: "Comparison") -> None:
    """Print a table for each condition, and below it why figures are missing."""
    from hil.comparison.tables import terminal

    for number, (title, rows, notes) in enumerate(terminal(comparison)):
        print(title if number == 0 else f"\n{title}")
        print_table(rows)
        for note in notes:
            print(f"  {note}")
    if len(comparison.rows[0].runs) > 1:
        print("\nnominal / worst over mass and friction of the plant; less is better in every column")


def print_reproduction(summary: Mapping[str, Any]) -> None:
    """Print the tables of a reproduction, then what comes out of the paper and what does not."""
    from hil.reproduction import tables

    print("Assumed, for the paper does not say\n")
    for place, what, ours, why in tables.assumptions(summary)[1:]:
        print(f"  {place}, {what}: {ours}\n    {why}")
    for title, table in (
        ("Section IV.A, the circle", tables.circle(summary)),
        ("Section IV.B, the experiment: oscillation over latency", tables.delay(summary)),
        ("Section IV.B, the experiment: the transition", tables.transition(summary)),
    ):
        if len(table) > 1:
            print(f"\n{title}\n")
            print_table(table)
    print("\nWhat comes out\n")
    for place, claim, paper, ours, tolerance, verdict, why in tables.verdicts(summary)[1:]:
        within = "" if tolerance == "-" else f", within {tolerance}"
        print(f"  {verdict}: {claim} ({place}): the paper {paper}, ours {ours}{within}")
        print(f"    {why}")
    files = ", ".join([*summary["pictures"], *summary["recordings"]])
    print(f"\n{summary['wall_s']:.0f} s; in {summary['folder']}: {files}")


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
    """Print the parts of a check as a table, then what is wrong."""
    rows = []
    for part in result.parts:
        outcome = "fail" if part.problems else "skip" if part.skipped else "pass"
        rows.append((part.name, outcome, part.skipped or ""))
    _print_rich_table(("part", "outcome", "reason"), rows)
    for problem in result.problems:
        print(one_line(problem))
    count = len(result.problems)
    print(f"{fmu}: {count or 'no'} problem{'' if count == 1 else 's'}")


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
