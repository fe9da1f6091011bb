"""The plant: a rigid four-wheel Mecanum robot as an FMI 2.0 co-simulation FMU.

variables.toml defines its variables, mecanum.c its equations, instance.c and fmi2.c the slave around them;
build.py makes the FMU. Imports nothing of the other packages.
"""

from pathlib import Path


def path() -> Path:
    """Return where the FMU is once built (``python -m plant_fmu.build``)."""
    return Path(__file__).parent / "mecanum.fmu"
