"""``hil view``, ``hil live``, ``hil decode`` and ``hil export``."""

import math
import sys
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.commands import Group
from hil.cli.options import LIVE_PORT, Force, InBrowser, RobotFile, ScenarioName
from hil.cli.output import drop_output, end_in_order, print_json, say, say_on_stderr
from hil.core.errors import BadInputError


def view(recording: Annotated[Path, Argument(metavar="RUN.rrd")], web: InBrowser = False) -> None:
    """Open a recording in the rerun viewer."""
    from hil.addons.report import viewer

    end_in_order()
    viewer.view(recording, web=web)


def live(
    web: InBrowser = False,
    port: Annotated[int, Option(metavar="PORT", help="that a --live command serves on", min=1, max=65535)] = LIVE_PORT,
) -> None:
    """Open the rerun viewer on a run or service under way, and on each one after it; start it before or after those."""
    from hil.addons.report import viewer

    end_in_order()
    viewer.live(port, web=web, say=say)


def decode(
    trace: Annotated[Path, Argument(metavar="FILE", help="a .blf or .log (candump -L) file")],
    message: Annotated[list[str] | None, Option(metavar="NAME", help="only this message; repeatable")] = None,
    channel: Annotated[list[str] | None, Option(metavar="NAME", help="only this bus; repeatable")] = None,
    from_s: Annotated[
        float, Option("--from", metavar="S", show_default=False, help="seconds after the first frame; by default all")
    ] = -math.inf,
    to_s: Annotated[
        float, Option("--to", metavar="S", show_default=False, help="the last second; by default the end")
    ] = math.inf,
    raw: Annotated[bool, Option("--raw", help="decode no frame: they are of other makers' motors")] = False,
    as_json: Annotated[bool, Option("--json", help="one JSON object a line, for each frame")] = False,
) -> None:
    """Print a trace of the bus in the terms of the wheel-command protocol."""
    from hil.addons.report.trace import trace_decoder as decoder

    read = decoder.read(trace, decoder.Selection.of(message or [], from_s, to_s, raw=raw, channels=channel or []))
    try:
        if read.foreign:
            buses = " and ".join(sorted(f"channel {one}" for one in read.foreign if one is not None))
            say_on_stderr(
                f"hil: note: {trace} has no TICK of our firmware{f' on {buses}' * bool(buses)}, and most of the frames "
                "there are not ours; other makers use the same identifiers, so those frames are printed as they are"
            )
        for entry in read:
            print_json(entry.record()) if as_json else print(entry.text())
        if read.trouble is None and read.selected == 0:
            say_on_stderr(f"hil: none of the {read.frames} frames of {trace} is what was asked for")
        sys.stdout.flush()
        if (rest := read.rest()) is not None:
            say_on_stderr(f"hil: note: {rest}")
    except BrokenPipeError:  # the reader of stdout has left, as head does
        drop_output()
        raise typer.Exit(0) from None
    if read.trouble is not None:
        say_on_stderr(f"hil: {read.trouble}")
        raise typer.Exit(BadInputError.exit_code)


export_app = typer.Typer(
    cls=Group, no_args_is_help=True, help="Write a robot for other programs: its description as a URDF."
)


@export_app.callback()
def _export() -> None:
    """Keep the name of the one command there is."""


@export_app.command("urdf")
def urdf(
    scenario: ScenarioName,
    robot: RobotFile = None,
    out: Annotated[Path | None, Option(metavar="FILE.urdf", help="by default it is printed")] = None,
    force: Force = False,
) -> None:
    """Describe a robot for ROS, RViz and Foxglove: links, joints and shapes, in one file."""
    from hil.addons.report.urdf import RobotShape
    from hil.core.outputs import existing_files, write_whole
    from hil.record.files import check_output_path
    from hil.scenario import load

    existing = existing_files(force=force)
    if out is not None:
        check_output_path("urdf", out, existing)
    text = RobotShape.of_model(load(scenario, robot=robot).robot).urdf(Path(robot or scenario).stem)
    if out is None:
        print(text, end="")
    else:
        write_whole(out, text.encode(), "urdf", existing)
        print(out)
