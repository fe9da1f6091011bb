"""How a pose fix corrects the belief: the gate, streaks of rejected fixes, and how noisy fixes turn out to be.

Sources: Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 5.4 (gate);
R. K. Mehra, On the identification of variances and adaptive Kalman filtering, IEEE Trans. Automatic Control 15, 1970.
"""

import math
from typing import NamedTuple

from hil.core.types import MeasuredPose, PoseCovariance
from hil.estimation.belief import Belief, Covariance

_LEAST_SHARE = 1e-6
_ROUNDING = 1e-13
# Two fixes further apart than this squared distance are no noise: of fixes twice as noisy as told 1 in 1000 is.
_NO_NOISE = 65.0
# What is told of the noise counts as much as so many fixes; of those that came, so many count at most.
_TOLD, _PAIRS = 20, 200
# Less noise than is told may be learnt, so that what is learnt is right on average, but it is never used.
_LEAST_NOISE = 0.5
_Triangle = tuple[float, float, float, float, float, float]


class Acceptance(NamedTuple):
    """When fixes are accepted: the largest squared Mahalanobis distance, or after how many rejected ones in a row.

    ``bias_rad2_s2`` is the least variance of the bias after a restart, whose cause may be a jump of the bias.
    ``noise`` is the largest factor on the variances of fixes that is learnt; 1 believes what they tell.
    """

    gate: float
    streak: int
    bias_rad2_s2: float
    noise: float


def corrected(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    """Return the belief corrected by a fix of the same instant.

    A fix is rejected if it is beyond the gate, or if its covariance is invalid or nearly singular. When enough fixes in
    a row are beyond the gate, but agree with one another and with the motion between them, the robot was not where it
    was believed to be. Then the belief starts anew from the last of them.
    """
    r = fix.covariance
    if min(r.xx_m2, r.yy_m2, r.hh_rad2) <= 0.0 or not is_regular(*r, share=_LEAST_SHARE):
        return belief._replace(rejected=belief.rejected + 1)
    apart = _apart(belief, fix)
    belief = _learnt(belief, apart, acceptance.noise)
    if not belief.is_known:
        after = _restarted(belief, fix, acceptance)._replace(restarts=belief.restarts)
    else:
        after = _combined(belief, fix, acceptance.gate) or _rejected(belief, fix, apart, acceptance)
    return after._replace(last_fix=fix, last_belief=after._replace(last_fix=None, last_belief=None))


def _combined(belief: Belief, fix: MeasuredPose, gate: float) -> Belief | None:
    """Return the belief with a fix that is within the gate: x ← x + K v, P ← P - K H P; None for one beyond it."""
    p, r = belief.covariance, _noisy(fix, belief)
    vx, vy = fix.pose.x_m - belief.x_m, fix.pose.y_m - belief.y_m
    vh = math.remainder(fix.pose.heading_rad - belief.heading_rad, math.tau)
    # L Lᵀ = P + R; W = L⁻¹ H P has one column each of x, y, heading, bias, scale. Then K v = Wᵀ L⁻¹ v, K H P = Wᵀ W.
    factor = _cholesky(
        p.xx + r.xx_m2, p.xy + r.xy_m2, p.xh + r.xh_m_rad, p.yy + r.yy_m2, p.yh + r.yh_m_rad, p.hh + r.hh_rad2
    )
    v = _solved(factor, vx, vy, vh)
    if _dot(v, v) > gate:
        return None
    x, y = _solved(factor, p.xx, p.xy, p.xh), _solved(factor, p.xy, p.yy, p.yh)
    h, b = _solved(factor, p.xh, p.yh, p.hh), _solved(factor, p.xb, p.yb, p.hb)
    s = _solved(factor, p.xs, p.ys, p.hs)
    covariance = Covariance(
        _less(p.xx, _dot(x, x)),
        p.xy - _dot(x, y),
        p.xh - _dot(x, h),
        p.xb - _dot(x, b),
        p.xs - _dot(x, s),
        _less(p.yy, _dot(y, y)),
        p.yh - _dot(y, h),
        p.yb - _dot(y, b),
        p.ys - _dot(y, s),
        _less(p.hh, _dot(h, h)),
        p.hb - _dot(h, b),
        p.hs - _dot(h, s),
        _less(p.bb, _dot(b, b)),
        p.bs - _dot(b, s),
        _less(p.ss, _dot(s, s)),
    )
    return Belief(
        belief.time_ns,
        belief.x_m + _dot(x, v),
        belief.y_m + _dot(y, v),
        belief.heading_rad + _dot(h, v),
        belief.bias_rad_s + _dot(b, v),
        belief.scale + _dot(s, v),
        covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        rejected=belief.rejected,
        restarts=belief.restarts,
        noise=belief.noise,
        pairs=belief.pairs,
    )


def gate_of(probability: float) -> float:
    """Return the squared Mahalanobis distance that bounds right fixes with this probability (χ², 3 degrees)."""
    low, high = 0.0, 1000.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        # The distribution function of chi-square with three degrees of freedom in closed form.
        below = math.erf(math.sqrt(0.5 * middle)) - math.sqrt(2.0 * middle / math.pi) * math.exp(-0.5 * middle)
        low, high = (middle, high) if below < probability else (low, middle)
    return high


def _rejected(belief: Belief, fix: MeasuredPose, apart: float | None, acceptance: Acceptance) -> Belief:
    agrees = belief.streak > 0 and apart is not None and apart <= acceptance.gate
    count = belief.streak + 1 if agrees else 1
    if count >= acceptance.streak:
        return _restarted(belief, fix, acceptance)
    return belief._replace(rejected=belief.rejected + 1, streak=count)


def _restarted(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    """Return the belief in the pose of a fix alone, with more variance of the gyro's bias."""
    r, p = _noisy(fix, belief), belief.covariance
    bias_rad2_s2 = max(p.bb, acceptance.bias_rad2_s2)
    turned = math.remainder(fix.pose.heading_rad - belief.heading_rad, math.tau)
    return Belief(
        belief.time_ns,
        fix.pose.x_m,
        fix.pose.y_m,
        belief.heading_rad + turned,
        belief.bias_rad_s,
        belief.scale,
        Covariance(
            r.xx_m2, r.xy_m2, r.xh_m_rad, 0.0, 0.0,
            r.yy_m2, r.yh_m_rad, 0.0, 0.0,
            r.hh_rad2, 0.0, 0.0,
            bias_rad2_s2, 0.0,
            p.ss,
        ),
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        rejected=belief.rejected,
        restarts=belief.restarts + 1,
        noise=belief.noise,
        pairs=belief.pairs,
    )  # fmt: skip


def _learnt(belief: Belief, apart: float | None, most: float) -> Belief:
    """Return the belief with the noise of fixes learnt from how far the newest two are apart.

    The squared distance is 3 on average if the noise is right. Two successive fixes are compared with each other and
    not with the belief, because an error of the belief, such as the gyro's bias, is the same in both.
    """
    if apart is None or not apart <= _NO_NOISE:
        return belief
    noise = belief.noise * math.exp((apart / 3.0 - 1.0) / (_TOLD + belief.pairs))
    return belief._replace(noise=min(max(noise, _LEAST_NOISE), most), pairs=min(belief.pairs + 1, _PAIRS))


def _apart(belief: Belief, fix: MeasuredPose) -> float | None:
    """Return the squared Mahalanobis distance of a fix from the last one, moved on by the robot's motion since."""
    last, then = belief.last_fix, belief.last_belief
    if last is None or then is None:
        return None
    # The motion since, turned from the believed heading into that of the last fix.
    c = math.cos(last.pose.heading_rad - then.heading_rad)
    s = math.sin(last.pose.heading_rad - then.heading_rad)
    way_x, way_y = belief.x_m - then.x_m, belief.y_m - then.y_m
    dx, dy = c * way_x - s * way_y, s * way_x + c * way_y
    r, q = _times(belief.noise, fix.covariance), _times(belief.noise, last.covariance)
    grown, before = belief.covariance, then.covariance
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
    return _dot(apart, apart)


def _noisy(fix: MeasuredPose, belief: Belief) -> PoseCovariance:
    """Return the covariance of a fix with the noise that was learnt.

    It is at least what the fix tells: errors of a localisation that last longer than from one fix to the next, such as
    those of its map, do not show in a pair.
    """
    return _times(max(1.0, belief.noise), fix.covariance)


def _times(factor: float, covariance: PoseCovariance) -> PoseCovariance:
    return PoseCovariance(*[factor * entry for entry in covariance])


def is_regular(a: float, ab: float, ac: float, b: float, bc: float, c: float, share: float) -> bool:
    """Return whether Cholesky's last two pivots are at least this share of their diagonal elements.

    The matrix is given by its upper triangle, row by row; its diagonal is positive.
    """
    second = b - ab * ab / a
    if second < share * b:
        return False
    mixed = bc - ab * ac / a
    return c - ac * ac / a - mixed * mixed / second >= share * c


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
