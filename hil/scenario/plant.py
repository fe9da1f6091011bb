"""``[plant]``: the FMU that simulates the robot, its variables, and where the simulated robot differs from [robot]."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from hil.core.errors import nearest
from hil.core.options import Range
from hil.plant.signals import INPUTS, OUTPUTS
from hil.scenario.values import Start, Text, is_path
from plant_fmu import SHIPPED

SHIPPED_FMUS = tuple(SHIPPED)
PLANT_SIGNALS = (*INPUTS, *OUTPUTS)


def _signal_of_plant(name: str) -> str:
    if name not in PLANT_SIGNALS:
        patterns = sorted({re.sub(r"^wheel\.\w+", "wheel.*", signal) for signal in PLANT_SIGNALS})
        hint = nearest(name, PLANT_SIGNALS, f"; known: {', '.join(patterns)}")
        raise ValueError(f"the plant has no such signal{hint}")
    return name


def _fmu(fmu: str) -> str:
    if not is_path(fmu) and fmu not in SHIPPED_FMUS:
        raise ValueError(f"expected a shipped FMU or a path to one{nearest(fmu, SHIPPED_FMUS)}")
    return fmu


@dataclass(frozen=True)
class MapRow:
    """A row of ``[plant.map]``: the FMU's variable of a signal; signal = sign * scale * variable + offset."""

    name: Annotated[Text, "name of the FMU's variable; by default that of the signal"] = ""
    scale: Annotated[float, Range(gt=0), "units of the signal per unit of the variable"] = 1.0
    offset: Annotated[float, "value of the signal when the variable is 0"] = 0.0
    sign: Annotated[Literal[1, -1], "-1 if the FMU counts in the other direction"] = 1


@dataclass(frozen=True)
class PlantTable:
    """``[plant]``: the simulation that takes the place of a real robot."""

    fmu: Annotated[Text, _fmu, "a shipped name, or a path relative to this file"] = "mecanum"
    timeout_s: Annotated[float, Range(ge=0.05, le=3600), "silence after which a foreign FMU counts as hung"] = 2.0
    memory_limit_mb: Annotated[float, Range(ge=50, le=1e6), "memory above which a foreign FMU is ended"] = 2000.0
    map: Annotated[
        Mapping[Annotated[str, _signal_of_plant], MapRow],
        "the FMU's variables for signals whose names it does not have",
    ] = field(default_factory=dict)
    start: Annotated[
        Mapping[Text, Start], "start values of FMU variables that differ from [robot], or that only the plant has"
    ] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = {signal: row if row.name else replace(row, name=signal) for signal, row in self.map.items()}
        object.__setattr__(self, "map", rows)
