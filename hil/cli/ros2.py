"""``hil ros2``: a robot or its simulation as a ROS 2 node."""

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from hil.scenario import Scenario

_ROS_ARGS = "--ros-args"


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

    def loaded(further: Sequence[str] = ()) -> "Scenario":
        return load(config, set=[*(sets or []), *further], robot=robot, mode=mode, link=link)

    scenario = loaded()
    from hil.service.ros2.installation import require_ros

    require_ros()
    from hil.service.ros2.node import run_served, run_simulated

    uses_service = url is not None or port is not None
    if scenario.loop.mode == "lockstep" and link_of(scenario).is_within_process and not uses_service:
        if truth is not None:
            raise BadInputError(f"--truth {truth}: a simulation in this process knows the truth; leave it out")
        run_simulated(loaded, ros)
        return
    with contextlib.ExitStack() as resources:
        need("service", "hil ros2 with a service")

        def service() -> tuple[Any, Any]:
            from hil.service.client import find
            from hil.service.ros2.robot import OwnService

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
