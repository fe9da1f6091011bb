"""The fitted parameters, and prior knowledge of them from kinematics, blocks, commands and experience.

Wheels on blocks give inertia and friction of each, by the balance of its angular momentum over short bins:

    κ ∫i dt = J Δω + b Δθ + c ∫sgn(ω) dt + o Δt

for each wheel by itself, with the offset o of its current. J and b of a fit are the means of the four: the gains of
current sensors differ. c is not used further: on blocks the load on a bearing is not that on the floor.
The currents are means over each feedback period, so the left side is exact however the motor was driven in between.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hil.addons.identify.drive_checks import check_motors
from hil.addons.identify.drives import Array, Drive
from hil.addons.identify.fit_kinematics import Kinematics
from hil.addons.identify.gauss_newton import Knowledge, inverted
from hil.addons.identify.robust_statistics import regression
from hil.addons.identify.windows import GAINS, GYRO_BIAS, OFFSETS, STRETCH, Parameter, variable
from hil.core.errors import BadInputError, apart
from hil.core.model import RobotModel
from hil.core.types import WHEEL_NAMES

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


ROLLERS = "roller_friction_coefficient"  # often almost zero, so it is not fitted as a logarithm
RIGID = (
    variable("mass_kg"),
    variable("inertia_kg_m2"),
    variable("wheel_inertia_kg_m2"),
    variable("com_x_m", 0.05),
    variable("com_y_m", 0.05),
    variable("friction_coefficient"),
    variable("viscous_n_m_s_rad"),
)
STIFFNESS = "roller_stiffness_n_m"  # a stiffness of forces, so its estimate scales with the believed torque constant
SLIP = (*RIGID, variable("grip_coefficient"), variable(ROLLERS, 0.01), variable(STIFFNESS))
LENGTHS = ("wheel_radius_m", "lever_m")  # they are found by the kinematics, and held in the dynamics
_FIRST = {"friction_coefficient": 0.02, "viscous_n_m_s_rad": 0.02, "grip_coefficient": 0.7,
          ROLLERS: 0.01, STIFFNESS: 2e5, "com_x_m": 0.0, "com_y_m": 0.0, STRETCH.name: 0.0}  # fmt: skip
_GRIP_SIGMA = 0.3  # of its logarithm: rubber on floors
_ROLLER_SIGMA = 1.0  # of 0.01
_STIFFNESS_SIGMA = 0.7  # of its logarithm: hard and soft rubber
_LENGTH_SIGMA = 0.02  # of half the length and half the width, measured by hand
_GAIN_SIGMA = 0.02  # of each current sensor's gain against the mean of the four
_LEAST_GAIN_SIGMA = 1e-4  # of that mean, which is part of the torque constant
_OFFSET_SIGMA = 0.01  # of a current sensor's offset, relative to the usual current


class Before(NamedTuple):
    """What is known before the dynamics are fitted.

    Attributes:
        robot: as it is believed, with the radius and the lever that were found.
        torque_constant_n_m_a: the believed one.
        kinematics, blocks: what was found.
        gain_variance: (4,) of the logarithms of the currents' gains, where commands tell the currents.
        usual_current_a: (4,) root mean squares over the drives on the floor.
    """

    robot: RobotModel
    torque_constant_n_m_a: float
    kinematics: Kinematics
    blocks: BlocksFit | None
    gain_variance: Array
    usual_current_a: Array

    def parameters(self, contact: str) -> tuple[Parameter, ...]:
        """Return the fitted parameters, with the lengths, and last the gyro's bias."""
        shares = {name: getattr(self.robot, name) / self.robot.lever_m for name in ("half_length_m", "half_width_m")}
        lengths = (variable("wheel_radius_m"), Parameter("lever_m", shares))
        return (*(RIGID if contact == "rigid" else SLIP), STRETCH, *lengths, *GAINS, *OFFSETS, GYRO_BIAS)

    def point(self, parameters: Sequence[Parameter], fitted: Mapping[str, float]) -> Array:
        """Return the numbers with which a fit begins; ``fitted`` are values of a simpler model."""
        robot = self.robot
        first = {name: getattr(robot, name) for name in ("mass_kg", "inertia_kg_m2", "wheel_inertia_kg_m2", *LENGTHS)}
        first |= {one.name: 1.0 for one in GAINS} | {one.name: 0.0 for one in OFFSETS}
        first |= {**_FIRST, GYRO_BIAS.name: self.kinematics.gyro_bias_rad_s, **fitted}
        if self.blocks is not None:
            first |= {
                "wheel_inertia_kg_m2": self.blocks.inertia_kg_m2,
                "viscous_n_m_s_rad": self.blocks.viscous_n_m_s_rad,
            }
        return np.array([one.internal(first[one.name]) for one in parameters])

    def knowledge(self, parameters: Sequence[Parameter]) -> Knowledge:
        """Return what is known of the parameters; lengths are held."""
        names, robot = [one.name for one in parameters], self.robot
        known = Knowledge.none(len(names))._replace(mean=self.point(parameters, {}))
        held = [names.index(name) for name in LENGTHS]
        known.held[held] = True
        known.held_covariance[np.ix_(held, held)] = self.kinematics.covariance
        gains, offsets = ([names.index(one.name) for one in ones] for ones in (GAINS, OFFSETS))
        apart = np.eye(len(gains)) - 1.0 / len(gains)
        doubt = np.diag(self.gain_variance + _LEAST_GAIN_SIGMA**2) + _GAIN_SIGMA**2 * apart
        known.information[np.ix_(gains, gains)] = inverted(doubt)
        known.information[offsets, offsets] = [
            one.internal(_OFFSET_SIGMA * usual_a) ** -2
            for one, usual_a in zip(OFFSETS, self.usual_current_a, strict=True)
        ]
        if self.blocks is not None:
            # Both are in proportion to the mean of the currents' gains.
            places = [*(names.index(name) for name in ("wheel_inertia_kg_m2", "viscous_n_m_s_rad")), *gains]
            rows = np.concatenate([np.eye(2), np.full((2, len(gains)), -1.0 / len(gains))], axis=1)
            known.information[np.ix_(places, places)] += (
                rows.T @ inverted(self.blocks.covariance_of_logarithms()) @ rows
            )
        place = names.index(STRETCH.name)
        sigma_m = np.sqrt(2.0) * _LENGTH_SIGMA * robot.half_length_m * robot.half_width_m / robot.lever_m
        known.information[place, place] = (STRETCH.internal(1.0) * sigma_m) ** -2
        if "grip_coefficient" in names:
            known.information[(names.index("grip_coefficient"),) * 2] = _GRIP_SIGMA**-2
            known.information[(names.index(ROLLERS),) * 2] = _ROLLER_SIGMA**-2
            known.information[(names.index(STIFFNESS),) * 2] = _STIFFNESS_SIGMA**-2
        return known
