"""A second physics that nobody here wrote: the robot with real rollers in MuJoCo, as an FMI 2.0 co-simulation FMU.

``robot.c`` describes the robot to MuJoCo, ``physics.c`` steps it; variables and FMI are the shipped FMU's own.
Needs MuJoCo from PyPI to build (``pip install "mecanum-hil[mujoco]"``), and nothing to run: the FMU carries it.
"""

from pathlib import Path


def path() -> Path:
    """Return where the FMU is once built (``python -m tools.build.mujoco_fmu``)."""
    return Path(__file__).parents[1] / "mecanum_mujoco.fmu"
