"""The ``hil`` command. Each command parses, calls one function and prints; what it does is elsewhere.

Exit codes: 0 the run ended as expected, 1 an expectation failed, 2 bad input, 3 a failed link or device, or a law that
does not return, 130 interrupted.
"""

import errno
import gc
import sys
from pathlib import Path
from typing import Annotated

import typer

from hil.cli import live as live_view
from hil.cli.campaign import app as campaign_app
from hil.cli.catalogue import catalogue
from hil.cli.check import check
from hil.cli.compare import compare
from hil.cli.ctl import app as ctl_app
from hil.cli.doctor import doctor
from hil.cli.fmu import app as fmu_app
from hil.cli.fuzzy import fuzzy
from hil.cli.group import Commands
from hil.cli.init import init
from hil.cli.motors import jog, probe
from hil.cli.options import (
    AllowMotion,
    Force,
    Json,
    LinkUrl,
    LivePort,
    Mode,
    RobotFile,
    ScenarioName,
    Seed,
    Sets,
    TraceFile,
    TruthUrl,
    drop_output,
    end_in_order,
    print_json,
)
from hil.cli.replay import replay
from hil.cli.reproduce import reproduce
from hil.cli.review import review
from hil.cli.robot import device, params
from hil.cli.serve import serve
from hil.cli.teleop import teleop
from hil.cli.trace import decode
from hil.core.errors import BadInputError, DeviceError, HilError, LinkError, RunInterruptedError

app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # to lay the help out in boxes takes longer to import than all else together
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Test a Mecanum robot's controller against a plant FMU before the wheels touch the ground.",
)
app.add_typer(campaign_app, name="campaign")
app.add_typer(fmu_app, name="fmu")
app.add_typer(ctl_app, name="ctl")


@app.command()
def run(
    context: typer.Context,
    scenario: ScenarioName,
    mode: Mode = None,
    link: LinkUrl = None,
    truth: TruthUrl = None,
    robot: RobotFile = None,
    record: Annotated[
        str | None,
        typer.Option(metavar="FILE|none", help="recording (.rrd, .mcap); by default runs/SCENARIO-TIME.rrd"),
    ] = None,
    rotate: Annotated[
        str | None, typer.Option(metavar="SIZE|TIME", help="record on in another file, as in 1GB, 10min or '1GB|10min'")
    ] = None,
    trace: TraceFile = None,
    live: Annotated[bool, typer.Option("--live", help="serve live viewers on 127.0.0.1 while it runs")] = False,
    live_port: LivePort = live_view.LIVE_PORT,
    stream: Annotated[
        str | None,
        typer.Option(
            metavar="udp://127.0.0.1:PORT",
            help="send JSON at 100 Hz, for PlotJuggler's UDP server; stays on this machine unless another's address "
            "is given",
        ),
    ] = None,
    seed: Seed = None,
    sets: Sets = None,
    force: Force = False,
    allow_motion: AllowMotion = False,
    as_json: Json = False,
) -> None:
    """Run a scenario and judge it."""
    from hil.record import Rotation, early_recorder, rotation

    end_in_order()
    suffix = ".rrd" if record is None else None if record == "none" else Path(record).suffix
    # First, for what it imports takes it as long as the rest takes us.
    make_recording = context.with_resource(early_recorder(suffix, live=live))

    from hil.cli import report
    from hil.core.outputs import existing_files
    from hil.runtime.assembly import run_scenario
    from hil.scenario import load

    resolved = load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
    parts = rotation(rotate) if rotate is not None else Rotation()
    path = report.recording_path(resolved.name, record)
    watch = None if as_json or not sys.stderr.isatty() else report.progress(resolved.loop.duration_s)
    linger = None
    if live:
        report.announce_live(live_port)
        linger = report.linger if sys.stderr.isatty() and not as_json else None
    try:
        result = run_scenario(
            resolved,
            truth=truth,
            record=path,
            rotate=parts,
            trace=trace,
            existing="number" if record is None and not force else existing_files(force=force),
            live_port=live_port if live else None,
            stream=stream,
            allow_motion=allow_motion,
            watch=watch,
            warn=report.warn,
            linger=linger,
            on_stuck=_print_stuck if as_json else None,
            make_recording=make_recording,
            keep_signals=False,
        )
    except KeyboardInterrupt:
        kept = f"; recorded until then: {path}" if path is not None and path.exists() else ""
        raise RunInterruptedError(f"interrupted; the robot was told to stop{kept}") from None
    except (LinkError, DeviceError) as error:
        if as_json:
            print_json({"passed": False, "failure": str(error)})
        raise
    if as_json:
        print_json(result.metrics)
    else:
        report.print_result(result)
    if result.failure is not None:
        print(f"hil: {result.failure}", file=sys.stderr)
    raise typer.Exit(result.exit_code)


def _print_stuck(sentence: str) -> None:
    """Print what ``--json`` gives of a run that a stuck law ends with the process."""
    print_json({"passed": False, "failure": sentence})
    _bring_out()


app.command()(catalogue)
app.command()(check)
app.command()(compare)
app.command()(device)
app.command()(decode)
app.command()(doctor)
app.command()(params)
app.command()(fuzzy)
app.command()(init)
app.command()(jog)
app.command()(live_view.live)
app.command()(probe)
app.command()(replay)
app.command()(reproduce)
app.command()(review)
app.command()(serve)
app.command()(teleop)


@app.command()
def show(
    scenario: ScenarioName,
    robot: RobotFile = None,
    mode: Mode = None,
    link: LinkUrl = None,
    seed: Seed = None,
    sets: Sets = None,
    as_json: Json = False,
) -> None:
    """Print every value of a scenario and where it came from."""
    from hil.cli import report
    from hil.scenario import format_value, load, resolved

    rows = resolved(load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed))
    if as_json:
        print_json({key: {"value": value, "from": where} for key, value, where in rows})
        return
    report.print_table([(key, format_value(value), where) for key, value, where in rows])


@app.command("list")
def list_(
    what: Annotated[str, typer.Argument(metavar="signals|laws|references|scenarios|links|faults|drivers")],
    as_json: Json = False,
) -> None:
    """Print the vocabulary of signals, the laws, references, scenarios, forms of links, kinds of faults or drivers."""
    from hil.cli import report

    header, rows = report.listing(what)
    if as_json:
        print_json([dict(zip(header, row, strict=True)) for row in rows])
    else:
        report.print_table([header, *rows])


@app.command()
def view(
    recording: Annotated[Path, typer.Argument(metavar="RUN.rrd")],
    web: Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")] = False,
) -> None:
    """Open a recording in the rerun viewer."""
    from hil.record.view import view as open_viewer

    open_viewer(recording, web=web)


def _bring_out() -> None:
    """Write what is still in the buffer of stdout; its reader may have left, as head does."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        drop_output()


_GC_THRESHOLD = 100_000
"""New objects before the garbage collector looks: with Python's own 700 it goes through all modules while they load."""


def main() -> None:
    """Entry point: an error that a user is meant to read is one sentence on stderr, and its exit code."""
    gc.set_threshold(_GC_THRESHOLD)
    try:
        try:
            app(prog_name="hil", standalone_mode=True)
        finally:
            _bring_out()
            gc.freeze()  # else the interpreter's end goes through all modules once more: 0.08 s after a run
    except HilError as error:
        print(f"hil: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        drop_output()
        print("hil: there is no space left where the output goes; free some, or write it elsewhere", file=sys.stderr)
        sys.exit(BadInputError.exit_code)


if __name__ == "__main__":
    main()
