"""The plant: a rigid four-wheel Mecanum robot as an FMI 2.0 co-simulation FMU.

variables.toml defines its variables, mecanum.c its equations, instance.c and fmi2.c the slave around them;
build.py makes the FMU. Imports nothing of the other packages.
"""

from pathlib import Path


def path(fmi: int = 2) -> Path:
    """Return where the FMU of an FMI version (2 or 3) is once built (``python -m plant_fmu.build``)."""
    return Path(__file__).parent / {2: "mecanum.fmu", 3: "mecanum_fmi3.fmu"}[fmi]
