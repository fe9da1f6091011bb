"""Reads an FMU's modelDescription.xml, without running anything of the FMU."""

import functools
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.core.errors import BadInputError
from hil.plant import archive
from hil.plant.start import Value, start_values
from hil.plant.words import one_line


def read_description(fmu: Path) -> Any:
    """Return FMPy's model description. Raises BadInputError when the file is no FMU that can be read.

    FMPy sees the checked XML alone: what it opens by itself it does not check.
    """
    archive.read_header(fmu)
    from fmpy import read_model_description

    folder = archive.extract(fmu, only=archive.DESCRIPTIONS)
    try:
        return read_model_description(folder, validate=False)
    except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
        reason = one_line(str(error)) or type(error).__name__
        raise archive.BrokenFmuError(f"FMU {fmu}: its modelDescription.xml cannot be used ({reason})") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def variables_of(description: Any) -> dict[str, Any]:
    """Return FMPy's variables by name, and by alias."""
    variables = {variable.name: variable for variable in description.modelVariables}
    for variable in description.modelVariables:
        for alias in variable.aliases:
            variables.setdefault(alias.name, variable)
    return variables


def parameter_names(fmu: Path) -> frozenset[str]:
    """Return the names of the FMU's parameters. Raises BadInputError when the file is no readable FMU."""
    named = _variables(fmu).items()
    return frozenset(name for name, one in named if name == one.name and one.causality == "parameter")


def check_start(fmu: Path, start: Mapping[str, Value]) -> None:
    """Raise BadInputError, with a line for each, for start values that do not fit the FMU, which is not opened."""
    start_values(start, fmu, _variables(fmu))


def _variables(fmu: Path) -> dict[str, Any]:
    try:
        now = fmu.stat()
    except OSError as error:
        raise BadInputError(f"FMU {fmu} cannot be read ({error.strerror}); give the path of an .fmu file") from error
    return _variables_in(fmu, (now.st_mtime_ns, now.st_size))


@functools.lru_cache
def _variables_in(fmu: Path, _state: tuple[int, int]) -> dict[str, Any]:
    """Return the variables as long as the file is as it was: a process that makes many robots reads it once."""
    return variables_of(read_description(fmu))
