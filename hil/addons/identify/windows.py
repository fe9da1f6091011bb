"""A drive in windows of half a second, and the FMU as their model: its parameters, and each window's first twist.

A window has the measurements in short bins. It is short so that errors of the model do not add up, and its start is
free: it is a guess from the wheels here, and is fitted with everything else (``gauss_newton``).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt

import plant_fmu
from hil.addons.identify import robust_statistics as robust
from hil.addons.identify.drives import Array, Drive, integral
from hil.core.kinematics import body_twist
from hil.core.model import RobotModel
from hil.core.plant_signals import SPEEDS
from hil.core.types import WHEEL_NAMES, Wheels
from hil.plant.start import Value
from hil.plant.window_stepper import WindowStepper

WINDOW_S = 0.5
BIN_S = 0.05
SETTLING_BINS = 1
"""How many bins a model with elastic contacts is stepped before it is compared: it begins with contacts unbent."""
MEASURED = 5
"""What a bin has: the mean speeds of the four wheels [rad/s], and the mean yaw rate [rad/s]."""


class Windows(NamedTuple):
    """W windows of R rows, of which those of the last B bins are compared.

    Attributes:
        current_a: (W, R, 4), the mean over each row.
        measured: (W, B, 5), see ``MEASURED``.
        twist: (W, 3), a guess of the twist at the start, in the body's frame: m/s, m/s, rad/s.
        first: (W,) the feedback of the drive at which each begins.
        rows_a_bin: rows of a bin.
        period_s: duration of a row.
    """

    current_a: Array
    measured: Array
    twist: Array
    first: npt.NDArray[np.intp]
    rows_a_bin: int
    period_s: float

    def thinned(self, count: int) -> "Windows":
        """Return at most so many windows, evenly spread."""
        if len(self.first) <= count:
            return self
        kept = np.linspace(0, len(self.first) - 1, count).round().astype(np.intp)
        four = (self.current_a[kept], self.measured[kept], self.twist[kept], self.first[kept])
        return Windows(*four, self.rows_a_bin, self.period_s)


def cut(drive: Drive, robot: RobotModel, window_s: float = WINDOW_S, settling_bins: int = 0) -> Windows:
    """Cut a drive into windows, each beginning where the one before ends; a shorter rest at the end is not used.

    A window has ``settling_bins`` bins that are only stepped through, and then ``window_s`` [s] that are compared.
    ``robot`` gives radius and lever, by which the twist at the start of each is guessed from the wheels.
    """
    rows_a_bin = max(1, round(BIN_S / drive.period_s))
    rows = rows_a_bin * (settling_bins + max(1, round(window_s / drive.period_s / rows_a_bin)))
    # One row at either end has no speed on both of its sides.
    first = np.arange(1, len(drive.time_s) - rows - 1, rows)
    places = first[:, None] + np.arange(rows + 1)
    ends = places[:, ::rows_a_bin]
    speeds = np.diff(drive.angle_rad[ends], axis=1) / (rows_a_bin * drive.period_s)
    yaw_rate = mean_of_samples(drive.yaw_rate_rad_s[places][..., None], rows_a_bin)
    return Windows(
        drive.current_a[places[:, 1:]],
        np.concatenate([speeds, yaw_rate], axis=2)[:, settling_bins:],
        twists(drive.speed_rad_s[first], robot),
        first,
        rows_a_bin,
        drive.period_s,
    )


def mean_of_samples(samples: Array, rows_a_bin: int) -> Array:
    """Return the means over bins, of shape (W, B, n), of samples at the ends of rows, of shape (W, R + 1, n).

    The trapezoidal rule: a sample between two bins counts half in each.
    """
    middle = 0.5 * (samples[:, 1:] + samples[:, :-1])
    windows, rows, count = middle.shape
    mean: Array = middle.reshape(windows, rows // rows_a_bin, rows_a_bin, count).mean(axis=2)
    return mean


def twists(speed_rad_s: Array, robot: RobotModel) -> Array:
    """Return the body twists that fit wheel speeds of shape (n, 4) best, of shape (n, 3)."""
    found = body_twist(Wheels(*speed_rad_s.T), robot.wheel_radius_m, robot.lever_m)
    return np.stack(found, axis=1)


def rolled(drive: Drive, robot: RobotModel, gyro_bias_rad_s: float) -> Array:
    """Return poses by wheels and gyro since the first feedback, of shape (n, 3): x, y [m], heading [rad]."""
    heading = integral(drive.yaw_rate_rad_s - gyro_bias_rad_s, drive.period_s)
    forward, left = legs(drive, heading)
    return np.concatenate([robot.wheel_radius_m * (forward + left), heading[:, None]], axis=1)


def legs(drive: Drive, heading: Array) -> tuple[Array, Array]:
    """Return the ways in the frame of the first feedback, rolled forward and sideways, each (n, 2), for r = 1."""
    steps = np.diff(drive.angle_rad, axis=0)
    forward, left = steps @ np.full(4, 0.25), steps @ (np.array([-1.0, 1.0, -1.0, 1.0]) / 4.0)
    middle = 0.5 * (heading[1:] + heading[:-1])
    along = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    aside = np.stack([-np.sin(middle), np.cos(middle)], axis=1)
    zero = np.zeros((1, 2))
    return (
        np.concatenate([zero, np.cumsum(along * forward[:, None], axis=0)]),
        np.concatenate([zero, np.cumsum(aside * left[:, None], axis=0)]),
    )


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


GYRO_BIAS = Parameter("gyro_bias_rad_s", {}, 0.01)  # the bias of the gyro; it is added to what the FMU's gyro shows


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
    """An ``Experiment`` (``linearised``): windows of a drive on the floor, predicted by our plant.

    ``parameters`` are the fit's, in its order. ``start`` is shared by all windows. ``torque_constant_n_m_a`` turns
    currents into torques at the wheels. A context manager.

    Raises BadInputError as ``WindowStepper``.
    """

    def __init__(
        self,
        start: Mapping[str, Value],
        parameters: Sequence[Parameter],
        windows: Windows,
        torque_constant_n_m_a: float,
    ) -> None:
        self._parameters, self._windows = parameters, windows
        self._bias = parameters.index(GYRO_BIAS) if GYRO_BIAS in parameters else None
        self._currents = [parameters.index(one) for one in (*GAINS, *OFFSETS) if one in parameters]
        self._constant = torque_constant_n_m_a
        self.measured = windows.measured.reshape(len(windows.first), -1)
        self.starts, self.start_steps = windows.twist, _TWIST_STEPS
        self.least_sigmas = np.tile(_SENSORS, self.measured.shape[1] // MEASURED)
        names = list(dict.fromkeys(name for one in parameters for name in one.variables))
        self._stepper = WindowStepper(
            plant_fmu.path(2),
            {name: value for name, value in start.items() if name not in names},
            varied=[*names, *TWIST],
            outputs=_SEEN,
            step_ns=round(windows.period_s * 1e9),
        )

    def predict(self, parameters: Array, starts: Array) -> Array:
        """See ``Experiment``. A start is the body's twist, of shape (3,)."""
        sets, windows = len(parameters), len(self._windows.first)
        columns = variables_of(self._parameters, parameters)
        shared = np.repeat(np.stack(list(columns.values()), axis=1), windows, axis=0)
        cases = np.concatenate([shared, starts.reshape(sets * windows, -1)], axis=1)
        torques = self._torques(parameters)
        seen = self._stepper.run(torques.reshape(len(cases), *torques.shape[2:]), np.arange(len(cases)), cases)
        means = mean_of_samples(seen, self._windows.rows_a_bin).reshape(sets, windows, -1, MEASURED)
        if self._bias is not None:
            means[..., -1] += GYRO_BIAS.value(parameters[:, self._bias])[:, None, None]
        return means[:, :, -self._windows.measured.shape[1] :].reshape(sets, windows, -1)

    def _torques(self, parameters: Array) -> Array:
        """Return the torques at the wheels (K, W, R, 4), by the gains and offsets of each set of parameters."""
        torque = self._windows.current_a * self._constant
        if not self._currents:
            return np.broadcast_to(torque, (len(parameters), *torque.shape))
        numbers = parameters[:, None, None, self._currents]
        gains, offsets = GAINS[0].value(numbers[..., :4]), OFFSETS[0].value(numbers[..., 4:])
        torques: Array = gains * torque + offsets * self._constant
        return torques

    def sigmas(self, residual: Array) -> Array:
        """Return robust standard deviations: one for the wheels, one for the gyro."""
        by_kind = residual.reshape(-1, MEASURED)
        wheels, gyro = robust.sigma(by_kind[:, :-1]), robust.sigma(by_kind[:, -1])
        each = np.maximum([*[wheels] * len(WHEEL_NAMES), gyro], _LEAST_SIGMA)
        return np.tile(each, residual.shape[1] // MEASURED)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stepper.close()
