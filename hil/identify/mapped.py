"""Fits named parameters of any FMU that a scenario maps: the FMU itself is the model, whatever is inside it.

An FMU of ours begins each window with a twist of its own. One whose twist at the start cannot be set is stepped from
rest through the beginning of each drive.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.core.clock import TICK_NS
from hil.core.errors import BadInputError
from hil.identify.estimates import WIDE, Estimate
from hil.identify.fit import WITHOUT_BLOCKS
from hil.identify.floor import TWIST, Floor, Parameter
from hil.identify.gauss_newton import Knowledge, solve
from hil.identify.recorded import Array, Drive
from hil.identify.robust import Z_95
from hil.identify.windows import BIN_S, MEASURED, SETTLING_BINS, Windows, cut
from hil.plant import archive
from hil.plant.description import read_description, variables_of
from hil.plant.mapping import SignalMap
from hil.plant.start import Value, limits, start_of, start_values
from hil.runtime.robots import plant_start, signal_map
from hil.scenario import Scenario

_FROM_REST_S = 12.0
_REST_RAD_S = 0.1
_LOGARITHM = 8.0  # the widest range, of a logarithm
_ZERO_UNIT = 0.01


class MappedFit(NamedTuple):
    """What was found, and the error of the wheel speeds over a held-out drive, before and after [rad/s, rms]."""

    estimates: tuple[Estimate, ...]
    before_rad_s: float
    after_rad_s: float


class _Model(NamedTuple):
    """The FMU of a scenario: its file, start values and map, and what turns a current into torque."""

    fmu: Path
    start: Mapping[str, Value]
    mapping: SignalMap
    torque_constant_n_m_a: float
    by_twist: bool

    def experiment(self, parameters: Sequence[Parameter], drive: Drive) -> Floor:
        """Return the windows of a drive with this FMU as their model."""
        windows = cut(drive, drive.robot, settling_bins=SETTLING_BINS) if self.by_twist else _from_rest(drive)
        constant = self.torque_constant_n_m_a
        return Floor(
            self.fmu, self.start, parameters, windows, constant, self.mapping, by_twist=self.by_twist, step_ns=TICK_NS
        )


def fit_mapped(floor: Sequence[Drive], held_out: Drive, scenario: Scenario, names: Sequence[str]) -> MappedFit:
    """Fit parameters of a scenario's FMU, by name, to drives; the others keep the scenario's values.

    The drives need motor currents. Raises BadInputError for a name that the FMU does not have or that is no
    floating-point start value, and DeviceError when the FMU fails.
    """
    for drive in (*floor, held_out):
        if not drive.has_currents:
            raise BadInputError(f"{drive.path}: the robot measured no currents; an FMU is driven by torque")
    fmu = archive.locate(scenario.plant.fmu, scenario.directory)
    variables = variables_of(read_description(fmu))
    start = plant_start(scenario, archive.read_header(fmu).parameters)
    model = _Model(
        fmu,
        start,
        signal_map(scenario),
        scenario.firmware.torque_constant_n_m_a,
        variables.keys() >= set(TWIST),
    )
    both = [_parameter(name, start, fmu, variables) for name in names]
    parameters = [parameter for parameter, _ in both]
    point = np.array([parameter.internal(value) for parameter, value in both])
    bounds = tuple(np.array(ends) for ends in zip(*map(_bounds, both, [variables[n] for n in names]), strict=True))
    with ExitStack() as opened:
        experiments = [opened.enter_context(model.experiment(parameters, drive)) for drive in floor]
        solution = solve(experiments, point, bounds=(bounds[0], bounds[1]), known=Knowledge.none(len(names)))
        judge = opened.enter_context(model.experiment(parameters, held_out))
        before, after = (_error_rad_s(judge, numbers) for numbers in (point, solution.parameters))
    found = tuple(
        _estimate(parameter, float(number), float(np.sqrt(variance)))
        for parameter, number, variance in zip(
            parameters, solution.parameters, np.diag(solution.covariance), strict=True
        )
    )
    return MappedFit(found, before, after)


def _parameter(
    name: str, start: Mapping[str, Value], fmu: Path, variables: Mapping[str, Any]
) -> tuple[Parameter, float]:
    """Return a parameter and the value with which its fit begins."""
    variable = variables.get(name)
    usual = None if variable is None else start_of(variable)
    given = start.get(name, 0.0 if usual is None else usual)
    start_values({name: given}, fmu, variables)  # refuses what cannot be set
    if isinstance(given, bool | str):
        raise BadInputError(f"--parameter {name}: it is {given!r}; expected a number")
    value = float(given)
    low, _ = limits(variable)
    is_positive = value > 0.0 and low >= 0.0
    unit = None if is_positive else abs(value) or _ZERO_UNIT
    return Parameter(name, {name: 1.0}, unit), value


def _bounds(both: tuple[Parameter, float], variable: Any) -> tuple[float, float]:
    parameter, value = both
    low, high = limits(variable)
    middle = parameter.internal(value)
    if parameter.unit is None:
        least = parameter.internal(low) if low > 0.0 else -np.inf
        most = parameter.internal(high) if np.isfinite(high) else np.inf
        return max(least, middle - _LOGARITHM), min(most, middle + _LOGARITHM)
    return low / parameter.unit, high / parameter.unit


def _from_rest(drive: Drive) -> Windows:
    """Return the beginning of a drive as one window. Raises BadInputError when the robot did not begin at rest."""
    if np.abs(drive.speed_rad_s[:3]).max() > _REST_RAD_S:
        raise BadInputError(
            f"{drive.path}: the robot moves at the beginning; expected rest, because this FMU's twist at the start "
            f"cannot be set: it has no {', '.join(TWIST)}"
        )
    whole_s = (len(drive.time_s) - 4) * drive.period_s - BIN_S  # a window is rounded to whole bins
    return cut(drive, drive.robot, window_s=min(_FROM_REST_S, whole_s)).thinned(1)


def _error_rad_s(experiment: Floor, parameters: Array) -> float:
    predicted = experiment.predict(parameters[None], experiment.starts[None])[0]
    off = (experiment.measured - predicted).reshape(-1, MEASURED)[:, :-1]
    return float(np.sqrt(np.mean(off**2)))


def _estimate(parameter: Parameter, number: float, sigma: float) -> Estimate:
    half = Z_95 * WITHOUT_BLOCKS * sigma
    low, value, high = (float(parameter.value(number + sign * half)) for sign in (-1.0, 0.0, 1.0))
    if half > WIDE:
        return Estimate(parameter.name, value, low, high, "effective", "its interval is wide")
    return Estimate(parameter.name, value, low, high, "identified", "for the torque constant of the scenario")
