"""Radius of the wheels, lever and scale of sideways motion, from wheel angles against gyro and pose fixes.

The heading between two fixes is the gyro's; the wheels give the way. Fixes are compared in windows of 24 s, each with
a start pose of its own, so that drift and a poor start do no harm.
"""

from typing import NamedTuple

import numpy as np

from hil.addons.identify import robust_statistics as robust
from hil.addons.identify.drives import Array, Drive, integral
from hil.addons.identify.gauss_newton import Knowledge, Solution, inverted, solve
from hil.addons.identify.windows import legs
from hil.core.errors import BadInputError
from hil.core.model import RobotModel

WINDOW_S = 24.0
_PAIR_S = 1.0
_LEAST_FIXES = 40
_LEAST_TURN_RAD = 1.0
_BIAS = 0.01  # rad/s, and s for the delay: the units in which the fit has them
_LEAST_SIGMA = np.array([1e-3, 1e-3, 1e-3])
_SIDEWAYS_SIGMA = 0.01  # expected: 0.989 with free rollers that slip, 1 without slip
RADIUS, SIDEWAYS, DELAY, BIAS = range(4)


class Kinematics(NamedTuple):
    """What was found; ``covariance`` (2, 2) is of the logarithms of radius and lever.

    ``scale_known`` is False without pose fixes: the radius is then the believed one. ``sideways`` is the scale of
    sideways motion over that of forward motion, which no parameter of the plant has, and ``sideways_sigma`` its
    standard deviation. ``delay_s`` is by how much the stamps of fixes are late.
    """

    radius_m: float
    lever_m: float
    gyro_bias_rad_s: float
    sideways: float
    sideways_sigma: float
    delay_s: float
    covariance: Array
    scale_known: bool


def fit_kinematics(drive: Drive) -> Kinematics:
    """Fit a drive on the floor. Raises BadInputError for a robot that hardly turned."""
    robot = drive.robot
    ratio, bias, of_ratio = _radius_over_lever(drive)
    radius, sideways, sideways_sigma, delay_s = robot.wheel_radius_m, 1.0, float("nan"), float("nan")
    covariance = np.zeros((2, 2))
    covariance[1, 1] = of_ratio[0, 0] / ratio**2
    scale_known = len(drive.fixes) >= _LEAST_FIXES
    if scale_known:
        found = _fit_fixes(drive, bias, float(np.sqrt(of_ratio[1, 1])))
        radius *= float(np.exp(found.parameters[RADIUS]))
        sideways = float(np.exp(found.parameters[SIDEWAYS]))
        sideways_sigma = float(np.sqrt(found.covariance[SIDEWAYS, SIDEWAYS]))
        delay_s = _BIAS * float(found.parameters[DELAY])
        covariance += found.covariance[RADIUS, RADIUS]  # the lever follows from the radius
    return Kinematics(radius, radius / ratio, bias, sideways, sideways_sigma, delay_s, covariance, scale_known)


def with_geometry(robot: RobotModel, found: Kinematics) -> dict[str, float]:
    """Return the lengths of [robot]; the share of the lever that is length stays the believed one."""
    share = found.lever_m / robot.lever_m
    return {
        "wheel_radius_m": found.radius_m,
        "half_length_m": robot.half_length_m * share,
        "half_width_m": robot.half_width_m * share,
    }


def _radius_over_lever(drive: Drive) -> tuple[float, float, Array]:
    """Return r / L [1], the gyro's bias [rad/s] and their covariance, from turns by the wheels against the gyro's."""
    rows = max(1, round(_PAIR_S / drive.period_s))
    ends = np.arange(1, len(drive.time_s) - 1, rows)
    heading = integral(drive.yaw_rate_rad_s, drive.period_s)
    by_wheels = drive.angle_rad @ np.array([-1.0, 1.0, 1.0, -1.0]) / 4.0
    turned, expected = np.diff(heading[ends]), np.diff(by_wheels[ends])
    if np.abs(expected).sum() * drive.robot.wheel_radius_m / drive.robot.lever_m < _LEAST_TURN_RAD:
        raise BadInputError(
            f"{drive.path}: the robot hardly turned; expected turns of {_LEAST_TURN_RAD:g} rad in all, for the lever"
        )
    design = np.stack([expected, np.full(len(turned), rows * drive.period_s)], axis=1)
    found, covariance = robust.regression(design, turned, design, np.arange(len(turned)))
    if found[0] <= 0.0:
        raise BadInputError(
            f"{drive.path}: gyro and wheels turn in opposite directions; hil commission finds the signs"
        )
    return float(found[0]), float(found[1]), covariance


class _Fixes:
    """An ``Experiment``: windows of pose fixes, predicted by wheels and gyro from a free pose."""

    def __init__(self, drive: Drive, bias_rad_s: float) -> None:
        inside = (drive.fixes[:, 0] > drive.time_s[0] + 0.2) & (drive.fixes[:, 0] < drive.time_s[-1] - 0.2)
        fixes = drive.fixes[inside]
        span_s = float(fixes[-1, 0] - fixes[0, 0])
        count = max(1, round(span_s / WINDOW_S))
        each = len(fixes) // count
        fixes = fixes[: count * each].reshape(count, each, 4)
        self._drive, self._radius_m = drive, drive.robot.wheel_radius_m
        self._stamps = fixes[..., 0]
        self._bias = bias_rad_s
        fixed = fixes[..., 1:].copy()
        fixed[..., 2] = np.unwrap(fixed[..., 2], axis=1)
        self.measured = fixed.reshape(count, -1)
        self.start_steps = np.array([1e-3, 1e-3, 1e-3])
        self.starts = fixed[:, 0]
        self.least_sigmas = np.tile(_LEAST_SIGMA, each)

    def predict(self, parameters: Array, starts: Array) -> Array:
        """See ``Experiment``. A start is the pose at the window's first stamp."""
        found = np.empty((len(parameters), *self.measured.shape))
        drive = self._drive
        for place, (radius, sideways, delay, bias) in enumerate(parameters):
            heading = integral(drive.yaw_rate_rad_s - self._bias - _BIAS * bias, drive.period_s)
            forward, left = legs(drive, heading)
            way = self._radius_m * np.exp(radius) * (forward + np.exp(sideways) * left)
            times = self._stamps - _BIAS * delay
            at = [np.interp(times, drive.time_s, series) for series in (way[:, 0], way[:, 1], heading)]
            x, y, turned = (series - series[:, :1] for series in at)
            # The legs are in the frame of the first feedback; turn them into that of the window's start.
            turn = starts[place, :, 2:] - at[2][:, :1]
            c, s = np.cos(turn), np.sin(turn)
            poses = np.stack(
                [
                    starts[place, :, :1] + c * x - s * y,
                    starts[place, :, 1:2] + s * x + c * y,
                    starts[place, :, 2:] + turned,
                ],
                axis=2,
            )
            found[place] = poses.reshape(len(poses), -1)
        return found

    def sigmas(self, residual: Array) -> Array:
        """Return robust standard deviations of position and heading."""
        by_kind = residual.reshape(-1, 3)
        position, heading = robust.sigma(by_kind[:, :2]), robust.sigma(by_kind[:, 2])
        each = np.maximum([position, position, heading], _LEAST_SIGMA)
        return np.tile(each, residual.shape[1] // 3)


def _fit_fixes(drive: Drive, bias_rad_s: float, bias_sigma: float) -> Solution:
    known = Knowledge.none(4)
    known.information[SIDEWAYS, SIDEWAYS] = _SIDEWAYS_SIGMA**-2
    known.information[BIAS, BIAS] = (_BIAS / max(bias_sigma, 1e-5)) ** 2
    limits = np.array([0.5, 0.5, 20.0, 5.0])
    found = solve(_Fixes(drive, bias_rad_s), np.zeros(4), bounds=(-limits, limits), known=known)
    # A sandwich over a handful of windows may be far too small; the noise of the fixes is white, and sets the least.
    least = np.diag(inverted(found.information + known.information))
    factor = np.sqrt(np.maximum(1.0, least / np.diag(found.covariance)))
    return found._replace(covariance=found.covariance * np.outer(factor, factor))
