"""Reads variables.toml, the only definition of the plant's variables. Needs the standard library only."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
STRUCTURE = {"input": "inputs", "output": "outputs", "parameter": "parameters"}  # C member, by causality
TIME = "time"  # the independent variable, after all others; not in variables.toml, because every model has it
_VARIABILITY = {"input": "continuous", "output": "continuous", "parameter": "fixed"}


class DefinitionError(Exception):
    """variables.toml does not define a model; the message names the variable."""


@dataclass(frozen=True)
class Variable:
    """One scalar variable; its place in the list is its value reference."""

    name: str
    type: str
    causality: str
    variability: str
    description: str
    field: str  # the member of its C structure, without an index
    wheel: int | None = None  # the index into that member
    unit: str | None = None
    display_unit: str | None = None  # the unit in which people think of it
    start: float | int | None = None
    minimum: float | int | None = None
    maximum: float | int | None = None
    depends_on: tuple[str, ...] = ()  # inputs with direct feedthrough

    @property
    def member(self) -> str:
        """The C expression of the value within an instance's snapshot."""
        if self.causality == "independent":
            return self.field
        index = "" if self.wheel is None else f"[{self.wheel}]"
        return f"{STRUCTURE[self.causality]}.{self.field}{index}"


@dataclass(frozen=True)
class Definition:
    """variables.toml, checked and expanded to scalar variables; the last one is the independent variable."""

    model: dict[str, Any]
    wheels: dict[str, str]
    units: dict[str, dict[str, int]]
    display_units: dict[str, dict[str, float]]  # of a unit: by name, how many of them make one of the unit
    enumerations: dict[str, dict[str, Any]]
    variables: tuple[Variable, ...]

    @property
    def references(self) -> dict[str, int]:
        """The value reference of every variable by its name; the same in both FMI versions."""
        return {variable.name: reference for reference, variable in enumerate(self.variables)}


def read(path: Path = HERE / "variables.toml") -> Definition:
    """Read and check the definition. Raises DefinitionError, naming the variable."""
    return define(tomllib.loads(path.read_text(encoding="utf-8")))


def define(data: dict[str, Any]) -> Definition:
    """Check the definition and expand it. Raises DefinitionError, naming the variable."""
    variables: list[Variable] = []
    for entry in data["variable"]:
        wheels: list[str | None] = [*data["wheels"]] if "*" in entry["name"] else [None]
        variables += [_variable(entry, wheel, data) for wheel in wheels]
    time = Variable(TIME, "Real", "independent", "continuous", "Time that the instance has reached", "time_s", unit="s")
    variables.append(time)
    names = [variable.name for variable in variables]
    for variable in variables:
        if names.count(variable.name) > 1:
            raise DefinitionError(f"variable {variable.name!r} is defined twice")
        if unknown := set(variable.depends_on) - set(names):
            raise DefinitionError(f"{variable.name}: depends_on names the unknown {min(unknown)!r}")
    return Definition(
        data["model"], data["wheels"], data["units"], data["display_units"], data["enumerations"], tuple(variables)
    )


def _variable(entry: dict[str, Any], wheel: str | None, data: dict[str, Any]) -> Variable:
    name, causality, kind = entry["name"], entry["causality"], entry.get("type", "Real")
    if causality not in STRUCTURE:
        raise DefinitionError(f"{name}: causality {causality!r}; expected one of {', '.join(STRUCTURE)}")
    if entry.get("unit") is not None and entry["unit"] not in data["units"]:
        raise DefinitionError(f"{name}: unit {entry['unit']!r} is not in [units]")
    shown = entry.get("display_unit")
    if shown is not None and shown not in data["display_units"].get(entry.get("unit"), {}):
        raise DefinitionError(f"{name}: display_unit {shown!r} is not in [display_units] of its unit")
    if (entry.get("start") is None) != (causality == "output"):
        raise DefinitionError(f"{name}: an input or a parameter needs a start value, an output has none")
    minimum, maximum = entry.get("min"), entry.get("max")
    if kind == "Enumeration":
        minimum, maximum = 1, len(data["enumerations"][name]["items"])
    return Variable(
        name=name.replace("*", wheel or ""),
        type=kind,
        causality=causality,
        variability=entry.get("variability", _VARIABILITY[causality]),
        unit=entry.get("unit"),
        display_unit=entry.get("display_unit"),
        start=entry.get("start"),
        minimum=minimum,
        maximum=maximum,
        description=entry["description"].format(wheel=data["wheels"].get(wheel, "")),
        depends_on=tuple(name.replace("*", wheel or "") for name in entry.get("depends_on", ())),
        field=name.replace(".*.", "_").replace(".", "_"),
        wheel=None if wheel is None else list(data["wheels"]).index(wheel),
    )
