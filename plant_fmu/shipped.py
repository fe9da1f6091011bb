"""The variables of the FMUs that ship with this package, without opening one."""

import functools

from plant_fmu import mujoco, variables
from plant_fmu.mujoco import definition


@functools.cache
def variable_names(fmu: str) -> frozenset[str]:
    """Return the names of the variables of a shipped FMU, given by its name (``plant_fmu.SHIPPED``)."""
    made_from = definition if fmu == mujoco.path().stem else variables
    return frozenset(variable.name for variable in made_from.read().variables)
