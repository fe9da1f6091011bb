"""The plant: a four-wheel Mecanum robot as co-simulation FMUs, one for FMI 2.0 and one for FMI 3.0.

variables.toml defines its variables, mecanum.c its equations, instance.c, fmi2.c and fmi3.c the slave around them;
tools/build makes the FMUs. Imports nothing of the other packages.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from plant_fmu import mujoco

_FILES = {2: "mecanum.fmu", 3: "mecanum_fmi3.fmu"}


def path(fmi: int = 2) -> Path:
    """Return the path of the FMU of one FMI version (2 or 3); ``python -m tools.build.fmu`` builds it."""
    return Path(__file__).parent / _FILES[fmi]


# FMUs that a scenario may give by name, and their paths.
SHIPPED: Mapping[str, Path] = MappingProxyType(
    {"mecanum": path(2), "mecanum_fmi3": path(3), "mecanum_mujoco": mujoco.path()}
)
