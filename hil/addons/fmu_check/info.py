"""What ``hil fmu info`` shows of an FMU's description. None of its code is run."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.plant import archive
from hil.plant.communication import communication_step
from hil.plant.description import read_description
from plant_fmu import SHIPPED


@dataclass(frozen=True)
class VariableInfo:
    """A variable as in modelDescription.xml, with start and range as text; None for what is not given.

    ``dimensions`` are an array's start sizes, empty for a scalar; ``items`` an enumeration's names and numbers.
    """

    name: str
    causality: str
    variability: str
    type: str
    dimensions: tuple[int, ...]
    unit: str | None
    start: str | None
    min: str | None
    max: str | None
    items: tuple[tuple[str, str], ...]
    description: str | None


@dataclass(frozen=True)
class FmuInfo:
    """The content of an FMU's description. ``shipped`` is its name if it is, byte for byte, one of this package.

    ``about`` has description, author, version, license, copyright and tool, as far as given; ``experiment`` likewise
    start, stop, step and tolerance. ``interfaces`` has the model identifier of each interface, ``capabilities`` its
    declared capabilities. ``step`` says by which communication step a run steps it, or why by none. ``platforms`` are
    the folders with binaries.
    """

    path: Path
    sha256: str
    shipped: str | None
    fmi_version: str
    model_name: str
    about: Mapping[str, str]
    experiment: Mapping[str, str]
    interfaces: Mapping[str, str]
    capabilities: Mapping[str, tuple[str, ...]]
    step: str
    platforms: tuple[str, ...]
    variables: tuple[VariableInfo, ...]


def info(fmu: Path, names: str = "*") -> FmuInfo:
    """Return the FMU's description, with the variable of this name, or those that match it with ``*`` and ``?``.

    Raises BadInputError when the file is not a readable FMU, and when no variable matches.
    """
    header = archive.read_header(fmu)
    digest = archive.sha256(fmu)
    description = read_description(fmu)
    variables = description.modelVariables
    pattern = re.compile(re.escape(names).replace(r"\*", ".*").replace(r"\?", "."), re.DOTALL)
    exact = [v for v in variables if v.name == names]  # brackets are those of an array's element
    fitting = exact or [v for v in variables if pattern.fullmatch(v.name)]
    if variables and not fitting:
        hint = "" if any(sign in names for sign in "*?") else nearest(names, [v.name for v in variables])
        raise BadInputError(f"FMU {fmu}: no variable fits {names!r}{hint}")
    experiment = description.defaultExperiment
    shipped = (name for name, path in SHIPPED.items() if path.is_file() and archive.sha256(path) == digest)
    return FmuInfo(
        path=fmu,
        sha256=digest,
        shipped=next(shipped, None),
        fmi_version=header.fmi_version,
        model_name=description.modelName or "",
        about=_given(description, "description", "author", "version", "license", "copyright", tool="generationTool"),
        experiment=_given(experiment, "tolerance", start="startTime", stop="stopTime", step="stepSize"),
        interfaces={name: attributes.get("modelIdentifier", "") for name, attributes in header.interfaces.items()},
        capabilities={name: _capabilities(attributes) for name, attributes in header.interfaces.items()},
        step=_step(fmu, description),
        platforms=archive.platforms(fmu),
        variables=tuple(_variable(v) for v in fitting),
    )


def _step(fmu: Path, description: Any) -> str:
    if description.coSimulation is None:
        return "none: it is not for co-simulation, so it cannot run here"
    try:
        step = communication_step(fmu, description)
    except BadInputError as error:
        return str(error)
    return step.notice or f"stepped by the tick of {step.size_ns / 1e9:g} s"


def _variable(v: Any) -> VariableInfo:
    declared = v.declaredType
    return VariableInfo(
        name=v.name,
        causality=v.causality,
        variability=v.variability,
        type=v.type,
        dimensions=tuple(v.shape or ()),
        unit=v.unit or getattr(declared, "unit", None),
        start=v.start,
        min=v.min or getattr(declared, "min", None),
        max=v.max or getattr(declared, "max", None),
        items=tuple((item.name, item.value) for item in declared.items) if declared is not None else (),
        description=v.description or getattr(declared, "description", None),
    )


def _given(thing: object, *attributes: str, **renamed: str) -> dict[str, str]:
    names = {attribute: attribute for attribute in attributes} | renamed
    found = {name: getattr(thing, attribute, None) for name, attribute in names.items()}
    return {name: str(value) for name, value in found.items() if value}


def _capabilities(attributes: Mapping[str, str]) -> tuple[str, ...]:
    """Return the capabilities of an interface that are not false or 0, with the value unless it is true."""
    claims = {name: value for name, value in attributes.items() if name != "modelIdentifier"}
    return tuple(
        name if value in ("true", "1") else f"{name}={value}"
        for name, value in claims.items()
        if value not in ("false", "0")
    )
