"""``hil ctl``: the client of a service that ``hil serve`` runs on this machine."""

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hil.cli.commands import Group
from hil.cli.options import Force, Json, ServicePort, ServiceUrl, TokenFile, end_in_order, print_json
from hil.core.errors import BadInputError, RunInterruptedError

if TYPE_CHECKING:
    from rich.table import Table

    from hil.service.client import Client

app = typer.Typer(
    cls=Group, no_args_is_help=True, help="Drive the robot that hil serve runs; an order returns when accepted."
)

# So that -0.5 is a number and no option.
_NUMBERS = {"ignore_unknown_options": True}


class _Which(NamedTuple):
    """Which service is meant; all None for the only one."""

    url: str | None
    port: int | None
    token_file: Path | None


@app.callback()
def which(
    context: typer.Context,
    url: ServiceUrl = None,
    port: ServicePort = None,
    token_file: TokenFile = None,
) -> None:
    """Take what all commands have in common."""
    context.obj = _Which(url, port, token_file)


@app.command()
def status(
    context: typer.Context,
    watch: Annotated[bool, typer.Option("--watch", help="until Ctrl-C, 20 times a second")] = False,
    as_json: Json = False,
) -> None:
    """Show how the robot and the service are."""
    end_in_order()
    client = _client(context)
    if not watch:
        _show(client.status(), as_json=as_json)
        return
    try:
        if as_json or not sys.stdout.isatty():
            for one in client.watch():
                _show(one, as_json=True)
                sys.stdout.flush()
        else:
            _watch(client)
    except KeyboardInterrupt:
        raise RunInterruptedError("interrupted; the service goes on") from None


@app.command()
def arm(context: typer.Context) -> None:
    """Arm the robot: it may move from here on, and is held at rest."""
    _order(context, "arm")


@app.command()
def disarm(context: typer.Context) -> None:
    """Ramp down, and disarm."""
    _order(context, "disarm")


@app.command()
def estop(context: typer.Context) -> None:
    """Stop the robot at once; `clear` leads out of it."""
    _order(context, "estop")


@app.command()
def clear(context: typer.Context) -> None:
    """Leave FAULT or ESTOP when the cause is gone; arms nothing."""
    _order(context, "clear")


@app.command()
def track(
    context: typer.Context,
    kind: Annotated[str | None, typer.Argument(metavar="[KIND]", help="by default the configuration's")] = None,
    sets: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="an option of the kind, such as radius_m=0.5")
    ] = None,
    here: Annotated[
        bool, typer.Option("--here", help="begin where the robot stands; else it drives to the begin first")
    ] = False,
) -> None:
    """Follow a path."""
    if kind is None and sets:
        raise BadInputError("--set is for a KIND of its own; name one of 'hil list references'")
    reference = None if kind is None else {"kind": kind} | _assignments(sets or [])
    _order(context, "track", {"reference": reference, "here": here})


@app.command(context_settings=_NUMBERS)
def go(
    context: typer.Context,
    x_m: Annotated[float, typer.Argument(metavar="X", help="[m]")],
    y_m: Annotated[float, typer.Argument(metavar="Y", help="[m]")],
    heading: Annotated[float, typer.Argument(metavar="HEADING", help="[degrees]")],
    radians: Annotated[bool, typer.Option("--rad", help="HEADING is in rad")] = False,
) -> None:
    """Drive to a pose in the world frame, by the shorter turn."""
    heading_rad = heading if radians else math.radians(heading)
    _order(context, "go", _finite({"x_m": x_m, "y_m": y_m, "heading_rad": heading_rad}))


@app.command(context_settings=_NUMBERS)
def twist(
    context: typer.Context,
    vx_m_s: Annotated[float, typer.Argument(metavar="VX", help="forward [m/s]")],
    vy_m_s: Annotated[float, typer.Argument(metavar="VY", help="to the left [m/s]")],
    yaw_rate_rad_s: Annotated[float, typer.Argument(metavar="YAW", help="counter-clockwise [rad/s]")],
    for_s: Annotated[
        float | None,
        typer.Option("--for", metavar="SECONDS", help="repeat it for so long, then stop", min=0.05, max=3600),
    ] = None,
) -> None:
    """Drive by twist, in the body frame: once, in force until it times out, or repeated; Ctrl-C stops."""
    arguments = _finite({"vx_m_s": vx_m_s, "vy_m_s": vy_m_s, "yaw_rate_rad_s": yaw_rate_rad_s})
    if for_s is None:
        _order(context, "twist", arguments)
        return
    end_in_order()
    _client(context).twist(arguments, for_s)


@app.command()
def stop(context: typer.Context) -> None:
    """Ramp down to rest, and hold; the robot stays armed."""
    _order(context, "stop")


@app.command()
def gains(
    context: typer.Context,
    changes: Annotated[list[str] | None, typer.Argument(metavar="[NAME=VALUE]...")] = None,
) -> None:
    """Change gains of the law; without any, read those of the configuration's file again."""
    _order(context, "gains", {"gains": _assignments(changes) if changes else None})


@app.command()
def record(
    context: typer.Context,
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help=".rrd or .mcap; by default runs/...")] = None,
    force: Force = False,
) -> None:
    """Begin a recording."""
    if file is not None:
        from hil.core.outputs import check_free, existing_files

        check_free("recording", file, existing_files(force=force))
    # The service runs in a folder of its own.
    _order(context, "record", {"path": None if file is None else str(file.absolute()), "force": force})


@app.command("stop-recording")
def stop_recording(context: typer.Context) -> None:
    """End the recording."""
    _order(context, "stop_recording")


@app.command()
def shutdown(context: typer.Context) -> None:
    """Ramp down, disarm, close the recording, and end the service."""
    _order(context, "shutdown")


def _client(context: typer.Context) -> "Client":
    from hil.service.client import find

    asked: _Which = context.obj
    return find(asked.url, asked.port, asked.token_file)


def _order(context: typer.Context, action: str, arguments: Mapping[str, Any] | None = None) -> None:
    """Have an order taken, and print what the service says of it, if anything."""
    from hil.service.messages import Action

    for name, value in _client(context).order(Action(action), arguments).items():
        print(f"{name}: {value}")


def _finite(arguments: dict[str, float]) -> dict[str, float]:
    """Return the arguments. Raises BadInputError for a number that JSON does not have."""
    for name, value in arguments.items():
        if not math.isfinite(value):
            raise BadInputError(f"{name} = {value}: expected a finite number")
    return arguments


def _assignments(texts: list[str]) -> dict[str, Any]:
    """Return KEY=VALUE texts as a mapping; a value is TOML, or a text."""
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


def _show(status: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(status)
        return
    from rich.console import Console

    Console(highlight=False, soft_wrap=True).print(_table(status))


def _watch(client: "Client") -> None:
    from rich.live import Live

    with Live(auto_refresh=False, screen=True) as screen:
        for one in client.watch():
            screen.update(_table(one), refresh=True)


def _table(status: Mapping[str, Any]) -> "Table":
    from rich.table import Table
    from rich.text import Text

    from hil.service.status_words import status_rows

    table = Table(box=None, show_header=False)
    for name, text in status_rows(status):
        table.add_row(name, Text(text))
    return table
