"""Reads an FMU's modelDescription.xml without running the FMU."""

import contextlib
import functools
import io
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.child_output import one_line
from hil.plant.start import Value, start_of, start_values
from hil.plant.units import misfit


def read_description(fmu: Path) -> Any:
    """Return FMPy's model description. Raises BadInputError when the file is no FMU that can be read.

    FMPy gets only the XML that was checked here, because FMPy itself does not check files.
    """
    archive.read_header(fmu)
    with archive.extract(fmu, only=archive.DESCRIPTIONS.__contains__) as folder:
        try:
            return read_unpacked(folder)
        except UnusableError as error:
            raise archive.BrokenFmuError(f"FMU {fmu}: its modelDescription.xml cannot be used ({error})") from error


class UnusableError(Exception):
    """FMPy cannot read a description; says why."""


def read_unpacked(folder: Path) -> Any:
    """Return FMPy's model description of an unpacked FMU. Raises UnusableError."""
    import_fmpy()
    from fmpy import read_model_description

    try:
        description = read_model_description(folder, validate=False)
    except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
        raise UnusableError(one_line(str(error)) or type(error).__name__) from error
    unsigned = {v.name: v for v in description.modelVariables if v.type.startswith("UInt")}
    if unsigned:  # FMPy reads no ranges of theirs
        for element in ET.parse(folder / archive.DESCRIPTIONS[0]).iterfind("ModelVariables/*"):
            if (variable := unsigned.get(element.get("name", ""))) is not None:
                variable.min, variable.max = element.get("min"), element.get("max")
    return description


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
