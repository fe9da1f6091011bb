"""A drive in windows of half a second: what was measured in each, in short bins, and how it began.

A window is short so that errors of the model do not add up, and its start is free: it is a guess from the wheels here,
and is fitted with everything else (``gauss_newton``).
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.kinematics import body_twist
from hil.core.model import RobotModel
from hil.core.types import Wheels
from hil.identify.recorded import Array, Drive, integral

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
        measured: (W, B, 5), see ``MEASURED``; the yaw rate is NaN without a gyro.
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
    """Cut a drive into windows, each beginning where the one before ends; what is left at the end is not used.

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
    steps = twists(np.diff(drive.angle_rad, axis=0), robot)
    if drive.has_gyro:
        heading = integral(drive.yaw_rate_rad_s - gyro_bias_rad_s, drive.period_s)
    else:
        heading = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    middle = 0.5 * (heading[1:] + heading[:-1])
    c, s = np.cos(middle), np.sin(middle)
    way = np.stack([c * steps[:, 0] - s * steps[:, 1], s * steps[:, 0] + c * steps[:, 1]], axis=1)
    return np.concatenate([np.concatenate([np.zeros((1, 2)), np.cumsum(way, axis=0)]), heading[:, None]], axis=1)
