"""The error-state Kalman filter: belief in pose and sensors, and how motion and pose fixes change it.

Pure functions from one belief to the next, so that the past can be recomputed. The states are

    x, y, heading, b     pose in the world frame, bias of the gyro
    g, s, l              scales: true over measured turn by the gyro, way forward and way to the left by the wheels
    p, q, h              how the wheels differ: half of the relative differences of their radii, left, yaw, front
    e                    errors of fixes that last, three a kind (x, y, heading), in units of their deviation

With the wheels' forward f, left v and yaw y (their turn times the lever) the robot moves by

    forward = s f + p v + q y        left = l v + p f + h y        turn = g φ - b t

and wheels that roll without slip obey d + p y + q v + h f = 0, where d is the disagreement of front and rear wheels.

Sources: J. Solà, Quaternion kinematics for the error-state Kalman filter, 2017, section 5, here in the plane;
Y. Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, sections 5.4 (gate) and 8.3 (errors
that last); R. K. Mehra, On the identification of variances and adaptive Kalman filtering, IEEE Trans. AC 15, 1970.
"""

import math
from cmath import rect
from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from hil.core.types import MeasuredPose, Pose, PoseCovariance
from hil.estimation.motion_sums import MotionSums

Array = npt.NDArray[np.float64]
_Root = tuple[float, float, float, float, float, float]
_Number = TypeVar("_Number", float, Array)

HEADING, BIAS, GYRO, FORWARD, LEFT, CROSS, YAW, FRONT, LASTING = range(2, 11)
_UNKNOWN_VARIANCE = 1e6
_LEAST_SHARE, _LEAST_RATIO = 1e-6, 1e-8
# Lasting errors never explain all of a fix, so that its covariance stays regular.
_LEAST_WHITE = 1e-3
_ROUNDING = 1e-13
# Nothing is learnt from two fixes further apart (squared Mahalanobis distance): it is no noise. Of fixes with twice the
# reported noise 1 in 1000 is so far.
_NO_NOISE = 65.0
# The reported noise counts as much as this number of pairs; at most this number of received pairs count.
_TOLD, _PAIRS = 20, 200
# Less noise than reported may be learnt, so that the mean is right, but ``_noise`` never uses less than the reported.
_LEAST_NOISE = 0.5
# Wheels that roll disagree by this share of their way, and by no more than this many deviations: else they slip.
_CREEP, _ROLLING_GATE = 3e-3, 4.0
_LEAST_WAY_M = 1e-3


class Lasting(NamedTuple):
    """A part of a fix's error that lasts: its share of the variance, the time and the way in which it changes.

    With ``lasts_s`` or ``lasts_m`` infinite it does not change with time, or with the robot's place.
    """

    share: float
    lasts_s: float
    lasts_m: float

    def kept(self, seconds: float, way_m: float) -> float:
        """Return the correlation of the error now with that of so long ago, so far away."""
        return math.exp(-seconds / self.lasts_s - way_m / self.lasts_m)


class Priors(NamedTuple):
    """Standard deviations at the start: each axis of the position, the heading, and the sensors' states."""

    position_m: float
    heading_rad: float
    bias_rad_s: float
    gyro: float
    forward: float
    left: float
    differ: float


class Model(NamedTuple):
    """What is known of fixes and wheels.

    Fixes are accepted within the squared Mahalanobis distance ``gate``, or at the end of a ``streak`` of rejected ones.
    ``bias_rad2_s2`` is the least variance of the bias after a restart, whose cause may be a jump of the bias.
    ``noise`` is the largest factor on the variances of fixes that is learnt; with 1 the reported ones are used.
    ``counted_m2`` is the variance of the wheels' disagreement by the encoders' resolution.
    """

    gate: float
    streak: int
    bias_rad2_s2: float
    noise: float
    lever_m: float
    counted_m2: float = 0.0
    lasting: tuple[Lasting, ...] = ()


class Belief(NamedTuple):
    """The estimate at one instant of robot time: the states' mean and covariance, and what became of fixes.

    ``is_known`` is False before the first fix of a robot without a known start. ``fixed_ns`` is the time of the newest
    accepted fix, and ``erred_m`` how far the robot may have come off its wheels and its gyro since then, unnoticed.
    ``streak`` is the number of rejected fixes in a row that agree with one another, and ``restarts`` counts the streaks
    that were accepted. ``noise`` is the factor on the variances of fixes, as learnt from so many ``pairs`` of
    successive ones. ``last_fix`` is the newest fix, accepted or not; ``last_belief`` the belief after it.
    """

    time_ns: int
    mean: tuple[float, ...]
    covariance: Array
    is_known: bool
    fixed_ns: int
    erred_m: float = 0.0
    accepted: int = 0
    rejected: int = 0
    restarts: int = 0
    streak: int = 0
    noise: float = 1.0
    pairs: int = 0
    last_fix: MeasuredPose | None = None
    last_belief: "Belief | None" = None

    @property
    def pose(self) -> Pose:
        """The mean of the pose."""
        return Pose(*self.mean[:3])

    def calibrated(self, forward: float, left: float, yaw: float) -> tuple[float, float]:
        """Return the true way, or velocity, forward and left of what the wheels say."""
        _, _, _, _, _, s, l, p, q, h, *_ = self.mean  # noqa: E741 - the states' names
        return s * forward + p * left + q * yaw, l * left + p * forward + h * yaw

    def turn(self, gyro: float, time_s: float) -> float:
        """Return the true turn in this time of what the gyro says; the yaw rate for the rate and 1."""
        return self.mean[GYRO] * gyro - self.mean[BIAS] * time_s


def start(time_ns: int, pose: Pose | None, priors: Priors, model: Model) -> Belief:
    """Return the belief in a start with these deviations; without one (None) the first fix is taken as it is."""
    position_m2, heading_rad2 = priors.position_m**2, priors.heading_rad**2
    if pose is None:
        position_m2 = heading_rad2 = _UNKNOWN_VARIANCE
    sensors = (priors.bias_rad_s, priors.gyro, priors.forward, priors.left, *[0.5 * priors.differ] * 3)
    lasting = 3 * len(model.lasting)
    variances = [position_m2, position_m2, heading_rad2, *(sigma**2 for sigma in sensors), *[1.0] * lasting]
    mean = (*(pose or (0.0, 0.0, 0.0)), 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0, *[0.0] * lasting)
    return Belief(time_ns, mean, np.diag(variances), is_known=pose is not None, fixed_ns=time_ns)


def pose_after(belief: Belief, sums: MotionSums) -> Pose:
    """Return the mean of the pose after a motion."""
    x, y, heading, b, g, s, l, p, q, h, *_ = belief.mean  # noqa: E741 - the states' names
    forward, left, yaw = sums.forward, sums.left, sums.yaw
    way = sums.unrolled + s * forward + l * left + p * 1j * (forward - left) + (q + 1j * h) * yaw
    moved_by = rect(1.0, heading) * (way + 1j * ((g - 1.0) * sums.by_turn - b * sums.by_time))
    turned = sums.turned_rad + (g - 1.0) * sums.gyro_rad - b * sums.biased_s
    return Pose(x + moved_by.real, y + moved_by.imag, heading + turned)


def moved(belief: Belief, sums: MotionSums, time_ns: int, model: Model) -> Belief:
    """Return the belief at ``time_ns``, after a motion: x ← f(x, u), P ← F P Fᵀ + Q.

    The noise of the position is the same in all directions. Wheels that roll also tell how they differ.
    """
    pose, mean, p = pose_after(belief, sums), belief.mean, belief.covariance
    along, forward, left, yaw = rect(1.0, mean[HEADING]), sums.forward, sums.left, sums.yaw
    across = 1j * along
    by = (
        complex(mean[1] - pose.y_m, pose.x_m - mean[0]),  # heading: the motion, turned by 90 degrees
        -across * sums.by_time,
        across * sums.by_turn,
        along * forward,
        along * left,
        across * (forward - left),
        along * yaw,
        across * yaw,
    )
    lasting = mean[LASTING:]
    rest = [0.0] * len(lasting)
    # The rows of F of the pose; those of the sensors are the identity's.
    f = np.array(
        (
            (1.0, 0.0, *[one.real for one in by], *rest),
            (0.0, 1.0, *[one.imag for one in by], *rest),
            (0.0, 0.0, 1.0, -sums.biased_s, sums.gyro_rad, 0.0, 0.0, 0.0, 0.0, 0.0, *rest),
        )
    )
    if lasting:
        seconds, way_m = (time_ns - belief.time_ns) * 1e-9, abs(by[0])
        kept = [one.kept(seconds, way_m) for one in model.lasting for _ in range(3)]
        lasting = tuple(one * error for one, error in zip(kept, lasting, strict=True))
        fades = np.array([1.0] * LASTING + kept)
        p = fades[:, None] * p * fades + np.diag(1.0 - fades**2)
    moved_p = f @ p
    covariance = p.copy()
    covariance[:3] = moved_p
    covariance[:, :3] = moved_p.T
    # The noises come evenly over the motion: that of the heading turned half of it, and that of the bias the heading.
    position_m2, heading_rad2 = sums.position_m2, sums.heading_rad2
    drifted_rad2_s = 0.5 * sums.biased_s * sums.bias_rad2_s2
    i, j = 0.5 * by[0].real, 0.5 * by[0].imag
    noise = (
        (position_m2 + i * i * heading_rad2, i * j * heading_rad2, i * heading_rad2),
        (i * j * heading_rad2, position_m2 + j * j * heading_rad2, j * heading_rad2),
        (i * heading_rad2, j * heading_rad2, heading_rad2 + sums.biased_s * drifted_rad2_s / 1.5),
    )
    covariance[:3, :3] = moved_p @ f.T + noise
    covariance[BIAS, BIAS] += sums.bias_rad2_s2
    covariance[HEADING, BIAS] -= drifted_rad2_s
    covariance[BIAS, HEADING] -= drifted_rad2_s
    after = belief._replace(
        time_ns=time_ns,
        mean=(*pose, *mean[BIAS:LASTING], *lasting),
        covariance=covariance,
        erred_m=belief.erred_m + sums.erred_m,
    )
    return _rolled(after, sums, model)


def _rolled(belief: Belief, sums: MotionSums, model: Model) -> Belief:
    """Return the belief in the wheels' differences after a motion: 0 = d + p y + q v + h f if they rolled."""
    ways = sums.yaw_m, sums.left_m, sums.forward_m
    way_m = sum(map(abs, ways))
    if not way_m > _LEAST_WAY_M or math.isnan(sums.disagreement_m):
        return belief
    crossed = belief.covariance[:, CROSS:LASTING] @ ways
    covered = crossed.tolist()
    off_m = -sums.disagreement_m - _dot(belief.mean[CROSS:LASTING], ways)
    variance = _dot(covered[CROSS:LASTING], ways) + model.counted_m2 + (_CREEP * way_m) ** 2
    if off_m**2 > _ROLLING_GATE**2 * variance:
        return belief
    share = off_m / variance
    mean = tuple([state + share * one for state, one in zip(belief.mean, covered, strict=True)])
    crossed *= variance**-0.5
    return belief._replace(mean=mean, covariance=belief.covariance - crossed[:, None] * crossed)


def position_sigma_m(covariance: Array) -> float:
    """Return the standard deviation of the position in its worst direction [m]."""
    (xx, xy), (_, yy) = covariance[:2, :2].tolist()
    return math.sqrt(worst_and_best(xx, xy, yy)[0])


def worst_and_best(xx: float, xy: float, yy: float) -> tuple[float, float]:
    """Return a position's variances in its worst and its best direction; the best is 0 or less for no covariance."""
    worst = max(0.0, 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy))
    return worst, (xx * yy - xy * xy) / worst if worst > 0.0 else 0.0


def corrected(belief: Belief, fix: MeasuredPose, model: Model) -> Belief:
    """Return the belief corrected by a fix of the same instant.

    A fix is rejected if it is beyond the gate, or if its covariance is invalid or nearly singular. When enough fixes in
    a row are beyond the gate, but agree with one another and with the motion between them, and the place is one that
    the robot may have come to unnoticed, then the belief starts again from the last of them.
    """
    if not is_regular(fix.covariance, _LEAST_SHARE):
        return belief._replace(rejected=belief.rejected + 1)
    apart = _apart(belief, fix, model)
    belief = _learnt(belief, apart, model.noise)
    if not belief.is_known:
        after = _restarted(belief, fix, model)._replace(restarts=belief.restarts)
    else:
        after = _combined(belief, fix, model) or _rejected(belief, fix, apart, model)
    return after._replace(last_fix=fix, last_belief=after._replace(last_fix=None, last_belief=None))


def _combined(belief: Belief, fix: MeasuredPose, model: Model) -> Belief | None:
    """Return the belief with a fix that is within the gate: x ← x + K v, P ← P - K H P; None for one beyond it.

    S = H P Hᵀ + R = L Lᵀ and W = L⁻¹ H P give K v = Wᵀ L⁻¹ v and K H P = Wᵀ W.
    """
    off, root, crossed = _seen(belief, fix, model)
    v = _solved(root, *off)
    if _dot(v, v) > model.gate:
        return None
    w = np.array(_solved(root, *crossed))
    covariance = belief.covariance - w.T @ w
    # A variance stays positive, whatever the rounding.
    covariance.flat[:: len(covariance) + 1] = np.maximum(
        covariance.diagonal(), _ROUNDING * belief.covariance.diagonal()
    )
    return belief._replace(
        mean=tuple((v @ w + belief.mean).tolist()),
        covariance=covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        erred_m=0.0,
        accepted=belief.accepted + 1,
        streak=0,
    )


def _seen(belief: Belief, fix: MeasuredPose, model: Model) -> tuple[tuple[float, float, float], _Root, Array]:
    """Return how far a fix is off, the root of S, and H P.

    A fix measures the pose, and the errors that last by the root of their share of its covariance.
    """
    p, noise, off = belief.covariance, max(1.0, belief.noise) * matrix(fix.covariance), _off(belief, fix.pose)
    if not model.lasting:
        return off, _root(p[:3, :3] + noise), p[:3]
    h = np.column_stack((np.eye(3, LASTING), _lasting(noise, model)))
    white = max(_LEAST_WHITE, 1.0 - sum(one.share for one in model.lasting))
    crossed = h @ p
    x, y, heading = (np.array(off) - h[:, LASTING:] @ belief.mean[LASTING:]).tolist()
    return (x, y, heading), _root(crossed @ h.T + white * noise), crossed


def _lasting(noise: Array, model: Model) -> Array:
    """Return how the errors that last enter a fix with this covariance."""
    l11, l21, l22, l31, l32, l33 = _root(noise)
    root = np.array(((l11, 0.0, 0.0), (l21, l22, 0.0), (l31, l32, l33)))
    return np.column_stack([math.sqrt(one.share) * root for one in model.lasting])


def _off(belief: Belief, pose: Pose) -> tuple[float, float, float]:
    x, y, heading, *_ = belief.mean
    return pose.x_m - x, pose.y_m - y, math.remainder(pose.heading_rad - heading, math.tau)


def gate_of(probability: float) -> float:
    """Return the squared Mahalanobis distance below which a correct fix is with this probability (χ², 3 degrees)."""
    low, high = 0.0, 1000.0
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        # The distribution function of chi-square with three degrees of freedom in closed form.
        below = math.erf(math.sqrt(0.5 * middle)) - math.sqrt(2.0 * middle / math.pi) * math.exp(-0.5 * middle)
        low, high = (middle, high) if below < probability else (low, middle)
    return high


def _rejected(belief: Belief, fix: MeasuredPose, apart: float | None, model: Model) -> Belief:
    agrees = belief.streak > 0 and apart is not None and apart <= model.gate
    count = belief.streak + 1 if agrees else 1
    if count >= model.streak and _is_in_reach(belief, fix, model):
        return _restarted(belief, fix, model)
    return belief._replace(rejected=belief.rejected + 1, streak=count)


def _is_in_reach(belief: Belief, fix: MeasuredPose, model: Model) -> bool:
    """Return whether wheels and gyro may have erred unnoticed as far as to within the gate of a fix."""
    (x, y, turned), root, _ = _seen(belief, fix, model)
    away_m, reach_m, reach_rad = math.hypot(x, y), belief.erred_m, belief.erred_m / model.lever_m
    left = 1.0 - min(1.0, reach_m / away_m) if away_m > 0.0 else 0.0
    v = _solved(root, left * x, left * y, math.copysign(max(0.0, abs(turned) - reach_rad), turned))
    return _dot(v, v) <= model.gate


def _restarted(belief: Belief, fix: MeasuredPose, model: Model) -> Belief:
    """Return the belief in the pose of a fix alone, with more variance of the gyro's bias."""
    noise = max(1.0, belief.noise) * matrix(fix.covariance)
    covariance = belief.covariance.copy()
    covariance[:3] = covariance[:, :3] = 0.0
    covariance[:3, :3] = noise
    covariance[BIAS, BIAS] = max(covariance[BIAS, BIAS], model.bias_rad2_s2)
    if model.lasting:
        covariance[LASTING:] = covariance[:, LASTING:] = 0.0
        covariance[LASTING:, LASTING:] = np.eye(len(covariance) - LASTING)
        covariance[:3, LASTING:] = -_lasting(noise, model)
        covariance[LASTING:, :3] = covariance[:3, LASTING:].T
    _, _, turned = _off(belief, fix.pose)
    mean = belief.mean
    return belief._replace(
        mean=(*fix.pose[:2], mean[HEADING] + turned, *mean[BIAS:LASTING], *[0.0] * len(mean[LASTING:])),
        covariance=covariance,
        is_known=True,
        fixed_ns=fix.time_ns,
        erred_m=0.0,
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


def _apart(belief: Belief, fix: MeasuredPose, model: Model) -> float | None:
    """Return the squared Mahalanobis distance of a fix from the last one, moved on by the robot's motion since."""
    last, then = belief.last_fix, belief.last_belief
    if last is None or then is None:
        return None
    # The motion since, turned from the believed heading into that of the last fix.
    x, y, turned = (now - before for now, before in zip(belief.mean[:3], then.mean[:3], strict=True))
    way = rect(1.0, last.pose.heading_rad - then.mean[HEADING]) * complex(x, y)
    leads = np.array(((1.0, 0.0, -way.imag), (0.0, 1.0, way.real), (0.0, 0.0, 1.0)))
    seconds = (fix.time_ns - last.time_ns) * 1e-9
    changed = 1.0 - sum(one.share * one.kept(seconds, abs(way)) for one in model.lasting)
    grown = np.maximum((belief.covariance - then.covariance).diagonal()[:3], 0.0)
    noise = matrix(fix.covariance) + leads @ matrix(last.covariance) @ leads.T
    together = max(changed, _LEAST_WHITE) * belief.noise * noise
    together.flat[::4] += grown
    v = _solved(
        _root(together),
        fix.pose.x_m - last.pose.x_m - way.real,
        fix.pose.y_m - last.pose.y_m - way.imag,
        math.remainder(fix.pose.heading_rad - last.pose.heading_rad - turned, math.tau),
    )
    return _dot(v, v)


def matrix(covariance: PoseCovariance) -> Array:
    """Return the matrix of a fix's covariance."""
    xx, xy, xh, yy, yh, hh = covariance
    return np.array(((xx, xy, xh), (xy, yy, yh), (xh, yh, hh)))


def is_regular(covariance: PoseCovariance, share: float) -> bool:
    """Return whether a covariance can be inverted, in whatever frame it is given.

    The position's variances in its worst and its best direction differ by at most 1e8, and heading and position leave
    at least ``share`` of each other's variance.
    """
    xx, xy, xh, yy, yh, hh = covariance
    worst, best = worst_and_best(xx, xy, yy)
    if min(xx, yy, hh) <= 0.0 or best < _LEAST_RATIO * worst:
        return False
    return yy * xh * xh - 2.0 * xy * xh * yh + xx * yh * yh <= (1.0 - share) * worst * best * hh


def _root(covariance: Array) -> _Root:
    """Return L of L Lᵀ for three rows and columns: l11, l21, l22, l31, l32, l33. NumPy's costs ten times as much."""
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = covariance.tolist()
    l11 = math.sqrt(xx)
    l21, l31 = xy / l11, xh / l11
    l22 = math.sqrt(max(yy - l21 * l21, _ROUNDING * yy))
    l32 = (yh - l31 * l21) / l22
    return l11, l21, l22, l31, l32, math.sqrt(max(hh - l31 * l31 - l32 * l32, _ROUNDING * hh))


def _solved(root: _Root, x: _Number, y: _Number, h: _Number) -> tuple[_Number, _Number, _Number]:
    """Return L⁻¹ (x, y, h), each a number or a row."""
    l11, l21, l22, l31, l32, l33 = root
    first = x / l11
    second = (y - l21 * first) / l22
    return first, second, (h - l31 * first - l32 * second) / l33


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))
