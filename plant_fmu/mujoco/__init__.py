"""An independent second physics: the robot with real rollers in MuJoCo, as an FMI 2.0 co-simulation FMU.

``robot.c`` describes the robot to MuJoCo, ``physics.c`` steps it; variables and FMI code are those of the shipped FMU.
Building needs MuJoCo from PyPI (``pip install "mecanum-hil[mujoco]"``); running needs nothing, as the FMU contains it.
"""

from pathlib import Path


def path() -> Path:
    """Return the path of the FMU; ``python -m tools.build.mujoco_fmu`` builds it."""
    return Path(__file__).parents[1] / "mecanum_mujoco.fmu"
