"""What an FMU's description says, without running anything of the FMU."""

from pathlib import Path

from hil.errors import BadInputError
from hil.plant import archive


def parameter_names(fmu: Path) -> frozenset[str]:
    """Return the names of the FMU's parameters. Raises BadInputError when the file is no readable FMU."""
    archive.read_header(fmu)
    from fmpy import read_model_description

    try:
        variables = read_model_description(fmu, validate=False).modelVariables
    except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
        raise BadInputError(f"FMU {fmu}: its modelDescription.xml cannot be used ({error})") from error
    return frozenset(variable.name for variable in variables if variable.causality == "parameter")
