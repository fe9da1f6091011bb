"""``hil run``."""

import contextlib
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from hil.cli import options as o
from hil.cli.output import end_in_order, flush_output, next_command, print_json, print_result, slowly, warn
from hil.core.errors import DeviceError, LinkError, RunInterruptedError

if TYPE_CHECKING:
    from hil.judge.result import RunResult
    from hil.runtime.loop import Loop
    from hil.runtime.run_options import Watch

_REFRESH_HZ = 10


def run(
    context: typer.Context,
    scenario: o.ScenarioName,
    mode: o.Mode = None,
    link: o.LinkUrl = None,
    truth: o.TruthUrl = None,
    robot: o.RobotFile = None,
    record: Annotated[
        str | None, Option(metavar="FILE|none", help="recording (.rrd, .mcap); by default runs/SCENARIO-TIME.rrd")
    ] = None,
    rotate: Annotated[
        str, Option(metavar="SIZE|TIME|none", help="begin a new file after this size or time: 1GB or 10min")
    ] = "none",
    trace: o.TraceFile = None,
    live: Annotated[bool, Option("--live", help="serve live viewers on 127.0.0.1 while it runs")] = False,
    live_port: o.LivePort = o.LIVE_PORT,
    seed: o.Seed = None,
    sets: o.Sets = None,
    force: o.Force = False,
    allow_motion: o.AllowMotion = False,
    lenient: Annotated[bool, Option("--lenient", help="judge by [[expect]] alone, for exploring")] = False,
    as_json: o.Json = False,
) -> None:
    """Run a scenario and judge it."""
    end_in_order()
    suffix = ".rrd" if record is None else None if record == "none" else Path(record).suffix
    # First, because the recorder process takes as long to import its modules as this one.
    make_recording = None
    if live or suffix is not None:
        from hil.record.recording import early_recorder

        make_recording = context.with_resource(early_recorder(suffix, live=live))

    from hil.core.outputs import existing_files
    from hil.record.files import new_in_runs, rotation
    from hil.runtime.assembly import RunOptions, run_scenario

    resolved = o.load_scenario(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
    parts = rotation(rotate)
    if record is None:
        path: Path | None = new_in_runs(resolved.name, ".rrd", "name a file with --record, or --record none")
    else:
        path = None if record == "none" else Path(record)
    is_watched = sys.stderr.isatty() and not as_json
    ending = context.with_resource(contextlib.ExitStack())
    if live:
        _announce_live(live_port)
    try:
        result = run_scenario(
            resolved,
            RunOptions(
                truth=truth,
                record=path,
                rotate=parts,
                trace=trace,
                existing="number" if record is None and not force else existing_files(force=force),
                live_port=live_port if live else None,
                allow_motion=allow_motion,
                lenient=lenient,
                watch=_progress(resolved.loop.duration_s, None if live else ending) if is_watched else None,
                warn=warn,
                linger=_linger if live and is_watched else None,
                on_stuck=_print_failure if as_json else None,
                make_recording=make_recording,
                keep_signals=False,
            ),
        )
        ending.close()
    except KeyboardInterrupt:
        ending.close()
        kept = f"; recorded until then: {path}" if path is not None and path.exists() else ""
        raise RunInterruptedError(f"interrupted; the robot was told to stop{kept}") from None
    except (LinkError, DeviceError) as error:
        if as_json:
            _print_failure(str(error))
        raise
    print_result(as_json, result.metrics, _lines(result))
    if result.failure is not None:
        print(f"hil: {result.failure}", file=sys.stderr)
    raise typer.Exit(result.exit_code)


def _print_failure(sentence: str) -> None:
    from hil.judge.run_json import SCHEMA

    print_json({"schema": SCHEMA, "passed": False, "failure": sentence})
    flush_output()  # a law that is stuck ends this process


def _progress(duration_s: float, ending: contextlib.ExitStack | None) -> "Watch":
    """Return a context manager that shows a progress bar on stderr during a run, and then, in ``ending``, its end."""
    from rich.console import Console
    from rich.live import Live
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from hil.core.printable import raw_stream

    @contextlib.contextmanager
    def watch(loop: "Loop") -> Iterator[None]:
        text = TextColumn("{task.completed:6.2f} s of {task.total:g} s")
        bar = Progress(text, BarColumn(), TimeRemainingColumn(), auto_refresh=False)
        task = bar.add_task("run", total=duration_s)

        def updated() -> Progress:
            bar.update(task, completed=loop.t_s)
            return bar

        console = Console(file=raw_stream(sys.stderr))
        with Live(get_renderable=updated, console=console, transient=True, refresh_per_second=_REFRESH_HZ):
            yield
        if ending is not None:
            ending.enter_context(slowly("judging the run and finishing its recording"))

    return watch


def _announce_live(port: int) -> None:
    """Print on stderr how to open a viewer; open one if stderr is a terminal and there is a display."""
    from hil.record.viewing import live_hint, part

    print(live_hint(port), file=sys.stderr)
    if sys.stderr.isatty() and (show := part("window")) is not None:
        show(port)


def _linger() -> None:
    """Wait for Ctrl-C, because a run in lockstep is over before a viewer has opened."""
    print("done; live viewers are served until Ctrl-C", file=sys.stderr)
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait()


def _lines(result: "RunResult") -> Iterator[str]:
    """Yield how a run went, and the next commands to use."""
    from hil.core.extensions import addon_commands

    yield from result.lines()
    run = result.run
    scenario = str(run.identity.scenario) if result.scenario is None else result.scenario.path or result.scenario.name
    hints = [next_command("hil", "show", scenario)]
    path = None if run.recorded is None else run.recorded.first_file(run.recording)
    if path is not None:
        commands = ["review", *(["view"] if path.endswith(".rrd") else [])]
        for name in filter(addon_commands().__contains__, commands):
            hints.insert(0, next_command("hil", name, Path(path)))
    yield from ("", "Next:", *(f"  {hint}" for hint in hints))
