"""``hil export``: a robot for other programs."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from hil.cli.commands import Group
from hil.cli.options import Force, RobotFile

app = typer.Typer(cls=Group, no_args_is_help=True, help="Write a robot for other programs: its description as a URDF.")


@app.callback()
def _export() -> None:
    """Keep the name of the one command there is."""


@app.command("urdf")
def urdf(
    config: Annotated[str, Argument(metavar="CONFIG", help="a robot's own file, or a scenario's file or name")],
    robot: RobotFile = None,
    out: Annotated[Path | None, Option(metavar="FILE.urdf", help="by default it is printed")] = None,
    force: Force = False,
) -> None:
    """Describe a robot for ROS, RViz and Foxglove: links, joints, shapes, masses and inertias, in one file.

    Mass, yaw inertia and the wheels' inertia are those of [robot]; RECORDING.md says what is chosen.
    """
    from hil.core.outputs import existing_files, write_whole
    from hil.record.files import check_output_path
    from hil.record.robot_model import robot_description
    from hil.scenario import robot_model

    existing = existing_files(force=force)
    if out is not None:
        check_output_path("urdf", out, existing)
    text = robot_description(robot_model(config, robot), Path(robot or config).stem)
    if out is None:
        print(text, end="")
    else:
        write_whole(out, text.encode(), "urdf", existing)
        print(out)
