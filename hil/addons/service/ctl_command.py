"""``hil ctl`` and ``hil teleop``: clients of a service that ``hil serve`` runs on this machine."""

import json
import math
import sys
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from hil.addons.service.messages import Action
from hil.cli.commands import Group
from hil.cli.options import Json, ServicePort, ServiceUrl, TokenFile
from hil.cli.output import end_in_order, print_json, print_result, rows
from hil.core.errors import BadInputError, RunInterruptedError
from hil.core.extras import need
from hil.core.printable import printable, raw_stream

if TYPE_CHECKING:
    from hil.addons.service.client import Client

app = typer.Typer(
    cls=Group, no_args_is_help=True, help="Drive the robot that hil serve runs; an order returns when accepted."
)
_NUMBERS = {"ignore_unknown_options": True}  # -0.5 is a number, not an option


@app.callback()
def choose_service(
    context: typer.Context, url: ServiceUrl = None, port: ServicePort = None, token_file: TokenFile = None
) -> None:
    """Store the options that choose the service, for every command; all None chooses the only one that runs."""
    context.obj = (url, port, token_file)


def _client(context: typer.Context) -> "Client":
    need("service", "hil ctl")
    from hil.addons.service.client import find

    return find(*context.obj)


def _order(context: typer.Context, action: Action, arguments: Mapping[str, Any] | None = None) -> None:
    """Give an order, and print its result, if it has one."""
    for name, value in _client(context).order(action, arguments).items():
        print(f"{name}: {value}")


@app.command()
def status(
    context: typer.Context,
    watch: Annotated[bool, Option("--watch", help="until Ctrl-C, 20 times a second")] = False,
    as_json: Json = False,
) -> None:
    """Show the state of the robot and the service."""
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    end_in_order()
    client = _client(context)
    if not watch:
        now = client.status()
        print_result(as_json, now, rows(_rows(now)))
        return
    try:
        if as_json or not sys.stdout.isatty():
            for now in client.watch():
                print_json(now)
                sys.stdout.flush()
        else:
            with Live(console=Console(file=raw_stream(sys.stdout)), auto_refresh=False, screen=True) as screen:
                for now in client.watch():
                    screen.update(Text(printable("\n".join(rows(_rows(now))))), refresh=True)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the service goes on") from None


def _without_arguments(action: Action) -> Callable[[typer.Context], None]:
    def order(context: typer.Context) -> None:
        _order(context, action)

    return order


for _action in (Action.ARM, Action.DISARM, Action.ESTOP, Action.CLEAR, Action.STOP):
    app.command(_action.value, help=_action.summary)(_without_arguments(_action))


@app.command(help=Action.TRACK.summary)
def track(
    context: typer.Context,
    kind: Annotated[str | None, Argument(metavar="KIND", help="by default the configuration's")] = None,
    sets: Annotated[list[str] | None, Option("--set", metavar="KEY=VALUE", help="an option: radius_m=0.5")] = None,
    here: Annotated[bool, Option("--here", help="begin where the robot stands, not at the path's begin")] = False,
) -> None:
    if kind is None and sets:
        raise BadInputError("--set is for a KIND of its own; name one of 'hil list references'")
    reference = None if kind is None else {"kind": kind} | _assignments(sets or [])
    _order(context, Action.TRACK, {"reference": reference, "here": here})


@app.command(context_settings=_NUMBERS, help=Action.GO.summary)
def go(
    context: typer.Context,
    x_m: Annotated[float, Argument(metavar="X", help="[m]")],
    y_m: Annotated[float, Argument(metavar="Y", help="[m]")],
    heading: Annotated[float, Argument(metavar="HEADING", help="[degrees]")],
) -> None:
    _order(context, Action.GO, _finite({"x_m": x_m, "y_m": y_m, "heading_rad": math.radians(heading)}))


@app.command(context_settings=_NUMBERS)
def twist(
    context: typer.Context,
    vx_m_s: Annotated[float, Argument(metavar="VX", help="forward [m/s]")],
    vy_m_s: Annotated[float, Argument(metavar="VY", help="to the left [m/s]")],
    yaw_rate_rad_s: Annotated[float, Argument(metavar="YAW", help="counter-clockwise [rad/s]")],
    for_s: Annotated[
        float | None, Option("--for", metavar="S", help="repeat it for this time, then stop", min=0.05, max=3600)
    ] = None,
) -> None:
    """Drive by twist, in the body frame: once, in force until it times out, or repeated; Ctrl-C stops."""
    arguments = _finite({"vx_m_s": vx_m_s, "vy_m_s": vy_m_s, "yaw_rate_rad_s": yaw_rate_rad_s})
    if for_s is None:
        _order(context, Action.TWIST, arguments)
    else:
        end_in_order()
        _client(context).twist(arguments, for_s)


@app.command(help=Action.GAINS.summary)
def gains(context: typer.Context, changes: Annotated[list[str] | None, Argument(metavar="NAME=VALUE")] = None) -> None:
    _order(context, Action.GAINS, {"gains": _assignments(changes or [])})


@app.command(help=Action.RECORD.summary)
def record(
    context: typer.Context,
    name: Annotated[
        str | None, Argument(metavar="NAME", help=".rrd or .mcap in the service's folder; by default a new one")
    ] = None,
) -> None:
    _order(context, Action.RECORD, {"name": name})


for _action in (Action.STOP_RECORDING, Action.SHUTDOWN):
    app.command(_action.value.replace("_", "-"), help=_action.summary)(_without_arguments(_action))


def teleop(
    url: ServiceUrl = None,
    port: ServicePort = None,
    token_file: TokenFile = None,
    speed_m_s: Annotated[
        float, Option("--speed", metavar="M/S", help="in the plane, at full deflection", min=0.001, max=20)
    ] = 0.25,
    yaw_rate_rad_s: Annotated[
        float, Option("--yaw-rate", metavar="RAD/S", help="in yaw, at full deflection", min=0.001, max=50)
    ] = 0.8,
    gamepad: Annotated[bool, Option("--gamepad", help="drive with a gamepad too: hold its left shoulder")] = False,
) -> None:
    """Drive the robot that hil serve runs, by hand: it moves while a key or the gamepad's button is held."""
    if sys.platform == "win32":
        raise BadInputError("teleop needs a terminal of Linux or macOS; on Windows, run it in WSL")
    need("service", "hil teleop")
    from hil.addons.service.client import find
    from hil.addons.service.teleop.drive import teleop as drive  # it needs a terminal that Windows does not have
    from hil.addons.service.teleop.operator import Speeds

    speeds = Speeds(speed_m_s, yaw_rate_rad_s)
    print(drive(find(url, port, token_file), speeds, gamepad=gamepad))


def _finite(arguments: dict[str, float]) -> dict[str, float]:
    """Return the arguments. Raises BadInputError for NaN and infinity, which JSON does not have."""
    for name, value in arguments.items():
        if not math.isfinite(value):
            raise BadInputError(f"{name} = {value}: expected a finite number")
    return arguments


def _assignments(texts: list[str]) -> dict[str, Any]:
    """Parse KEY=VALUE texts to a mapping; a value is TOML, or else plain text."""
    from hil.scenario.toml_text import parse_value

    values: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not key or not equals:
            raise BadInputError(f"{text!r}: expected NAME=VALUE, such as radius_m=0.5")
        values[key] = parse_value(value)
        try:
            json.dumps(values[key], allow_nan=False)
        except (TypeError, ValueError):
            raise BadInputError(f"{text!r}: expected a finite number, true, false, a text or a list of them") from None
    return values


def _rows(status: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the status as rows of a label and a text; unknown values are left out."""
    task, robot, frames = status["task"], status["robot"], status["frames"]
    if robot is not None and status["power_stage"] is not None:
        robot += ", with motors" if status["power_stage"] else ", without motors"
    rejected = ", ".join(f"{number} {cause}" for cause, number in frames.get("rejected", {}).items() if number)
    gone = "".join(f", {status[f'rows_{how}']} rows {how}" for how in ("dropped", "lost") if status[f"rows_{how}"])
    lateness = [f"{name} {value:.0f} µs" for name, value in status["lateness_us"].items() if value is not None]
    found = [
        ("phase", status["phase"] if task is None else f"{status['phase']}, {task}"),
        ("why", status["why"]),
        ("serves", f"{status['scenario']}, {status['law']} in {status['command']} mode"),
        ("link", status["link"]),
        ("robot", robot),
        ("pose", _pose(status["pose"])),
        ("reference", _pose(status["reference"])),
        ("twist", _format(status["twist"], "{:.3f} m/s, {:.3f} m/s, {:.3f} rad/s")),
        ("wheels", _format(status["speed_rad_s"], "{:.2f}, {:.2f}, {:.2f}, {:.2f} rad/s")),
        ("battery", _number(status["battery_v"], ".1f", "V")),
        ("estimator", status["health"]),
        ("gains", ", ".join(f"{name} {value:g}" for name, value in status["gains"].items())),
        ("ticks", f"{status['ticks']}, {status['deadline_misses']} late by a period or more"),
        ("lateness", ", ".join(lateness)),
        ("feedback age", _number(status["feedback_age_ms"], ".2f", "ms")),
        ("round trip", _number(status["round_trip_ms"], ".2f", "ms")),
        (
            "frames",
            f"{frames.get('sent', 0)} sent, {frames.get('received', 0)} received, rejected: {rejected or 'none'}",
        ),
        ("recoveries", str(status["recoveries"])),
        ("recording", f"{status['recording'] or 'none'}{gone}" if status["recording"] or gone else None),
        ("not recorded", status["recording_trouble"]),
        *((name, sentence.removeprefix(f"{name}: ")) for name, sentence in status["realtime"].items()),
    ]
    return [(name, text) for name, text in found if text]


def _pose(pose: Any) -> str | None:
    return None if pose is None or None in pose else f"{pose[0]:.3f} m, {pose[1]:.3f} m, {math.degrees(pose[2]):.1f}°"


def _format(values: Any, form: str) -> str | None:
    return None if values is None or None in values else form.format(*values)


def _number(value: float | None, form: str, unit: str) -> str | None:
    return None if value is None else f"{value:{form}} {unit}"
