"""``[plant]``: the FMU that simulates the robot, its variables, and where the simulated robot differs from [robot]."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from hil.core.clock import LONGEST_STEP_S
from hil.core.errors import nearest
from hil.core.options import Range
from hil.core.plant_signals import INPUTS, OUTPUTS
from hil.scenario.values import Axes3, Start, Text, Wheel, at_most_once, each_once, is_path, right_handed
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
    scale: Annotated[
        float | None, Range(gt=0), "units of the signal per unit of the variable; by default its unit says it"
    ] = None
    offset: Annotated[float, "value of the signal when the variable is 0"] = 0.0
    sign: Annotated[Literal[1, -1], "-1 if the FMU counts in the other direction"] = 1
    unit: Annotated[str | None, "the variable's unit in place of the FMU's; empty where none is to be compared"] = None


@dataclass(frozen=True)
class WiringTable:
    """``[plant.wiring]``: how the virtual robot is wired where that differs from [device]; the bridge does not know.

    Counts and rollers that differ are ``counts_per_revolution`` and ``rollers`` of [plant.start].
    """

    wheels: Annotated[tuple[Wheel, ...] | None, each_once, "the wheel that each motor output turns"] = None
    reversed: Annotated[tuple[Wheel, ...] | None, at_most_once, "wheels whose motor turns the other way"] = None
    encoders: Annotated[
        tuple[Wheel, ...] | None, each_once, "the wheel that each encoder input counts; by default its motor's"
    ] = None
    encoders_reversed: Annotated[tuple[Wheel, ...], at_most_once, "wheels whose encoder counts against its motor"] = ()
    imu: Annotated[Axes3 | None, right_handed, "the robot's axis along each axis of the IMU"] = None


@dataclass(frozen=True)
class PlantTable:
    """``[plant]``: the simulation that takes the place of a real robot."""

    fmu: Annotated[Text, _fmu, "a shipped name, or a path relative to this file"] = "mecanum"
    timeout_s: Annotated[float, Range(ge=0.05, le=3600), "silence after which a foreign FMU counts as hung"] = 2.0
    memory_limit_mb: Annotated[float, Range(ge=50, le=1e6), "memory above which a foreign FMU is ended"] = 2000.0
    step_s: Annotated[
        float | None, Range(gt=0, le=LONGEST_STEP_S), "communication step in place of the one that the FMU declares"
    ] = None
    map: Annotated[
        Mapping[Annotated[str, _signal_of_plant], MapRow],
        "the FMU's variables for signals whose names it does not have",
    ] = field(default_factory=dict)
    wiring: Annotated[WiringTable, "the virtual robot's wiring where it differs from [device]"] = WiringTable()
    start: Annotated[
        Mapping[Text, Start], "start values of FMU variables that differ from [robot], or that only the plant has"
    ] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows = {signal: row if row.name else replace(row, name=signal) for signal, row in self.map.items()}
        object.__setattr__(self, "map", rows)
