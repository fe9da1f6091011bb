"""``hil run``."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from hil.cli.options import (
    LIVE_PORT,
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
    end_in_order,
    flush_output,
    print_json,
)
from hil.core.errors import DeviceError, LinkError, RunInterruptedError


def run(
    context: typer.Context,
    scenario: ScenarioName,
    mode: Mode = None,
    link: LinkUrl = None,
    truth: TruthUrl = None,
    robot: RobotFile = None,
    record: Annotated[
        str | None, typer.Option(metavar="FILE|none", help="recording (.rrd, .mcap); by default runs/SCENARIO-TIME.rrd")
    ] = None,
    rotate: Annotated[
        str | None, typer.Option(metavar="SIZE|TIME", help="record on in another file, as in 1GB, 10min or '1GB|10min'")
    ] = None,
    trace: TraceFile = None,
    live: Annotated[bool, typer.Option("--live", help="serve live viewers on 127.0.0.1 while it runs")] = False,
    live_port: LivePort = LIVE_PORT,
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
    # First, because the recorder process takes as long to import its modules as this one.
    make_recording = context.with_resource(early_recorder(suffix, live=live))

    from hil.cli import report
    from hil.core.outputs import existing_files
    from hil.runtime.assembly import RunOptions, run_scenario
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
            RunOptions(
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
            ),
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
    """Print the JSON of a run before its stuck law ends this process."""
    print_json({"passed": False, "failure": sentence})
    flush_output()
