"""Wheels on blocks: inertia and friction of each, by the balance of its angular momentum over short bins.

    κ ∫i dt = J Δω + b Δθ + c ∫sgn(ω) dt

for each wheel, with one J and b for all and a c for each: on blocks the load on a bearing is not that on the floor.
The currents are means over each feedback period, so the left side is exact however the motor was driven in between.
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil.core.errors import BadInputError
from hil.core.types import WHEEL_NAMES
from hil.identify.recorded import Array, Drive
from hil.identify.robust import regression

_BIN_S = 0.1
_SLOWEST_RAD_S = 0.3
_CLUSTER_BINS = 10
_LEAST_BINS = 40


class BlocksFit(NamedTuple):
    """Inertia [kg·m²] and viscous friction [N·m·s/rad] of a wheel, Coulomb friction of each wheel [N·m].

    ``covariance`` (6, 6) is of these in this order. All are for the torque constant that the fit was given.
    """

    inertia_kg_m2: float
    viscous_n_m_s_rad: float
    coulomb_n_m: Array
    covariance: Array

    def of_logarithms(self) -> tuple[Array, Array]:
        """Return the logarithms of inertia and viscous friction, and their covariance."""
        found = np.array([self.inertia_kg_m2, self.viscous_n_m_s_rad])
        return np.log(found), self.covariance[:2, :2] / np.outer(found, found)


def fit_blocks(drive: Drive, torque_constant_n_m_a: float) -> BlocksFit:
    """Fit a drive whose four wheels turned freely. Raises BadInputError when they did not, or hardly turned."""
    if not drive.has_currents:
        raise BadInputError(f"{drive.path}: the robot measured no currents; blocks tell nothing without them")
    rows = max(1, round(_BIN_S / drive.period_s))
    ends = np.arange(2, len(drive.time_s) - 2, rows)
    span_s = rows * drive.period_s
    # The mean of the next rows, where a row has what passed since the one before.
    summed = np.concatenate([np.zeros((1, 4)), np.cumsum(drive.current_a * drive.period_s, axis=0)])
    impulse = torque_constant_n_m_a * np.diff(summed[ends + 1], axis=0)
    speed = drive.speed_rad_s
    change, turned = np.diff(speed[ends], axis=0), np.diff(drive.angle_rad[ends], axis=0)
    least = np.stack([np.abs(speed[a : b + 1]).min(axis=0) for a, b in pairwise(ends)])
    same = np.sign(speed[ends[:-1]]) == np.sign(speed[ends[1:]])
    used = same & (least > _SLOWEST_RAD_S)
    for wheel, count in zip(WHEEL_NAMES, used.sum(axis=0), strict=True):
        if count < _LEAST_BINS:
            raise BadInputError(
                f"{drive.path}: wheel {wheel} turned for {count * span_s:.1f} s; expected at least "
                f"{_LEAST_BINS * span_s:g} s on blocks, faster than {_SLOWEST_RAD_S:g} rad/s"
            )
    bins, wheels = np.nonzero(used)
    design = np.zeros((len(bins), 6))
    design[:, 0], design[:, 1] = change[used], turned[used]
    design[np.arange(len(bins)), 2 + wheels] = np.sign(turned[used]) * span_s
    # Speeds of other samples have the same motion and other noise: without them noise would make J smaller.
    instrument = design.copy()
    instrument[:, 0] = np.diff(_wider(drive)[ends], axis=0)[used]
    found, covariance = regression(design, impulse[used], instrument, bins // _CLUSTER_BINS)
    if found[0] <= 0.0 or found[1] <= 0.0:
        raise BadInputError(
            f"{drive.path}: on blocks the wheels' inertia came out as {found[0]:.3g} kg m2 and their viscous friction "
            f"as {found[1]:.3g} N m s/rad; expected positive numbers: check the signs of currents and speeds"
        )
    return BlocksFit(float(found[0]), float(found[1]), found[2:], covariance)


def _wider(drive: Drive) -> Array:
    """Return wheel speeds from angles two feedbacks before and after, of shape (n, 4)."""
    angle = np.pad(drive.angle_rad, ((2, 2), (0, 0)), mode="edge")
    speed: Array = (angle[4:] - angle[:-4]) / (4.0 * drive.period_s)
    return speed
