"""The ``hil`` command. Each command parses, calls one function and prints; what it does is elsewhere.

Exit codes: 0 the run ended as expected, 1 an expectation failed, 2 bad input, 3 a failed link or device, 130
interrupted.
"""

import contextlib
import json
import math
import os
import signal
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

from hil.errors import BadInputError, DeviceError, HilError, LinkError, RunInterruptedError

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Test a Mecanum robot's controller against a plant FMU before the wheels touch the ground.",
)
fmu_app = typer.Typer(no_args_is_help=True, help="The plant: build, look at and check FMUs.")
app.add_typer(fmu_app, name="fmu")

ScenarioName = Annotated[str, typer.Argument(metavar="SCENARIO", help="a shipped name or a path to a .toml file")]
Sets = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="override any key, for example robot.mass_kg=24"),
]
RobotFile = Annotated[Path | None, typer.Option("--robot", metavar="FILE", help="merge a robot's own file")]
Mode = Annotated[str | None, typer.Option(metavar="lockstep|realtime", help="whose time passes")]
LinkUrl = Annotated[
    str | None,
    typer.Option("--link", metavar="LINK", help="memory:, serial:PATH, serial:pty or can:INTERFACE/CHANNEL"),
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="of everything random in the run")]
TraceFile = Annotated[
    Path | None, typer.Option("--trace", metavar="FILE.blf|.asc|.log", help="write what is on the wire, for bus tools")
]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]


@app.command()
def run(
    scenario: ScenarioName,
    mode: Mode = None,
    link: LinkUrl = None,
    truth: Annotated[
        str | None, typer.Option(metavar="URL", help="truth socket of hil device, tcp://127.0.0.1:PORT")
    ] = None,
    robot: RobotFile = None,
    record: Annotated[
        str | None, typer.Option(metavar="FILE|none", help="recording; by default runs/SCENARIO-TIME.rrd")
    ] = None,
    trace: TraceFile = None,
    live: Annotated[bool, typer.Option("--live", help="serve the rerun viewer on 127.0.0.1 while it runs")] = False,
    live_port: Annotated[int, typer.Option(metavar="PORT", help="for --live", min=1, max=65535)] = 9876,
    seed: Seed = None,
    sets: Sets = None,
    allow_motion: Annotated[bool, typer.Option("--allow-motion", help="real motors may move")] = False,
    as_json: Json = False,
) -> None:
    """Run a scenario and judge it."""
    from hil import report
    from hil.assembly import run_scenario
    from hil.scenario import load

    signal.signal(signal.SIGTERM, _interrupt)
    resolved = load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
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
            trace=trace,
            live_port=live_port if live else None,
            allow_motion=allow_motion,
            watch=watch,
            linger=linger,
        )
    except KeyboardInterrupt:
        kept = f"; recorded until then: {path}" if path is not None and path.exists() else ""
        raise RunInterruptedError(f"interrupted; the robot was told to stop{kept}") from None
    except (LinkError, DeviceError) as error:
        if as_json:
            _print_json({"passed": False, "failure": str(error)})
        raise
    if as_json:
        _print_json(result.metrics)
    else:
        report.print_result(result)
    if result.failure is not None:
        print(f"hil: {result.failure}", file=sys.stderr)
    raise typer.Exit(result.exit_code)


@app.command()
def catalogue(
    scenario: Annotated[
        str, typer.Argument(metavar="[SCENARIO]", help="what the faults are put into, 1.3 s of it")
    ] = "circle_speed",
    law: Annotated[
        str | None, typer.Option(metavar="LAW", help="the law to test instead, without the scenario's gains")
    ] = None,
    link: Annotated[
        list[str] | None, typer.Option("--link", metavar="memory|serial|can", help="by default each; may be repeated")
    ] = None,
    kind: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="only faults of this kind; may be repeated")
    ] = None,
    pairs: Annotated[bool, typer.Option("--pairs", help="all pairs too, over memory unless --link says more")] = False,
    realtime: Annotated[bool, typer.Option("--realtime", help="a part of them in real time too")] = False,
    sets: Sets = None,
    jobs: Annotated[int | None, typer.Option(metavar="N", help="processes; by default one a processor", min=1)] = None,
    limit_s: Annotated[
        float, typer.Option("--limit", metavar="S", help="a run that takes longer is ended as hung", min=1.0)
    ] = 60.0,
    as_json: Json = False,
) -> None:
    """Run the fault catalogue and judge every run for safety; exit 1 when one is not as it should be."""
    from hil import report
    from hil.catalogue import catalogue as run_catalogue
    from hil.catalogue.plan import Asked

    signal.signal(signal.SIGTERM, _interrupt)
    laws = [] if law is None else [f"controller.law={law}"]
    asked = Asked(scenario, [*laws, *(sets or [])], link or [], kind or [], report.catalogue_folder())
    tell = None if as_json or not sys.stderr.isatty() else report.catalogue_progress
    try:
        verdicts = run_catalogue(asked, pairs=pairs, realtime=realtime, jobs=jobs, limit_s=limit_s, tell=tell)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the runs were ended") from None
    passed = all(verdict.is_ok for verdict in verdicts)
    if as_json:
        _print_json({"passed": passed, "runs": [verdict._asdict() for verdict in verdicts]})
    else:
        report.print_catalogue(verdicts)
    raise typer.Exit(0 if passed else 1)


@app.command()
def device(
    scenario: ScenarioName,
    link: LinkUrl = None,
    mode: Mode = None,
    robot: RobotFile = None,
    truth_port: Annotated[
        int, typer.Option(metavar="PORT", help="for the truth; 0 takes a free one", min=0, max=65535)
    ] = 0,
    target: Annotated[
        str,
        typer.Option(metavar="host|qemu|unicorn", help="what the firmware runs on: this machine, or an emulated STM32"),
    ] = "host",
    seed: Seed = None,
    sets: Sets = None,
    trace: TraceFile = None,
    until_eof: Annotated[
        bool, typer.Option("--until-eof", help="end when stdin does, as when the program that started this one is gone")
    ] = False,
) -> None:
    """Be the scenario's virtual robot in a process of its own; print one line when ready."""
    from hil.device_process import serve
    from hil.scenario import load

    resolved = load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed)
    lifeline = sys.stdin.fileno() if until_eof else None
    serve(resolved, truth_port, lambda line: print(line, flush=True), target, trace, lifeline)


@app.command()
def decode(
    trace: Annotated[Path, typer.Argument(metavar="FILE", help="a .blf, .asc, .log (candump -L) or .trc file")],
    message: Annotated[
        list[str] | None, typer.Option("--message", metavar="NAME", help="only this message; may be repeated")
    ] = None,
    from_s: Annotated[float, typer.Option("--from", metavar="S", help="seconds after the first frame")] = 0.0,
    to_s: Annotated[float, typer.Option("--to", metavar="S")] = math.inf,
    counts: Annotated[bool, typer.Option("--counts", help="how many frames of each message instead")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="one JSON object a line: for each frame, or for all")] = False,
) -> None:
    """Print a trace of the bus in the terms of the wheel-command protocol."""
    from hil.trace import decode as decoder

    with _quiet_when_the_reader_leaves():
        read = decoder.read(trace, decoder.Selection.of(message or [], from_s, to_s))
        if counts:
            found = decoder.count(read)
            if as_json:
                _print_json([row._asdict() for row in found])
            else:
                from hil import report

                report.print_table([("message", "id", "frames", "per s"), *(row.texts() for row in found)])
        else:
            for entry in read:
                if as_json:
                    _print_json(entry.record())
                else:
                    print(entry.text())
        sys.stdout.flush()
    if read.trouble is not None:
        print(f"hil: {read.trouble}", file=sys.stderr)
        raise typer.Exit(BadInputError.exit_code)


@contextlib.contextmanager
def _quiet_when_the_reader_leaves() -> Iterator[None]:
    """End quietly where stdout was closed, as by head."""
    try:
        yield
    except BrokenPipeError:
        # What is still in the buffer has no reader; without this the interpreter would complain at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(0) from None


@app.command()
def params(
    link: Annotated[str, typer.Argument(metavar="LINK", help="serial:PATH or can:INTERFACE/CHANNEL")],
    changes: Annotated[list[str] | None, typer.Argument(metavar="[NAME=VALUE]...", help="change these first")] = None,
    store: Annotated[bool, typer.Option("--store", help="keep them across a reset")] = False,
    restore: Annotated[bool, typer.Option("--restore", help="first take the values of the build")] = False,
    as_json: Json = False,
) -> None:
    """Show and change the parameters of a robot's firmware; it must be in IDLE to change."""
    from hil import report
    from hil.devices.parameters import ParameterClient, assignment
    from hil.links.opening import open_host
    from hil.links.url import parse_link

    wanted = dict(assignment(change) for change in changes or [])
    with contextlib.closing(open_host(parse_link(link))) as opened:
        client = ParameterClient(opened)
        if restore:
            client.restore()
        for name, value in wanted.items():
            client.write(name, value)
        if store:
            client.store()
        held = client.read()
    if as_json:
        _print_json({row.name: row.value for row in held})
    else:
        rows = [(row.name, f"{row.value:.7g}", f"{row.minimum:.7g} to {row.maximum:.7g}") for row in held]
        report.print_table([("parameter", "value", "range"), *rows])
        print(client.info.describe())


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
    from hil import report
    from hil.scenario import format_value, load, resolved

    rows = resolved(load(scenario, set=sets or [], robot=robot, mode=mode, link=link, seed=seed))
    if as_json:
        _print_json({key: {"value": value, "from": where} for key, value, where in rows})
        return
    report.print_table([(key, format_value(value), where) for key, value, where in rows])


@app.command("list")
def list_(
    what: Annotated[str, typer.Argument(metavar="signals|laws|scenarios|links|faults")],
    as_json: Json = False,
) -> None:
    """Print the vocabulary of signals, the shipped laws and scenarios, the forms of links, or the kinds of faults."""
    from hil import report

    header, rows = report.listing(what)
    if as_json:
        _print_json([dict(zip(header, row, strict=True)) for row in rows])
    else:
        report.print_table(rows)


@app.command()
def review(recording: Annotated[Path, typer.Argument(metavar="RUN.rrd")], as_json: Json = False) -> None:
    """Read the figures of a run back from its recording alone."""
    from hil import report
    from hil.review import review as read_back

    figures = read_back(recording)
    if as_json:
        _print_json(figures)
    else:
        report.print_figures(figures)


@app.command()
def view(
    recording: Annotated[Path, typer.Argument(metavar="RUN.rrd")],
    web: Annotated[bool, typer.Option("--web", help="in the browser, served on 127.0.0.1")] = False,
) -> None:
    """Open a recording in the rerun viewer."""
    from hil.telemetry.view import view as open_viewer

    open_viewer(recording, web=web)


@fmu_app.command("build")
def fmu_build(
    out: Annotated[Path | None, typer.Option(metavar="FOLDER", help="by default the shipped place")] = None,
    all_platforms: Annotated[
        bool, typer.Option("--all-platforms", help="compile for Linux, Windows and macOS with zig; needs --out")
    ] = False,
    mujoco: Annotated[bool, typer.Option("--mujoco", help="the MuJoCo plant instead, for this machine")] = False,
) -> None:
    """Compile the Mecanum plant and package it as FMUs, one for FMI 2.0 and one for FMI 3.0."""
    from native_build.compiler import BuildError
    from plant_fmu.build import build_all
    from plant_fmu.mujoco import build as mujoco_plant
    from plant_fmu.mujoco import path as mujoco_path

    if all_platforms and mujoco:
        raise BadInputError("--mujoco is built for this machine only; leave out --all-platforms")
    if all_platforms and out is None:
        raise BadInputError("--all-platforms makes FMUs to give away; say where to with --out FOLDER")
    try:
        if mujoco:
            paths = [mujoco_plant.build(None if out is None else out / mujoco_path().name)]
        else:
            paths = build_all(out, all_platforms=all_platforms)
        for path in paths:
            print(path)
    except (BuildError, OSError) as error:
        raise BadInputError(f"the FMU was not built: {error}") from error


FmuName = Annotated[str, typer.Argument(metavar="FMU", help="a path, or the shipped name")]


@fmu_app.command("info")
def fmu_info(
    fmu: FmuName = "mecanum",
    names: Annotated[
        str, typer.Argument(metavar="[PATTERN]", help="only variables with such names, for example 'wheel.*'")
    ] = "*",
    as_json: Json = False,
) -> None:
    """Show what an FMU says of itself, and its variables with units. Runs nothing of it."""
    from hil import report
    from hil.plant import archive
    from hil.plant.info import info

    about = info(archive.locate(fmu, Path()), names)
    if as_json:
        _print_json(asdict(about))
    else:
        report.print_fmu(about)


@fmu_app.command("check")
def fmu_check(fmu: FmuName = "mecanum", as_json: Json = False) -> None:
    """Validate an FMU and run it through the FMI calling sequence; exit 1 when something is wrong."""
    from hil import report
    from hil.plant import archive
    from hil.plant.tools import check

    path = archive.locate(fmu, Path())
    result = check(path)
    if as_json:
        _print_json({"fmu": str(path), "passed": not result.problems, **asdict(result)})
    else:
        report.print_check(path, result)
    raise typer.Exit(1 if result.problems else 0)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    """SIGTERM ends a run as Ctrl-C does: the robot is stopped and the recording closed."""
    raise KeyboardInterrupt


def _print_json(value: Any) -> None:
    print(json.dumps(_json_safe(value), allow_nan=False, default=str))


def _json_safe(value: Any) -> Any:
    """JSON knows no NaN and no infinity: null stands for them."""
    if isinstance(value, dict):
        return {key: _json_safe(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_json_safe(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def main() -> None:
    """Entry point: an error that a user is meant to read is one sentence on stderr, and its exit code."""
    try:
        app(prog_name="hil", standalone_mode=True)
    except HilError as error:
        print(f"hil: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


if __name__ == "__main__":
    main()
