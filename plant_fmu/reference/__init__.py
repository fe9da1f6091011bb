"""Reference results: experiments with the FMU whose outcome is kept, for importers and for our own tests.

cases.toml defines them. ``python -m plant_fmu.reference`` writes the results or checks the FMUs against them.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import simulate_fmu
from fmpy.util import read_csv, write_csv

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Case:
    """One experiment; see cases.toml for the fields."""

    name: str
    description: str
    stop_s: float
    step_s: float
    tolerance: float
    start: dict[str, float]
    outputs: list[str]

    @property
    def inputs(self) -> Path | None:
        """The file with the inputs over time; None when every input keeps its start value."""
        path = HERE / f"{self.name}_in.csv"
        return path if path.exists() else None

    @property
    def results(self) -> Path:
        """The file with the results."""
        return HERE / f"{self.name}_ref.csv"


@dataclass(frozen=True)
class Deviation:
    """Where a run is farthest from the reference, measured in the column's largest magnitude (at least 1e-3)."""

    column: str
    time_s: float
    size: float


def read_cases() -> dict[str, Case]:
    """Return the experiments by name."""
    data = tomllib.loads((HERE / "cases.toml").read_text(encoding="utf-8"))
    return {name: Case(name=name, **fields) for name, fields in data.items()}


def run(case: Case, fmu: Path) -> Any:
    """Run a case with FMPy and return the results, a NumPy array with one field a column, ``time`` the first.

    Raises FMPy's exceptions when the FMU cannot be run.
    """
    return simulate_fmu(
        str(fmu),
        stop_time=case.stop_s,
        output_interval=case.step_s,
        start_values=case.start,
        input=None if case.inputs is None else read_csv(str(case.inputs)),
        output=case.outputs,
    )


def write(case: Case, results: Any) -> None:
    """Keep the results of a run as the reference."""
    write_csv(str(case.results), results, columns=case.outputs)


def largest_deviation(case: Case, results: Any) -> Deviation:
    """Compare a run with the reference. Raises ValueError when the two have not the same rows and columns."""
    reference = read_csv(str(case.results))
    same = reference.dtype.names == results.dtype.names and len(reference) == len(results)
    if not same or np.abs(reference["time"] - results["time"]).max() > 1e-9:
        raise ValueError(f"{case.results.name} has other rows or columns than a run of {case.name}; write it anew")
    return max((_deviation(column, reference, results) for column in case.outputs), key=lambda found: found.size)


def _deviation(column: str, reference: Any, results: Any) -> Deviation:
    scale = max(float(np.abs(reference[column]).max()), 1e-3)
    difference = np.abs(results[column] - reference[column]) / scale
    difference[~np.isfinite(difference)] = np.inf  # a NaN is as far off as can be
    row = int(difference.argmax())
    return Deviation(column, float(reference["time"][row]), float(difference[row]))
