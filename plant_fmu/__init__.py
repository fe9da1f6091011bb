"""The plant: a four-wheel Mecanum robot as a co-simulation FMU, of FMI 2.0 and of FMI 3.0.

variables.toml defines its variables, mecanum.c its equations, instance.c the slave, fmi2.c and fmi3.c its two
interfaces; build.py makes the FMUs. Imports nothing of the other packages.
"""

from pathlib import Path


def path(fmi: int = 2) -> Path:
    """Return where the FMU of FMI version 2 or 3 is once built (``python -m plant_fmu.build``)."""
    return Path(__file__).parent / {2: "mecanum.fmu", 3: "mecanum_fmi3.fmu"}[fmi]
