"""What of an FMU may be given another value between two ticks: tunable parameters, and inputs that nothing drives."""

import math
from collections.abc import Collection
from typing import Any, NamedTuple

from hil.plant.mapping import FLOATS, Variables


class Settable(NamedTuple):
    """A variable that may be set: its place for the shim, its value at the start, and its range in the FMU's unit."""

    place: int
    start: float
    low: float
    high: float


def settable_variables(variables: Variables, driven: Collection[str]) -> dict[str, Any]:
    """Return the scalars of a floating-point type that may be set in step mode, by name.

    FMI 2.0 section 2.2.7 and FMI 3.0 section 2.4.7.4: inputs, here those that are not ``driven`` by the firmware, and
    tunable parameters.
    """
    return {
        name: variable
        for name, variable in variables.items()
        if variable.type in FLOATS and not variable.shape and name == variable.name and _may_change(variable, driven)
    }


def bounds(variable: Any) -> tuple[float, float]:
    """Return the range that the FMU's description gives a variable; infinite where it gives none."""
    low, high = variable.min, variable.max
    return (-math.inf if low is None else float(low)), (math.inf if high is None else float(high))


def _may_change(variable: Any, driven: Collection[str]) -> bool:
    if variable.causality == "input":
        return variable.name not in driven
    return bool(variable.causality == "parameter" and variable.variability == "tunable")
