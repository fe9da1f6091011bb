"""What ``hil fmu info`` and ``hil fmu check`` find out about an FMU.

``info`` reads the description. ``check`` also runs the FMU, in a process of its own: a foreign FMU may crash
or hang.
"""

import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from hil.errors import BadInputError
from hil.plant import archive

_LONGEST_CHECK_S = 120.0


@dataclass(frozen=True)
class VariableInfo:
    """A scalar variable as modelDescription.xml gives it; None where it says nothing."""

    name: str
    causality: str
    variability: str
    type: str
    unit: str | None
    start: str | None
    description: str | None


@dataclass(frozen=True)
class FmuInfo:
    """An FMU as it describes itself. ``shipped`` says that it is the one of this package."""

    path: Path
    sha256: str
    shipped: bool
    fmi_version: str
    model_name: str
    description: str | None
    co_simulation: str | None  # the model identifier, None when there is no such interface
    model_exchange: str | None
    capabilities: tuple[str, ...]
    platforms: tuple[str, ...]
    variables: tuple[VariableInfo, ...]


def info(fmu: Path) -> FmuInfo:
    """Return what the FMU says of itself. Raises BadInputError when the file is no readable FMU."""
    header = archive.read_header(fmu)
    from fmpy import read_model_description, supported_platforms

    try:
        description = read_model_description(fmu, validate=False)
    except Exception as error:  # FMPy raises whatever its parser meets, down to plain Exception
        raise BadInputError(f"FMU {fmu}: its modelDescription.xml cannot be used ({error})") from error
    slave = description.coSimulation
    claims = ("canHandleVariableCommunicationStepSize", "canGetAndSetFMUstate", "canSerializeFMUstate")
    return FmuInfo(
        path=fmu,
        sha256=archive.sha256(fmu),
        shipped=archive.is_shipped(fmu),
        fmi_version=header.fmi_version,
        model_name=description.modelName,
        description=description.description,
        co_simulation=header.co_simulation,
        model_exchange=header.model_exchange,
        capabilities=tuple(claim for claim in claims if getattr(slave, claim, False)),
        platforms=tuple(dict.fromkeys(supported_platforms(str(fmu)))),
        variables=tuple(
            VariableInfo(v.name, v.causality, v.variability, v.type, v.unit, v.start, v.description)
            for v in description.modelVariables
        ),
    )


def check(fmu: Path, longest_s: float = _LONGEST_CHECK_S) -> list[str]:
    """Return every problem found, none for a good FMU, one sentence each.

    First FMPy's validator on the description; then, for FMI 2.0 co-simulation with a library for this
    platform, a run of every call and claim (``hil.plant.conformance``). Raises BadInputError when it is no FMU.
    """
    archive.read_header(fmu)
    from fmpy.validation import validate_fmu

    problems = [f"modelDescription.xml: {' '.join(problem.split())}" for problem in validate_fmu(str(fmu))]
    try:
        archive.library_of(fmu)
    except BadInputError as error:
        return [*problems, f"not run: {error}"]
    return problems + _run(fmu, longest_s)


def _run(fmu: Path, longest_s: float) -> list[str]:
    folder = archive.extract(fmu)
    with tempfile.TemporaryDirectory(prefix="hil_fmu_check_") as scratch:
        results = Path(scratch) / "results"
        results.touch()
        command = [sys.executable, "-m", "hil.plant.conformance", str(folder), str(results)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=longest_s, check=False
            )
            end = _ending(done)
        except subprocess.TimeoutExpired:
            end = f"did not return within {longest_s:g} s"
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        lines = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    problems = [f"{line['part']}: {line['problem']}" for line in lines if "problem" in line]
    if end is not None:
        part = lines[-1]["part"] if lines else "load"
        problems.append(f"{part}: the FMU {end}")
    return problems


def _ending(done: subprocess.CompletedProcess[str]) -> str | None:
    if done.returncode < 0:
        return f"crashed its process (signal {-done.returncode})"
    if done.returncode:
        words = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        return f"ended its process ({words[-1]})"
    return None
