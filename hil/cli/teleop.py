"""``hil teleop``: driving a served robot by hand."""

import sys
from typing import Annotated

from typer import Option

from hil.cli.options import ServicePort, ServiceUrl, TokenFile
from hil.core.errors import BadInputError
from hil.core.extras import need


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
    dead_zone: Annotated[
        float, Option(metavar="SHARE", help="share of a stick's way that is rest", min=0, max=0.9)
    ] = 0.1,
    expo: Annotated[
        float, Option(metavar="SHARE", help="0: a stick is linear; 1: cubic, finest at rest", min=0, max=1)
    ] = 0.5,
) -> None:
    """Drive the robot that hil serve runs, by hand: it moves while a key or the gamepad's button is held."""
    if sys.platform == "win32":
        raise BadInputError("teleop needs a terminal of Linux or macOS; on Windows, run it in WSL")
    need("service", "hil teleop")
    from hil.service.client import find
    from hil.service.teleop.drive import teleop as drive  # it needs a terminal that Windows does not have
    from hil.service.teleop.operator import Speeds

    speeds = Speeds(speed_m_s, yaw_rate_rad_s)
    print(drive(find(url, port, token_file), speeds, gamepad=gamepad, dead_zone=dead_zone, expo=expo))
