"""The error-state Kalman filter: belief in pose, gyro bias and wheel scale, and how motion changes it.

Pure functions from one belief to the next, so that the past can be recomputed. The error is (x, y, heading,
gyro bias, wheel scale), in the world frame. Written out in plain floats: with NumPy a step costs ten times as much.
``correction.py`` is the other half of the filter.

Source: J. Solà, Quaternion kinematics for the error-state Kalman filter, 2017, section 5, here in the plane.
"""

import math
from typing import NamedTuple

from hil.core.types import MeasuredPose, Pose

_UNKNOWN_VARIANCE = 1e6


class Covariance(NamedTuple):
    """Covariance of (x, y, heading, bias, scale): the upper triangle, row by row."""

    xx: float
    xy: float
    xh: float
    xb: float
    xs: float
    yy: float
    yh: float
    yb: float
    ys: float
    hh: float
    hb: float
    hs: float
    bb: float
    bs: float
    ss: float


class Belief(NamedTuple):
    """The estimate at one instant of robot time.

    ``scale`` is how far the robot moves over how far its wheels say: 1.005 if they are 0.5 % larger than believed.
    ``is_known`` is False before the first fix of a robot without a known start. ``fixed_ns`` is the time of the newest
    accepted fix. ``streak`` is the number of rejected fixes in a row that agree with one another, and ``restarts``
    counts the streaks that were accepted. ``noise`` is the factor on the variances of fixes, as learnt from ``pairs``
    of successive ones. ``last_fix`` is the newest fix, accepted or not, and ``last_belief`` the belief after it.
    """

    time_ns: int
    x_m: float
    y_m: float
    heading_rad: float
    bias_rad_s: float
    scale: float
    covariance: Covariance
    is_known: bool
    fixed_ns: int
    accepted: int = 0
    rejected: int = 0
    restarts: int = 0
    streak: int = 0
    noise: float = 1.0
    pairs: int = 0
    last_fix: MeasuredPose | None = None
    last_belief: "Belief | None" = None


class Step(NamedTuple):
    """The step from one measurement to the next: motion in the body frame, and variances of its errors.

    ``biased_s`` is the time over which the gyro's bias turned the robot: the step's duration, or 0 when
    ``turned_rad`` is the wheels'. ``is_rolled`` says that forward and left are the wheels', to which the scale applies.
    It does not apply to their turn, which has the error of the lever too.
    """

    forward_m: float
    left_m: float
    turned_rad: float
    biased_s: float
    position_m2: float
    heading_rad2: float
    bias_rad2_s2: float
    is_rolled: bool = True


def start(
    time_ns: int, pose: Pose, sigma_m: float, sigma_rad: float, bias_sigma_rad_s: float, scale_sigma: float
) -> Belief:
    """Return the belief in a start with these standard deviations."""
    covariance = _diagonal(sigma_m**2, sigma_rad**2, bias_sigma_rad_s**2, scale_sigma**2)
    return Belief(time_ns, *pose, 0.0, 1.0, covariance, is_known=True, fixed_ns=time_ns)


def start_unknown(time_ns: int, bias_sigma_rad_s: float, scale_sigma: float) -> Belief:
    """Return the belief without a start: the first fix is taken as it is."""
    covariance = _diagonal(_UNKNOWN_VARIANCE, _UNKNOWN_VARIANCE, bias_sigma_rad_s**2, scale_sigma**2)
    return Belief(time_ns, 0.0, 0.0, 0.0, 0.0, 1.0, covariance, is_known=False, fixed_ns=time_ns)


def moved(belief: Belief, step: Step, time_ns: int, share: float = 1.0) -> Belief:
    """Return the belief at ``time_ns``, after this share of a step: x ← f(x, u), P ← F P Fᵀ + Q.

    The displacement is rotated by the heading half way. Its noise is the same in all directions; the noise of the
    heading acts at the end of the step.
    """
    forward, left, biased_s = share * step.forward_m, share * step.left_m, share * step.biased_s
    turned = share * step.turned_rad - belief.bias_rad_s * biased_s
    middle = belief.heading_rad + 0.5 * turned
    cos, sin = math.cos(middle), math.sin(middle)
    dx, dy = cos * forward - sin * left, sin * forward + cos * left
    i, j = 0.0, 0.0
    if step.is_rolled:
        i, j = dx, dy
        dx, dy = belief.scale * dx, belief.scale * dy
    xx, xy, xh, xb, xs, yy, yh, yb, ys, hh, hb, hs, bb, bs, ss = belief.covariance
    # F has the rows (1, 0, a, e, i), (0, 1, c, g, j), (0, 0, 1, t, 0), (0, 0, 0, 1, 0), (0, 0, 0, 0, 1). Below is F P.
    a, c, t = -dy, dx, -biased_s
    e, g = 0.5 * a * t, 0.5 * c * t
    x_h, x_b, x_s = xh + a * hh + e * hb + i * hs, xb + a * hb + e * bb + i * bs, xs + a * hs + e * bs + i * ss
    y_h, y_b, y_s = yh + c * hh + g * hb + j * hs, yb + c * hb + g * bb + j * bs, ys + c * hs + g * bs + j * ss
    h_b, h_s = hb + t * bb, hs + t * bs
    noise_m2 = share * step.position_m2
    covariance = Covariance(
        xx + a * xh + e * xb + i * xs + a * x_h + e * x_b + i * x_s + noise_m2,
        xy + a * yh + e * yb + i * ys + c * x_h + g * x_b + j * x_s,
        x_h + t * x_b,
        x_b,
        x_s,
        yy + c * yh + g * yb + j * ys + c * y_h + g * y_b + j * y_s + noise_m2,
        y_h + t * y_b,
        y_b,
        y_s,
        hh + t * hb + t * h_b + share * step.heading_rad2,
        h_b,
        h_s,
        bb + share * step.bias_rad2_s2,
        bs,
        ss,
    )
    return Belief(
        time_ns,
        belief.x_m + dx,
        belief.y_m + dy,
        belief.heading_rad + turned,
        belief.bias_rad_s,
        belief.scale,
        covariance,
        *belief[7:],
    )


def position_sigma_m(covariance: Covariance) -> float:
    """Return the standard deviation of the position in its worst direction [m]."""
    half_difference = 0.5 * (covariance.xx - covariance.yy)
    largest = 0.5 * (covariance.xx + covariance.yy) + math.hypot(half_difference, covariance.xy)
    return math.sqrt(max(0.0, largest))


def _diagonal(position: float, heading: float, bias: float, scale: float) -> Covariance:
    return Covariance(position, 0, 0, 0, 0, position, 0, 0, 0, heading, 0, 0, bias, 0, scale)
