"""``python -m plant_fmu.mujoco`` builds the FMU; with ``--model`` it also writes the robot as a file of MuJoCo's."""

import argparse
import math
import sys
from pathlib import Path

from native_build.compiler import BuildError
from plant_fmu.mujoco.build import build
from plant_fmu.mujoco.model import ModelError, save


def setting(text: str) -> tuple[str, float]:
    """Return name and value of ``name=value``. Raises ValueError, which argparse reports."""
    name, _, value = text.partition("=")
    if not math.isfinite(float(value)):
        raise ValueError
    return name, float(value)


def main() -> None:
    """Build the FMU and print its path, and the model's."""
    parser = argparse.ArgumentParser(prog="plant_fmu.mujoco", description="Build the MuJoCo plant for this machine.")
    parser.add_argument("--out", type=Path, help="the FMU to write; the package's own by default")
    parser.add_argument("--model", type=Path, help="also write the robot for MuJoCo's viewer: a file .xml or .mjb")
    parser.add_argument(
        "--set",
        type=setting,
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="parameters",
        help="a parameter of that robot, such as wheel_radius_m=0.05",
    )
    arguments = parser.parse_args()
    if arguments.parameters and arguments.model is None:
        parser.error("--set is for --model; the FMU takes its parameters when it runs")
    try:
        fmu = build(arguments.out)
        print(fmu)
        if arguments.model is not None:
            save(fmu, arguments.model, dict(arguments.parameters))
            print(arguments.model)
    except (BuildError, ModelError) as error:
        sys.exit(f"plant_fmu.mujoco: {error}")


if __name__ == "__main__":
    main()
