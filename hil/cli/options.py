"""Options and output that several commands share."""

import json
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Annotated, Any

import typer

from hil.core.json_lines import json_safe

ScenarioName = Annotated[str, typer.Argument(metavar="SCENARIO", help="a shipped name or a path to a .toml file")]
Sets = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override any key, for example robot.mass_kg=24")
]
RobotFile = Annotated[Path | None, typer.Option("--robot", metavar="FILE", help="merge a robot's own file")]
Mode = Annotated[str | None, typer.Option(metavar="lockstep|realtime", help="as fast as possible, or by the clock")]
LinkUrl = Annotated[
    str | None, typer.Option("--link", metavar="LINK", help="memory:, serial:PATH, serial:pty or can:INTERFACE/CHANNEL")
]
Seed = Annotated[int | None, typer.Option(metavar="N", help="of everything random in the run")]
TraceFile = Annotated[
    Path | None, typer.Option("--trace", metavar="FILE.blf|.asc|.log", help="write what is on the wire, for bus tools")
]
Force = Annotated[bool, typer.Option("--force", help="replace files that are there already")]
TruthUrl = Annotated[
    str | None, typer.Option("--truth", metavar="URL", help="truth socket of hil device, tcp://127.0.0.1:PORT")
]
LIVE_PORT = 9876
LivePort = Annotated[int, typer.Option(metavar="PORT", help="for --live", min=1, max=65535)]
AllowMotion = Annotated[bool, typer.Option("--allow-motion", help="real motors may move")]
ServiceUrl = Annotated[str | None, typer.Option("--url", metavar="URL", help="http://127.0.0.1:PORT")]
ServicePort = Annotated[
    int | None, typer.Option("--port", metavar="PORT", help="which service, when several run", min=1, max=65535)
]
TokenFile = Annotated[
    Path | None, typer.Option("--token-file", metavar="FILE", help="with the token; by default the service's own")
]
Json = Annotated[bool, typer.Option("--json", help="print one JSON object and nothing else")]


def print_json(value: Any) -> None:
    """Print one JSON object on a line."""
    print(json.dumps(json_safe(value), allow_nan=False, default=str))


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
    """Make SIGTERM and SIGHUP end a command as Ctrl-C does: robots are stopped, files closed.

    A SIGHUP that is ignored, as under nohup, stays ignored.
    """
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
