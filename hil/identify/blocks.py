"""Wheels on blocks: inertia and friction of each, by the balance of its angular momentum over short bins.

    κ ∫i dt = J Δω + b Δθ + c ∫sgn(ω) dt + o Δt

for each wheel by itself, with the offset o of its current. J and b of a fit are the means of the four: the gains of
current sensors differ. c is not used further: on blocks the load on a bearing is not that on the floor.
The currents are means over each feedback period, so the left side is exact however the motor was driven in between.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil.core.errors import BadInputError, apart
from hil.core.types import WHEEL_NAMES
from hil.identify.recorded import Array, Drive
from hil.identify.robust import regression
from hil.identify.trouble import check_motors

_BIN_S = 0.1
_HALF_S = 0.02  # a speed is the mean over this time before and after
_SLOWEST_RAD_S = 0.3
_CLUSTER_BINS = 10
_LEAST_BINS = 40
_SIGMAS = 3.0  # a friction that is negative by no more standard errors is none


class BlocksFit(NamedTuple):
    """Inertia [kg·m²] and viscous friction [N·m·s/rad] of a wheel, and the covariance (2, 2) of both.

    They are for the torque constant that the fit was given.
    """

    inertia_kg_m2: float
    viscous_n_m_s_rad: float
    covariance: Array

    def covariance_of_logarithms(self) -> Array:
        """Return the covariance (2, 2) of the logarithms of inertia and viscous friction."""
        found = np.array([self.inertia_kg_m2, self.viscous_n_m_s_rad])
        covariance: Array = self.covariance / np.outer(found, found)
        return covariance


def fit_blocks(drive: Drive, torque_constant_n_m_a: float) -> BlocksFit:
    """Fit a drive whose four wheels turned freely. Raises BadInputError when they did not, or hardly turned."""
    check_motors(drive)
    rows = max(1, round(_BIN_S / drive.period_s))
    half = max(1, round(_HALF_S / drive.period_s))
    margin = half + 2
    ends = np.arange(margin, len(drive.time_s) - margin, rows)
    span_s = rows * drive.period_s
    # A speed is a mean over time, so impulses and angles are averaged over the same time: else J would be too large.
    impulses = torque_constant_n_m_a * np.cumsum(drive.current_a * drive.period_s, axis=0)
    impulse = np.diff(_averaged(impulses, half)[ends], axis=0)
    change = np.diff(_speed(drive, half)[ends], axis=0)
    turned = np.diff(_averaged(drive.angle_rad, half)[ends], axis=0)
    speed = drive.speed_rad_s
    least = np.stack([np.abs(speed[a - half : b + half + 1]).min(axis=0) for a, b in pairwise(ends)])
    same = np.sign(speed[ends[:-1]]) == np.sign(speed[ends[1:]])
    used = same & (least > _SLOWEST_RAD_S)
    for wheel, count in zip(WHEEL_NAMES, used.sum(axis=0), strict=True):
        if count < _LEAST_BINS:
            least_s = _LEAST_BINS * span_s
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned for {apart(count * span_s, least_s)} s; expected at least "
                f"{least_s:g} s on blocks, faster than {_SLOWEST_RAD_S:g} rad/s"
            )
    bins, wheels = np.nonzero(used)
    columns = np.stack([change[used], turned[used], np.sign(turned[used]) * span_s, np.full(len(bins), span_s)])
    every, count = np.arange(len(bins)), len(WHEEL_NAMES)
    design = np.zeros((len(bins), len(columns) * count))
    for place, column in enumerate(columns):
        design[every, place * count + wheels] = column
    # Speeds of other samples have the same motion and other noise: without them noise would make J smaller.
    instrument = design.copy()
    instrument[every, wheels] = np.diff(_speed(drive, half + 2)[ends], axis=0)[used]
    by_wheel, of_wheels = regression(design, impulse[used], instrument, bins // _CLUSTER_BINS)
    means = np.kron(np.eye(2, len(columns)), np.full((1, count), 1.0 / count))
    found, covariance = means @ by_wheel, means @ of_wheels @ means.T
    error = float(np.sqrt(covariance[1, 1]))
    if -_SIGMAS * error < found[1] <= 0.0:  # bearings with next to no friction; the fit takes its logarithm
        found[1] = error
    if found[0] <= 0.0 or found[1] <= 0.0:
        raise BadInputError(
            f"{drive.path}: on blocks the wheels' inertia came out as {found[0]:.3g} kg m2 and their viscous friction "
            f"as {found[1]:.3g} N m s/rad; expected positive numbers: check the signs of currents and speeds"
        )
    return BlocksFit(float(found[0]), float(found[1]), covariance)


def _speed(drive: Drive, half: int) -> Array:
    """Return the mean wheel speeds from so many feedbacks before to as many after, of shape (n, 4)."""
    angle = np.pad(drive.angle_rad, ((half, half), (0, 0)), mode="edge")
    speed: Array = (angle[2 * half :] - angle[: -2 * half]) / (2.0 * half * drive.period_s)
    return speed


def _averaged(series: Array, half: int) -> Array:
    """Return the means of a series (n, 4) over the same times, by the trapezoidal rule."""
    sums = np.cumsum(np.pad(series, ((half + 1, half), (0, 0)), mode="edge"), axis=0)
    ends = np.pad(series, ((half, half), (0, 0)), mode="edge")
    whole = sums[2 * half + 1 :] - sums[: -2 * half - 1]
    mean: Array = (whole - 0.5 * (ends[2 * half :] + ends[: -2 * half])) / (2.0 * half)
    return mean
