"""The error-state Kalman filter: belief in pose and gyro bias, moved by the wheels, corrected by pose fixes.

Pure functions from one belief to the next, so that the past can be recomputed. The error is (x, y, heading,
gyro bias), in the world frame. Written out in plain floats: with NumPy a step costs ten times as much.

Sources: J. Solà, Quaternion kinematics for the error-state Kalman filter, 2017, section 5, here in the plane;
Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 5.4 (gate).
"""

import math
from typing import NamedTuple

from hil.core.types import MeasuredPose, Pose, PoseCovariance

_UNKNOWN_VARIANCE = 1e6
_LEAST_SHARE = 1e-6
_ROUNDING = 1e-13
_Triangle = tuple[float, float, float, float, float, float]


class Covariance(NamedTuple):
    """Covariance of (x, y, heading, bias): the upper triangle, row by row; h is the heading, b the bias."""

    xx: float
    xy: float
    xh: float
    xb: float
    yy: float
    yh: float
    yb: float
    hh: float
    hb: float
    bb: float


class Belief(NamedTuple):
    """The estimate at one instant of robot time.

    ``is_known`` is False before the first fix of a robot without a known start. ``fixed_ns`` is the time of the newest
    accepted fix. ``streak`` is the number of rejected fixes in a row that agree with one another, ``streak_fix`` the
    last of them, and ``streak_belief`` the belief that rejected it. ``restarts`` counts the streaks that were accepted.
    """

    time_ns: int
    x_m: float
    y_m: float
    heading_rad: float
    bias_rad_s: float
    covariance: Covariance
    is_known: bool
    fixed_ns: int
    accepted: int = 0
    rejected: int = 0
    restarts: int = 0
    streak: int = 0
    streak_fix: MeasuredPose | None = None
    streak_belief: "Belief | None" = None


class Step(NamedTuple):
    """The step from one measurement to the next: motion in the body frame, and variances of its errors.

    ``biased_s`` is the time over which the gyro's bias turned the robot: the step's duration, or 0 when
    ``turned_rad`` is the wheels'.
    """

    forward_m: float
    left_m: float
    turned_rad: float
    biased_s: float
    position_m2: float
    heading_rad2: float
    bias_rad2_s2: float


class Acceptance(NamedTuple):
    """When fixes are accepted: the largest squared Mahalanobis distance, or after how many rejected ones in a row.

    ``bias_rad2_s2`` is the least variance of the bias after a restart, whose cause may be a jump of the bias.
    """

    gate: float
    streak: int
    bias_rad2_s2: float


def start(time_ns: int, pose: Pose, sigma_m: float, sigma_rad: float, bias_sigma_rad_s: float) -> Belief:
    """Return the belief in a start with these standard deviations."""
    covariance = _diagonal(sigma_m**2, sigma_rad**2, bias_sigma_rad_s**2)
    return Belief(time_ns, *pose, 0.0, covariance, is_known=True, fixed_ns=time_ns)


def start_unknown(time_ns: int, bias_sigma_rad_s: float) -> Belief:
    """Return the belief without a start: the first fix is taken as it is."""
    covariance = _diagonal(_UNKNOWN_VARIANCE, _UNKNOWN_VARIANCE, bias_sigma_rad_s**2)
    return Belief(time_ns, 0.0, 0.0, 0.0, 0.0, covariance, is_known=False, fixed_ns=time_ns)


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
    xx, xy, xh, xb, yy, yh, yb, hh, hb, bb = belief.covariance
    # F = [[1, 0, a, e], [0, 1, c, g], [0, 0, 1, t], [0, 0, 0, 1]]; below are the rows of F P.
    a, c, t = -dy, dx, -biased_s
    e, g = 0.5 * a * t, 0.5 * c * t
    x_h, x_b = xh + a * hh + e * hb, xb + a * hb + e * bb
    y_h, y_b = yh + c * hh + g * hb, yb + c * hb + g * bb
    h_b = hb + t * bb
    noise_m2 = share * step.position_m2
    covariance = Covariance(
        xx + a * xh + e * xb + a * x_h + e * x_b + noise_m2,
        xy + a * yh + e * yb + c * x_h + g * x_b,
        x_h + t * x_b,
        x_b,
        yy + c * yh + g * yb + c * y_h + g * y_b + noise_m2,
        y_h + t * y_b,
        y_b,
        hh + t * hb + t * h_b + share * step.heading_rad2,
        h_b,
        bb + share * step.bias_rad2_s2,
    )
    return Belief(
        time_ns,
        belief.x_m + dx,
        belief.y_m + dy,
        belief.heading_rad + turned,
        belief.bias_rad_s,
        covariance,
        *belief[6:],
    )


def corrected(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    """Return the belief corrected by a fix of the same instant.

    A fix is rejected if it is beyond the gate, or if its covariance is invalid or nearly singular. When enough fixes in
    a row are beyond the gate, but agree with one another and with the motion between them, the robot was not where it
    was believed to be. Then the belief starts anew from the last of them.
    """
    r = fix.covariance
    if min(r.xx_m2, r.yy_m2, r.hh_rad2) <= 0.0 or not is_regular(*r, share=_LEAST_SHARE):
        return belief._replace(rejected=belief.rejected + 1)
    if not belief.is_known:
        return _restarted(belief, fix, acceptance)._replace(restarts=belief.restarts)
    p = belief.covariance
    vx, vy = fix.pose.x_m - belief.x_m, fix.pose.y_m - belief.y_m
    vh = math.remainder(fix.pose.heading_rad - belief.heading_rad, math.tau)
    # L Lᵀ = P + R; W = L⁻¹ H P has one column each of x, y, heading, bias.
    factor = _cholesky(
        p.xx + r.xx_m2, p.xy + r.xy_m2, p.xh + r.xh_m_rad, p.yy + r.yy_m2, p.yh + r.yh_m_rad, p.hh + r.hh_rad2
    )
    v = _solved(factor, vx, vy, vh)
    if _dot(v, v) > acceptance.gate:
        return _rejected(belief, fix, acceptance)
    x, y = _solved(factor, p.xx, p.xy, p.xh), _solved(factor, p.xy, p.yy, p.yh)
    h, b = _solved(factor, p.xh, p.yh, p.hh), _solved(factor, p.xb, p.yb, p.hb)
    covariance = Covariance(
        _less(p.xx, _dot(x, x)),
        p.xy - _dot(x, y),
        p.xh - _dot(x, h),
        p.xb - _dot(x, b),
        _less(p.yy, _dot(y, y)),
        p.yh - _dot(y, h),
        p.yb - _dot(y, b),
        _less(p.hh, _dot(h, h)),
        p.hb - _dot(h, b),
        _less(p.bb, _dot(b, b)),
    )
    return Belief(
        belief.time_ns,
        belief.x_m + _dot(x, v),
        belief.y_m + _dot(y, v),
        belief.heading_rad + _dot(h, v),
        belief.bias_rad_s + _dot(b, v),
        covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        rejected=belief.rejected,
        restarts=belief.restarts,
    )


def position_sigma_m(covariance: Covariance) -> float:
    """Return the standard deviation of the position in its worst direction [m]."""
    half_difference = 0.5 * (covariance.xx - covariance.yy)
    largest = 0.5 * (covariance.xx + covariance.yy) + math.hypot(half_difference, covariance.xy)
    return math.sqrt(max(0.0, largest))


def gate_of(probability: float) -> float:
    """Return the squared Mahalanobis distance that bounds right fixes with this probability (χ², 3 degrees)."""
    low, high = 0.0, 1000.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        # The distribution function of chi-square with three degrees of freedom in closed form.
        below = math.erf(math.sqrt(0.5 * middle)) - math.sqrt(2.0 * middle / math.pi) * math.exp(-0.5 * middle)
        low, high = (middle, high) if below < probability else (low, middle)
    return high


def _rejected(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    agrees = belief.streak_fix is not None and _agree(belief, fix, acceptance.gate)
    count = belief.streak + 1 if agrees else 1
    if count >= acceptance.streak:
        return _restarted(belief, fix, acceptance)
    return belief._replace(
        rejected=belief.rejected + 1,
        streak=count,
        streak_fix=fix,
        streak_belief=belief._replace(streak_fix=None, streak_belief=None),
    )


def _restarted(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    """Return the belief of a fix alone, with more variance of the gyro's bias."""
    r = fix.covariance
    bias_rad2_s2 = max(belief.covariance.bb, acceptance.bias_rad2_s2)
    turned = math.remainder(fix.pose.heading_rad - belief.heading_rad, math.tau)
    return Belief(
        belief.time_ns,
        fix.pose.x_m,
        fix.pose.y_m,
        belief.heading_rad + turned,
        belief.bias_rad_s,
        Covariance(r.xx_m2, r.xy_m2, r.xh_m_rad, 0.0, r.yy_m2, r.yh_m_rad, 0.0, r.hh_rad2, 0.0, bias_rad2_s2),
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        rejected=belief.rejected,
        restarts=belief.restarts + 1,
    )


def _agree(belief: Belief, fix: MeasuredPose, gate: float) -> bool:
    """Return whether this fix agrees with the last rejected one, moved on by the robot's motion since."""
    last, then = belief.streak_fix, belief.streak_belief
    if last is None or then is None:
        return False
    # The motion since, turned from the believed heading into that of the last fix.
    c = math.cos(last.pose.heading_rad - then.heading_rad)
    s = math.sin(last.pose.heading_rad - then.heading_rad)
    way_x, way_y = belief.x_m - then.x_m, belief.y_m - then.y_m
    dx, dy = c * way_x - s * way_y, s * way_x + c * way_y
    r, q, grown, before = fix.covariance, last.covariance, belief.covariance, then.covariance
    a, b = -dy, dx
    together = PoseCovariance(
        r.xx_m2 + q.xx_m2 + a * (2.0 * q.xh_m_rad + a * q.hh_rad2) + max(0.0, grown.xx - before.xx),
        r.xy_m2 + q.xy_m2 + b * q.xh_m_rad + a * q.yh_m_rad + a * b * q.hh_rad2,
        r.xh_m_rad + q.xh_m_rad + a * q.hh_rad2,
        r.yy_m2 + q.yy_m2 + b * (2.0 * q.yh_m_rad + b * q.hh_rad2) + max(0.0, grown.yy - before.yy),
        r.yh_m_rad + q.yh_m_rad + b * q.hh_rad2,
        r.hh_rad2 + q.hh_rad2 + max(0.0, grown.hh - before.hh),
    )
    turned = belief.heading_rad - then.heading_rad
    apart = _solved(
        _cholesky(*together),
        fix.pose.x_m - last.pose.x_m - dx,
        fix.pose.y_m - last.pose.y_m - dy,
        math.remainder(fix.pose.heading_rad - last.pose.heading_rad - turned, math.tau),
    )
    return _dot(apart, apart) <= gate  # the squared Mahalanobis distance


def is_regular(a: float, ab: float, ac: float, b: float, bc: float, c: float, share: float) -> bool:
    """Return whether Cholesky's last two pivots are at least this share of their diagonal elements.

    The matrix is given by its upper triangle, row by row; its diagonal is positive.
    """
    second = b - ab * ab / a
    if second < share * b:
        return False
    mixed = bc - ab * ac / a
    return c - ac * ac / a - mixed * mixed / second >= share * c


def _diagonal(position: float, heading: float, bias: float) -> Covariance:
    return Covariance(position, 0.0, 0.0, 0.0, position, 0.0, 0.0, heading, 0.0, bias)


def _cholesky(xx: float, xy: float, xh: float, yy: float, yh: float, hh: float) -> _Triangle:
    """Return L of L Lᵀ, the matrix given by its upper triangle: l11, l21, l22, l31, l32, l33."""
    l11 = math.sqrt(xx)
    l21, l31 = xy / l11, xh / l11
    l22 = math.sqrt(_less(yy, l21 * l21))
    l32 = (yh - l31 * l21) / l22
    return l11, l21, l22, l31, l32, math.sqrt(_less(hh, l31 * l31 + l32 * l32))


def _solved(triangle: _Triangle, x: float, y: float, h: float) -> tuple[float, float, float]:
    """Return L⁻¹ (x, y, h)."""
    l11, l21, l22, l31, l32, l33 = triangle
    first = x / l11
    second = (y - l21 * first) / l22
    return first, second, (h - l31 * first - l32 * second) / l33


def _less(variance: float, known: float) -> float:
    """Return the rest of a variance, at least its rounding error, so that it stays positive."""
    return max(variance - known, _ROUNDING * variance)


def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
