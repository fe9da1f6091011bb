"""Reads an FMU's modelDescription.xml without running the FMU; also the data for ``hil fmu info``."""

import contextlib
import functools
import io
import itertools
import re
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError, nearest
from hil.plant import archive
from hil.plant.child_output import one_line
from hil.plant.communication import communication_step
from hil.plant.start import Value, start_of, start_values
from hil.plant.units import misfit
from plant_fmu import SHIPPED

_MOST_WRONG = 20


def read_description(fmu: Path) -> Any:
    """Return FMPy's model description. Raises BadInputError when the file is no FMU that can be read.

    FMPy gets only the XML that was checked here, because FMPy itself does not check files.
    """
    archive.read_header(fmu)
    with archive.extract(fmu, only=archive.DESCRIPTIONS.__contains__) as folder:
        try:
            return _read(folder)
        except _UnusableError as error:
            raise archive.BrokenFmuError(f"FMU {fmu}: its modelDescription.xml cannot be used ({error})") from error


class _UnusableError(Exception):
    """FMPy cannot read a description; says why."""


def _read(folder: Path) -> Any:
    """Return FMPy's model description of an unpacked FMU. Raises _UnusableError."""
    import_fmpy()
    from fmpy import read_model_description

    try:
        description = read_model_description(folder, validate=False)
    except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
        raise _UnusableError(one_line(str(error)) or type(error).__name__) from error
    unsigned = {v.name: v for v in description.modelVariables if v.type.startswith("UInt")}
    if unsigned:  # FMPy reads no ranges of theirs
        for element in ET.parse(folder / archive.DESCRIPTIONS[0]).iterfind("ModelVariables/*"):
            if (variable := unsigned.get(element.get("name", ""))) is not None:
                variable.min, variable.max = element.get("min"), element.get("max")
    return description


def _read_with_errors(fmu: Path) -> tuple[Any, tuple[str, ...]]:
    """Return FMPy's model description without the variables that cannot be read, and a sentence for each of them.

    Raises BadInputError as ``read_description`` does, when something else is wrong, or more than some variables.
    """
    try:
        return read_description(fmu), ()
    except archive.BrokenFmuError as error:
        try:
            return _read_the_rest(fmu, str(error))
        except _UnusableError:
            raise error from None


def _read_the_rest(fmu: Path, why: str) -> tuple[Any, tuple[str, ...]]:
    """Return as ``_read_with_errors``, of a description that cannot be read because of ``why``."""
    with archive.extract(fmu, only=archive.DESCRIPTIONS.__contains__) as folder:
        file = folder / archive.DESCRIPTIONS[0]
        tree = ET.parse(file)
        variables, structure = (tree.getroot().find(name) for name in ("ModelVariables", "ModelStructure"))
        if variables is None:
            raise _UnusableError
        every = list(variables)
        # What refers to other variables: these may be among those left out.
        if structure is not None:
            structure.clear()
        for element in variables.iter():
            for name in ("derivative", "clocks"):
                element.attrib.pop(name, None)

        def read(some: Sequence[ET.Element]) -> Any:
            variables[:] = list(some)
            tree.write(file)
            return _read(folder)

        def wrong(some: Sequence[ET.Element], beside: Sequence[ET.Element] = ()) -> Iterator[tuple[ET.Element, str]]:
            try:
                read([*beside, *some])
            except _UnusableError as error:
                if len(some) == 1:
                    yield some[0], re.sub(r" \(line \d+\)", "", str(error))  # the line is that of our copy
                    return
                middle = len(some) // 2
                yield from wrong(some[:middle], beside)
                yield from wrong(some[middle:], beside)

        read([])
        sizes = [one for one in every if one.get("causality") == "structuralParameter"]  # of the others' arrays
        bad = dict(wrong(sizes)) if sizes else {}
        sizes = [one for one in sizes if one not in bad]
        others = [one for one in every if one.get("causality") != "structuralParameter"]
        bad |= dict(itertools.islice(wrong(others, sizes), _MOST_WRONG + 1)) if others else {}
        if len(bad) > _MOST_WRONG:
            raise _UnusableError
        sentences = [f"the variable {one.get('name')!r} is left out: {reason}" for one, reason in bad.items()]
        return read([one for one in every if one not in bad]), tuple(sentences or [why])


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


def check_units(fmu: Path, names: Collection[str]) -> None:
    """Raise BadInputError with a line for each parameter of ours that the FMU has in another unit."""
    units = {unit.name: unit for unit in _description(fmu).unitDefinitions}
    variables = _variables(fmu)
    problems = [(name, words) for name in names if (words := misfit(name, variables[name], units)) is not None]
    if problems:
        raise BadInputError(
            "\n".join(
                f"plant.start.{name}: this parameter of {fmu.name} {words}, in which [robot] and [firmware] have it; "
                "give its value there in the FMU's own unit"
                for name, words in problems
            )
        )


def _variables(fmu: Path) -> dict[str, Any]:
    return variables_of(_description(fmu))


def _description(fmu: Path) -> Any:
    try:
        now = fmu.stat()
    except OSError as error:
        raise BadInputError(f"FMU {fmu} cannot be read ({error.strerror}); give the path of an .fmu file") from error
    return _description_in(fmu, (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _description_in(fmu: Path, _state: tuple[int, int]) -> Any:
    """Return the description, cached until the file changes: a process that makes many robots reads it once."""
    return read_description(fmu)


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
    the folders with binaries. ``wrong`` has a sentence for each variable that cannot be read and is left out, or for
    what else of the description cannot be.
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
    wrong: tuple[str, ...]


def info(fmu: Path, names: str = "*") -> FmuInfo:
    """Return the FMU's description, with the variable of this name, or those that match it with ``*`` and ``?``.

    Raises BadInputError when the file is not a readable FMU, and when no variable matches.
    """
    header = archive.read_header(fmu)
    digest = archive.sha256(fmu)
    description, wrong = _read_with_errors(fmu)
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
        wrong=wrong,
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
