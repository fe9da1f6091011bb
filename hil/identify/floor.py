"""The FMU as the model of windows on the floor: its parameters, and the twist with which each window begins."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hil.core.types import WHEEL_NAMES
from hil.identify import robust
from hil.identify.recorded import Array
from hil.identify.windows import MEASURED, Windows, mean_of_samples
from hil.plant.mapping import SignalMap
from hil.plant.signals import SPEEDS
from hil.plant.start import Value
from hil.plant.windows import WindowStepper

TWIST = ("start_vx_m_s", "start_vy_m_s", "start_yaw_rate_rad_s")
"""The variables of our FMUs that give the twist at the start."""
_TWIST_STEPS = np.array([1e-3, 1e-3, 3e-3])
_SEEN = (*SPEEDS, "gyro.z_rad_s")
_LEAST_SIGMA = np.array([*[3e-3] * len(WHEEL_NAMES), 1e-3])
_SENSORS = np.array([*[0.015] * len(WHEEL_NAMES), 0.004])  # encoders of 4096 counts, a gyro of 0.01 rad/s, in 50 ms


class Parameter(NamedTuple):
    """A number that is fitted: its logarithm, or where ``unit`` is given the number in this unit.

    ``variables`` are the FMU's variables that follow from it, each with its factor; a gyro's bias has none.
    """

    name: str
    variables: Mapping[str, float]
    unit: float | None = None

    def internal(self, value: float) -> float:
        """Return the fit's number for a value."""
        return float(np.log(value)) if self.unit is None else value / self.unit

    def value(self, internal: Array | float) -> Array:
        """Return values for numbers of the fit."""
        return np.exp(internal) if self.unit is None else np.asarray(internal) * self.unit


def variable(name: str, unit: float | None = None) -> Parameter:
    """Return the parameter that is one variable of the FMU."""
    return Parameter(name, {name: 1.0}, unit)


GYRO_BIAS = Parameter("gyro_bias_rad_s", {}, 0.01)
"""The bias of the gyro; it is added to what the FMU's gyro shows."""


GAINS = tuple(Parameter(f"current_gain.{wheel}", {}) for wheel in WHEEL_NAMES)
OFFSETS = tuple(Parameter(f"current_offset.{wheel}_a", {}, 0.1) for wheel in WHEEL_NAMES)
"""True currents are gain times measured current, plus offset; all eight are in a fit's parameters, or none."""
STRETCH = Parameter("stretch_m", {"half_length_m": 1.0, "half_width_m": -1.0}, 0.05)
"""By how much half the length is larger than its believed share of the lever, and half the width smaller."""
NUISANCES = (GYRO_BIAS, *GAINS, *OFFSETS, STRETCH)
"""What is fitted so that the others are right, and is of no interest itself."""


def variables_of(parameters: Sequence[Parameter], numbers: Array) -> dict[str, Array]:
    """Return the FMU's variables for the fit's numbers, of shape (..., P): of each the sum over its parameters."""
    found: dict[str, Array] = {}
    for place, one in enumerate(parameters):
        for name, factor in one.variables.items():
            found[name] = found.get(name, np.zeros(())) + factor * one.value(numbers[..., place])
    return found


class Floor:
    """An ``Experiment`` (``linearised``): windows of a drive on the floor, predicted by an FMU.

    ``parameters`` are the fit's, in its order. ``start`` is shared by all windows. ``torque_constant_n_m_a`` turns
    currents into torques at the wheels. ``by_twist`` is False for an FMU whose twist at the start cannot be set: each
    window then begins at rest. ``step_ns`` is the FMU's communication step, by default a whole row. A context manager.

    Raises BadInputError as ``WindowStepper``.
    """

    def __init__(
        self,
        fmu: Path,
        start: Mapping[str, Value],
        parameters: Sequence[Parameter],
        windows: Windows,
        torque_constant_n_m_a: float,
        mapping: SignalMap | None = None,
        *,
        by_twist: bool = True,
        step_ns: int | None = None,
    ) -> None:
        self._parameters, self._windows = parameters, windows
        self._bias = parameters.index(GYRO_BIAS) if GYRO_BIAS in parameters else None
        self._currents = [parameters.index(one) for one in (*GAINS, *OFFSETS) if one in parameters]
        self._constant = torque_constant_n_m_a
        self.measured = windows.measured.reshape(len(windows.first), -1)
        count = len(TWIST) if by_twist else 0
        self.starts, self.start_steps = windows.twist[:, :count], _TWIST_STEPS[:count]
        self.least_sigmas = np.tile(_SENSORS, self.measured.shape[1] // MEASURED)
        names = list(dict.fromkeys(name for one in parameters for name in one.variables))
        row_ns = round(windows.period_s * 1e9)
        self._stepper = WindowStepper(
            fmu,
            {name: value for name, value in start.items() if name not in names},
            mapping,
            varied=[*names, *TWIST[:count]],
            outputs=_SEEN,
            step_ns=row_ns if step_ns is None else step_ns,
            steps_a_row=1 if step_ns is None else round(row_ns / step_ns),
        )

    def predict(self, parameters: Array, starts: Array) -> Array:
        """See ``Experiment``. A start is the body's twist, of shape (3,)."""
        sets, windows = len(parameters), len(self._windows.first)
        columns = variables_of(self._parameters, parameters)
        shared = np.repeat(np.stack(list(columns.values()), axis=1), windows, axis=0)
        cases = np.concatenate([shared, starts.reshape(sets * windows, -1)], axis=1)
        seen = self._stepper.run(*self._torques(parameters), cases)
        means = mean_of_samples(seen, self._windows.rows_a_bin).reshape(sets, windows, -1, MEASURED)
        if self._bias is not None:
            means[..., -1] += GYRO_BIAS.value(parameters[:, self._bias])[:, None, None]
        return means[:, :, -self._windows.measured.shape[1] :].reshape(sets, windows, -1)

    def _torques(self, parameters: Array) -> tuple[Array, npt.NDArray[np.intp]]:
        """Return windows of torques, by each different set of gains and offsets, and which belongs to each case."""
        torque = self._windows.current_a * self._constant
        windows = np.arange(len(torque))
        if not self._currents:
            return torque, np.tile(windows, len(parameters))
        different, which = np.unique(parameters[:, self._currents], axis=0, return_inverse=True)
        gains, offsets = GAINS[0].value(different[:, :4]), OFFSETS[0].value(different[:, 4:])
        torques = gains[:, None, None] * torque + offsets[:, None, None] * self._constant
        cases = which.reshape(-1, 1) * len(windows) + windows
        return torques.reshape(-1, *torque.shape[1:]), cases.ravel()

    def sigmas(self, residual: Array) -> Array:
        """Return robust standard deviations: one for the wheels, one for the gyro."""
        by_kind = residual.reshape(-1, MEASURED)
        wheels, gyro = robust.sigma(by_kind[:, :-1]), robust.sigma(by_kind[:, -1])
        each = np.maximum([*[wheels] * len(WHEEL_NAMES), gyro], _LEAST_SIGMA)
        return np.tile(each, residual.shape[1] // MEASURED)

    def close(self) -> None:
        """Free the FMU."""
        self._stepper.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
