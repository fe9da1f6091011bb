"""``hil params``: the parameters that a robot's firmware holds."""

import contextlib
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from hil.cli.options import Json, PortOrBus, RobotFile
from hil.cli.output import print_result, table
from hil.core.errors import BadInputError


def params(
    link: PortOrBus,
    changes: Annotated[list[str] | None, Argument(metavar="NAME=VALUE", help="change these first")] = None,
    scenario: Annotated[str | None, Option(metavar="SCENARIO", help="first take all values of this one")] = None,
    robot: RobotFile = None,
    store: Annotated[bool, Option("--store", help="keep them across a reset")] = False,
    restore: Annotated[bool, Option("--restore", help="first go back to the values of the build")] = False,
    as_json: Json = False,
) -> None:
    """Show and change the parameters of a robot's firmware; it must be in IDLE to change. All are checked first."""
    from hil.robot.parameters import ParameterClient, assignments
    from hil.wire.device_lock import device_held
    from hil.wire.url import parse_link

    url = parse_link(link)
    if url.is_within_process:
        raise BadInputError(
            f"link {link!r} reaches no robot outside this process, and a robot made for it would only have the "
            "built-in values; name the robot's port, such as serial:/dev/ttyACM0, or the link that 'hil device' prints"
        )
    values = _of_scenario(scenario, robot) | assignments(changes or [])
    with device_held(url, f"hil params {link}"), contextlib.closing(url.open_host()) as opened:
        client = ParameterClient(opened)
        checked = client.check(values)  # check all before changing any
        if restore:
            client.restore()
        client.write(checked)
        if store:
            client.store()
        held = client.read()
        info = client.greet()
    head = ("parameter", "type", "value", "range")
    rows = [
        (row.name, row.type.name.lower(), f"{row.value:.7g}", f"{row.minimum:.7g} to {row.maximum:.7g}") for row in held
    ]
    lines = [*table([head, *rows]), info.describe()]
    print_result(as_json, {row.name: row.value for row in held}, lines)


def _of_scenario(scenario: str | None, robot: Path | None) -> dict[str, float]:
    """Return what a scenario, or any scenario with a robot's file, has of the firmware's parameters; else nothing."""
    if scenario is None and robot is None:
        return {}
    from hil.runtime.robots import firmware_values
    from hil.scenario import BASE, load

    return dict(firmware_values(load(scenario or BASE, robot=robot)))
