"""Reads an FMU's modelDescription.xml without running the FMU; also the data for ``hil fmu info``."""

import contextlib
import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.plant import archive
from hil.plant.child_output import one_line
from hil.plant.communication import communication_step
from hil.plant.start import Value, start_of, start_values
from plant_fmu import SHIPPED


def read_description(fmu: Path) -> Any:
    """Return FMPy's model description. Raises BadInputError when the file is no FMU that can be read.

    FMPy gets only the XML that was checked here, because FMPy itself does not check files.
    """
    archive.read_header(fmu)
    import_fmpy()
    from fmpy import read_model_description

    with archive.extract(fmu, only=archive.DESCRIPTIONS.__contains__) as folder:
        try:
            return read_model_description(folder, validate=False)
        except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
            reason = one_line(str(error)) or type(error).__name__
            raise archive.BrokenFmuError(f"FMU {fmu}: its modelDescription.xml cannot be used ({reason})") from error


def import_fmpy() -> None:
    """Import FMPy. Where it has no library for the FMU's messages, as on ARM64, it would say so on stdout.

    We pass messages on by ourselves, and stdout may be the JSON of a run.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        import fmpy.fmi1
        import fmpy.fmi2  # noqa: F401


def variables_of(description: Any) -> dict[str, Any]:
    """Return FMPy's variables by name, and by alias."""
    variables = {variable.name: variable for variable in description.modelVariables}
    for variable in description.modelVariables:
        for alias in variable.aliases:
            variables.setdefault(alias.name, variable)
    return variables


def start_defaults(fmu: Path) -> dict[str, Value]:
    """Return the FMU's own start value of each scalar parameter that has one, by name and in its type.

    Those of arrays and of binaries are left out, as [plant.start] cannot set them. Raises BadInputError.
    """
    found = {}
    for name, variable in _variables(fmu).items():
        is_ours = variable.causality == "parameter" and name == variable.name and variable.type != "Binary"
        if is_ours and (start := start_of(variable)) is not None:
            found[name] = start
    return found


def check_start(fmu: Path, start: Mapping[str, Value]) -> None:
    """Raise BadInputError, with a line for each start value that does not fit the FMU. The FMU's code is not run."""
    start_values(start, fmu, _variables(fmu))


def _variables(fmu: Path) -> dict[str, Any]:
    try:
        now = fmu.stat()
    except OSError as error:
        raise BadInputError(f"FMU {fmu} cannot be read ({error.strerror}); give the path of an .fmu file") from error
    return _variables_in(fmu, (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _variables_in(fmu: Path, _state: tuple[int, int]) -> dict[str, Any]:
    """Return the variables, cached until the file changes: a process that makes many robots reads it once."""
    return variables_of(read_description(fmu))


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
    """Return the FMU's description, with the variables whose names match the pattern ``names``.

    Raises BadInputError when the file is not a readable FMU, and when no variable matches.
    """
    header = archive.read_header(fmu)
    digest = archive.sha256(fmu)
    description = read_description(fmu)
    variables = description.modelVariables
    fitting = [v for v in variables if fnmatchcase(v.name, names)]
    if variables and not fitting:
        hint = "" if any(sign in names for sign in "*?[") else nearest(names, [v.name for v in variables])
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
        return "none: it is for model exchange, which is integrated here"
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
