"""The plant: a four-wheel Mecanum robot as a co-simulation FMU, for FMI 2.0 and for FMI 3.0.

variables.toml defines its variables, mecanum.c its equations, instance.c and fmi2.c the slave around them;
build.py makes the FMU. Imports nothing of the other packages.
"""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType


def path(fmi: int = 2) -> Path:
    """Return where the FMU for FMI 2.0 or 3.0 is once built (``python -m plant_fmu.build``)."""
    return Path(__file__).parent / {2: "mecanum.fmu", 3: "mecanum_fmi3.fmu"}[fmi]


# The FMUs that a scenario may give by name, with where they are once built.
SHIPPED: Mapping[str, Path] = MappingProxyType(
    {"mecanum": path(2), "mecanum_fmi3": path(3), "mecanum_mujoco": Path(__file__).parent / "mecanum_mujoco.fmu"}
)
