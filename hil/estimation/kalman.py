"""The error-state Kalman filter: belief in pose, gyro bias and wheel scale, and how motion and pose fixes change it.

Pure functions from one belief to the next, so that the past can be recomputed. The error is (x, y, heading,
gyro bias, wheel scale), in the world frame. Written out in plain floats: with NumPy a step costs ten times as much.

Sources: J. Solà, Quaternion kinematics for the error-state Kalman filter, 2017, section 5, here in the plane;
Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section 5.4 (gate);
R. K. Mehra, On the identification of variances and adaptive Kalman filtering, IEEE Trans. Automatic Control 15, 1970.
"""

import math
from typing import NamedTuple

from hil.core.types import MeasuredPose, Pose, PoseCovariance

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
    counts the streaks that were accepted. ``noise`` is the factor on the variances of fixes, as learnt from so many
    ``pairs`` of successive ones. ``last_fix`` is the newest fix, accepted or not; ``last_belief`` the belief after it.
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
    It does not apply to their turn, which depends on the wheels' lever about the centre too.
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

    The displacement is rotated by the heading in the middle of the step. Its noise is the same in all directions; the
    noise of the heading acts at the end of the step.
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


_LEAST_SHARE = 1e-6
_ROUNDING = 1e-13
# Nothing is learnt from two fixes further apart (squared Mahalanobis distance): it is no noise. Of fixes with twice the
# reported noise 1 in 1000 is so far.
_NO_NOISE = 65.0
# The reported noise counts as much as this number of pairs; at most this number of received pairs count.
_TOLD, _PAIRS = 20, 200
# Less noise than reported may be learnt, so that the mean is right, but ``_noisy`` never uses less than the reported.
_LEAST_NOISE = 0.5
_Triangle = tuple[float, float, float, float, float, float]


class Acceptance(NamedTuple):
    """When fixes are accepted: within the squared Mahalanobis distance ``gate``, or at the end of such a ``streak``.

    ``bias_rad2_s2`` is the least variance of the bias after a restart, whose cause may be a jump of the bias.
    ``noise`` is the largest factor on the variances of fixes that is learnt; with 1 the reported ones are used.
    """

    gate: float
    streak: int
    bias_rad2_s2: float
    noise: float


def corrected(belief: Belief, fix: MeasuredPose, acceptance: Acceptance) -> Belief:
    """Return the belief corrected by a fix of the same instant.

    A fix is rejected if it is beyond the gate, or if its covariance is invalid or nearly singular. When enough fixes in
    a row are beyond the gate, but agree with one another and with the motion between them, the robot was not where it
    was believed to be. Then the belief starts again from the last of them.
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
    # A fix measures the first three states: H = [I 0], so H P is the first three rows of P, and S = H P Hᵀ + R = L Lᵀ.
    # With W = L⁻¹ H P, K v = Wᵀ L⁻¹ v and K H P = Wᵀ W. Below, x, y, h, b, s are W's columns, of the states x, y,
    # heading, bias and scale; v is L⁻¹ v.
    factor = _cholesky(
        p.xx + r.xx_m2, p.xy + r.xy_m2, p.xh + r.xh_m_rad, p.yy + r.yy_m2, p.yh + r.yh_m_rad, p.hh + r.hh_rad2
    )
    v = _solved(factor, vx, vy, vh)
    if _dot(v, v) > gate:
        return None
    x, y = _solved(factor, p.xx, p.xy, p.xh), _solved(factor, p.xy, p.yy, p.yh)
    h, b = _solved(factor, p.xh, p.yh, p.hh), _solved(factor, p.xb, p.yb, p.hb)
    s = _solved(factor, p.xs, p.ys, p.hs)
    # P - Wᵀ W, by the rows of its upper triangle; only a variance needs protection from rounding.
    covariance = Covariance(
        xx=_less(p.xx, _dot(x, x)),
        xy=p.xy - _dot(x, y),
        xh=p.xh - _dot(x, h),
        xb=p.xb - _dot(x, b),
        xs=p.xs - _dot(x, s),
        yy=_less(p.yy, _dot(y, y)),
        yh=p.yh - _dot(y, h),
        yb=p.yb - _dot(y, b),
        ys=p.ys - _dot(y, s),
        hh=_less(p.hh, _dot(h, h)),
        hb=p.hb - _dot(h, b),
        hs=p.hs - _dot(h, s),
        bb=_less(p.bb, _dot(b, b)),
        bs=p.bs - _dot(b, s),
        ss=_less(p.ss, _dot(s, s)),
    )
    return belief._replace(
        x_m=belief.x_m + _dot(x, v),
        y_m=belief.y_m + _dot(y, v),
        heading_rad=belief.heading_rad + _dot(h, v),
        bias_rad_s=belief.bias_rad_s + _dot(b, v),
        scale=belief.scale + _dot(s, v),
        covariance=covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        streak=0,
    )


def gate_of(probability: float) -> float:
    """Return the squared Mahalanobis distance below which a correct fix is with this probability (χ², 3 degrees)."""
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
    covariance = Covariance(
        xx=r.xx_m2, xy=r.xy_m2, xh=r.xh_m_rad, xb=0.0, xs=0.0,
        yy=r.yy_m2, yh=r.yh_m_rad, yb=0.0, ys=0.0,
        hh=r.hh_rad2, hb=0.0, hs=0.0,
        bb=bias_rad2_s2, bs=0.0,
        ss=p.ss,
    )  # fmt: skip
    return belief._replace(
        x_m=fix.pose.x_m,
        y_m=fix.pose.y_m,
        heading_rad=belief.heading_rad + turned,
        covariance=covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        accepted=belief.accepted + 1,
        restarts=belief.restarts + 1,
        streak=0,
    )


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
    whitened = _solved(
        _cholesky(*together),
        fix.pose.x_m - last.pose.x_m - dx,
        fix.pose.y_m - last.pose.y_m - dy,
        math.remainder(fix.pose.heading_rad - last.pose.heading_rad - turned, math.tau),
    )
    return _dot(whitened, whitened)


def _noisy(fix: MeasuredPose, belief: Belief) -> PoseCovariance:
    """Return the covariance of a fix with the noise that was learnt.

    It is at least the reported one: slow errors of a localisation, such as those of its map, do not show in a pair of
    fixes.
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
    """Return ``variance - known``, at least the rounding error of ``variance``, so that it stays positive."""
    return max(variance - known, _ROUNDING * variance)


def _dot(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
