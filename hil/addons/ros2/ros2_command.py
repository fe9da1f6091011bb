"""``hil ros2``: a robot or its simulation as a ROS 2 node."""

import contextlib
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import typer

from hil.cli.options import (
    AllowMotion,
    LinkUrl,
    Mode,
    RobotFile,
    ScenarioName,
    ServicePort,
    ServiceUrl,
    Sets,
    TokenFile,
    TruthUrl,
)
from hil.cli.output import end_in_order
from hil.core.errors import BadInputError
from hil.core.extras import need

_ROS_ARGS = "--ros-args"
_TOO_OLD = ("foxy", "galactic", "humble", "iron")  # made for Python 3.8 or 3.10
_WHEELS = "pip install 'mecanum-hil[ros2]' on Linux"


def ros2(
    context: typer.Context,
    config: ScenarioName,
    mode: Mode = None,
    link: LinkUrl = None,
    truth: TruthUrl = None,
    robot: RobotFile = None,
    url: ServiceUrl = None,
    port: ServicePort = None,
    token_file: TokenFile = None,
    sets: Sets = None,
    allow_motion: AllowMotion = False,
) -> None:
    """Be a ROS 2 node for a robot or its simulation: cmd_vel in; odometry, tf, joint states and more out.

    In lockstep within this process it is a simulator with /clock; otherwise the node starts hil serve, or uses the one
    that --port or --url names. What follows --ros-args is ROS 2's own: -r, -p, --params-file.
    """
    end_in_order()
    ros = _ros_arguments(context.args)
    from hil.runtime.robots import link_of
    from hil.scenario import load

    scenario = load(config, set=sets or [], robot=robot, mode=mode, link=link)
    _require_ros()
    from hil.addons.ros2.node import run_served, run_simulated

    uses_service = url is not None or port is not None
    if scenario.loop.mode == "lockstep" and link_of(scenario).is_within_process and not uses_service:
        if truth is not None:
            raise BadInputError(f"--truth {truth}: a simulation in this process knows the truth; leave it out")
        run_simulated(scenario, ros)
        return
    with contextlib.ExitStack() as resources:
        need("service", "hil ros2 with a service")

        def service() -> tuple[Any, Any]:
            from hil.addons.ros2.robot import OwnService
            from hil.addons.service.client import find

            if uses_service:
                return None, find(url, port, token_file)
            words = [config, *(word for one in sets or [] for word in ("--set", one))]
            for name, value in (("--link", link), ("--truth", truth), ("--robot", robot)):
                words += [] if value is None else [name, str(value)]
            own = resources.enter_context(OwnService([*words, *(["--allow-motion"] if allow_motion else [])]))
            return own, own.client()

        run_served(scenario, service, ros)


ros2.context_settings = {"ignore_unknown_options": True, "allow_extra_args": True}  # type: ignore[attr-defined]


def _ros_arguments(words: Sequence[str]) -> list[str]:
    """Return what is ROS 2's own. Raises BadInputError for a word before it that no option of ours takes."""
    if words and words[0] != _ROS_ARGS:
        raise BadInputError(f"{words[0]!r} is no option of hil ros2; what ROS 2 takes comes after {_ROS_ARGS}")
    return list(words)


def _require_ros() -> None:
    """Raise BadInputError when ROS 2 is missing, too old, or made for another Python."""
    distribution = os.environ.get("ROS_DISTRO", "")
    if distribution in _TOO_OLD:
        raise BadInputError(
            f"ROS 2 {distribution.capitalize()} is sourced, which is made for an older Python than hil needs (3.11); "
            f"source Jazzy or later, or in a terminal without it: {_WHEELS}"
        )
    try:
        importlib.import_module("rclpy")
    except ImportError as error:
        raise BadInputError(
            f"ROS 2 is not there for this Python {sys.version_info[0]}.{sys.version_info[1]} ({error}); {_WHEELS}, or "
            "source ROS 2's setup.bash and use the Python that it was made for"
        ) from error
