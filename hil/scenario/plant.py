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
        hint = nearest(name, PLANT_SIGNALS)
        patterns = sorted({re.sub(r"^wheel\.\w+", "wheel.*", signal) for signal in PLANT_SIGNALS})
        known = hint if "did you mean" in hint else f"; known: {', '.join(patterns)}"
        raise ValueError(f"the plant has no such signal{known}")
    return name


def _fmu(fmu: str) -> str:
    if not is_path(fmu) and fmu not in SHIPPED_FMUS:
        raise ValueError(f"expected a shipped FMU or a path to one{nearest(fmu, SHIPPED_FMUS)}")
    return fmu


@dataclass(frozen=True)
class MapRow:
    """A row of ``[plant.map]``: the FMU's variable of a signal; signal = sign * scale * variable + offset."""

    name: Annotated[Text, "of the FMU's variable; by default the signal's own"] = ""
    scale: Annotated[float, Range(gt=0), "units of the signal in one of the variable's"] = 1.0
    offset: Annotated[float, "the signal where the variable is 0"] = 0.0
    sign: Annotated[Literal[1, -1], "-1 where the FMU counts the other way"] = 1


@dataclass(frozen=True)
class PlantTable:
    """``[plant]``: the simulation that takes the place of a real robot."""

    fmu: Annotated[Text, _fmu, "a shipped name, or a path relative to this file"] = "mecanum"
    timeout_s: Annotated[float, Range(ge=0.05, le=3600), "silence of a foreign FMU that counts as hung"] = 2.0
    memory_limit_mb: Annotated[
        float, Range(ge=50, le=1e6), "memory of a foreign FMU's process at which it is ended"
    ] = 2000.0
    map: Annotated[
        Mapping[Annotated[str, _signal_of_plant], MapRow],
        "the FMU's variables of the signals that it does not have by their own names",
    ] = field(default_factory=dict)
    start: Annotated[
        Mapping[Text, Start], "FMU variables where the truth differs from [robot], or that only the plant has"
    ] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = {signal: row if row.name else replace(row, name=signal) for signal, row in self.map.items()}
        object.__setattr__(self, "map", rows)
