"""The pose by wheels, gyro and pose fixes, which may be late, out of order, wrong or missing."""

import math
from collections.abc import Sequence

from hil.core.kinematics import BodyTwist, body_twist, to_world
from hil.core.model import RobotModel
from hil.core.signals import EstimatorSignals
from hil.core.types import NAN, Axes, MeasuredPose, Pose, PoseFix, State
from hil.estimation.estimators import FilterOptions
from hil.estimation.history import History
from hil.estimation.inertial import Inertial, Travel
from hil.estimation.kalman import (
    BIAS,
    FORWARD,
    GYRO,
    HEADING,
    LEFT,
    Belief,
    Lasting,
    Model,
    Priors,
    gate_of,
    position_sigma_m,
    start,
)
from hil.estimation.measurement import DEGRADED, GOOD, LOST, NO_STATUS, Estimator, Measurement, measured_twist
from hil.estimation.motion_sums import Step
from hil.estimation.slip import SlipDetector
from hil.estimation.wheel_motion import Motion, MotionReader

_NONE = (0.0, 0.0, 0.0)
_NO_FIX = (NAN, NAN, NAN, NAN)
_MOST_M = 0.01
_MOST_RAD = 0.01


class Release:
    """Spreads the correction of a pose fix over time, with the time constant ``release_s`` [s]; with 0 the pose jumps.

    A law must not take a correction for motion. At most 10 mm and 10 mrad are held back. The rest of a larger
    correction, as after slip, is applied at once: acting on a wrong pose does more harm than a jump.
    """

    def __init__(self, release_s: float) -> None:
        self._release_s = release_s
        self._held: Axes = _NONE

    def correct(self, before: Pose, after: Pose, *, is_restarted: bool) -> None:
        """Hold back the change that fixes made. A restart of the filter is applied at once."""
        if is_restarted or self._release_s == 0.0:
            self._held = _NONE
            return
        x, y, heading = self._held
        x += after.x_m - before.x_m
        y += after.y_m - before.y_m
        heading += after.heading_rad - before.heading_rad
        # One factor for all three, so that the reported pose lies between both poses.
        share = 1.0 / max(1.0, math.hypot(x, y) / _MOST_M, abs(heading) / _MOST_RAD)
        self._held = share * x, share * y, share * heading

    def advance(self, dt_s: float) -> None:
        """Release the share that belongs to ``dt_s`` [s]."""
        if self._held is not _NONE:
            rest = math.exp(-dt_s / self._release_s)
            x, y, heading = self._held
            self._held = rest * x, rest * y, rest * heading

    def pose(self, believed: Pose) -> Pose:
        """Return the pose to report."""
        x, y, heading = self._held
        return Pose(believed.x_m - x, believed.y_m - y, believed.heading_rad - heading)


_NS = 1e9
_AHEAD_NS = 100_000_000
_WAITING_AT_MOST = 32
# Unmeasured motion around a reset of the robot: the shipped ramp of 0.2 s, from 1.5 m/s and 2 rad/s.
_UNSEEN_M = 0.15
_UNSEEN_RAD = 0.2
# If all fixes are rejected for this time, they refute the inertial sensors; one alone may be an outlier.
_REFUTED_NS = 250_000_000
# Slip keeps its direction for about this time: within it errors add up, beyond it their variances do.
_SLIP_LASTS_S = 0.2
# After this many times ``restart_after`` rejected fixes that agree, nobody knows where the robot is.
_CONTRADICTED = 3


class FusedEstimator(Estimator):
    """An error-state Kalman filter on odometry (``kalman``), with its recent past (``History``).

    Between fixes the pose follows wheels and gyro, and the covariance grows with the distance, and with the speed of
    detected slip. A fix may have a stamp up to 0.1 s ahead of the newest measurement, because of the robot's clock and
    the link's latency: it waits until then. Without fixes for ``fix_timeout_s`` the health is DEGRADED. When the
    position's standard deviation exceeds ``lost_sigma_m`` the health is LOST, until fixes reduce it. The pose follows a
    correction with the time constant ``release_s``.
    """

    def __init__(
        self,
        model: RobotModel,
        start_pose: Pose,
        counts_per_revolution: int,
        slip_threshold_m_s: float,
        options: FilterOptions,
    ) -> None:
        self._model = model
        self._start_pose = start_pose
        self._options = options
        lasting = (
            Lasting(options.fix_held_share, options.fix_held_s, math.inf),
            Lasting(options.fix_map_share, math.inf, options.fix_map_scale_m),
        )
        self._reader = MotionReader(model, counts_per_revolution)
        self._filter = Model(
            gate_of(options.gate_probability),
            options.restart_after,
            options.gyro_bias_sigma_rad_s**2,
            options.fix_noise_most**2,
            model.lever_m,
            # The disagreement is a quarter of four angles, each the difference of two counts.
            self._reader.count_m**2 / 24.0,
            tuple(one for one in lasting if one.share > 0.0),
        )
        self._erring_m_s = slip_threshold_m_s
        self._slip = SlipDetector(model.lever_m, slip_threshold_m_s, self._reader.count_m)
        self._inertial = Inertial()
        self._last: Measurement | None = None
        self._history: History | None = None
        self._before: Belief | None = None
        self._waiting: list[MeasuredPose] = []
        self._release = Release(options.release_s)
        self._status = NO_STATUS
        self._told: Belief | None = None
        self._sigmas = NAN, NAN
        self._refused = {"too_late": 0, "double": 0, "ahead": 0}

    @property
    def status(self) -> EstimatorSignals:
        """Uncertainty and health of the last update."""
        return self._status

    def fix_figures(self) -> dict[str, int]:
        """Return the number of fixes by outcome; ``restarts`` counts streaks of rejected ones that were accepted."""
        belief = self._history.known if self._history is not None else self._before
        accepted, rejected, restarts = (belief.accepted, belief.rejected, belief.restarts) if belief else (0, 0, 0)
        return {"accepted": accepted, "rejected": rejected, **self._refused, "restarts": restarts}

    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Return the estimate; None before the first fix if the start is unknown."""
        last = self._last
        if last is None or self._history is None:
            self._history = self._begun(measurement.robot_time_ns)
            forward_m_s, left_m_s, _ = measured_twist(self._model, measurement)
            self._inertial.restart((forward_m_s, left_m_s))
            self._last = last = measurement
        elif measurement.robot_time_ns > last.robot_time_ns:
            motion = self._reader.between(last, measurement)
            self._move(self._history, motion, measurement.robot_time_ns)
            self._release.advance(motion.dt_s)
            self._last = last = measurement
        if fixes or self._waiting:
            before, known = self._history.pose, self._history.known
            self._sort(self._history, last.robot_time_ns, fixes)
            self._correct(self._history, before, known)
        belief = self._history.known
        self._status = self._signals(belief, last.robot_time_ns, fixes[-1] if fixes else None)
        if not belief.is_known:
            return None
        pose = self._release.pose(self._history.pose)
        return State(pose, to_world(self._twist(last, belief), pose.heading_rad))

    def restart(self) -> None:
        """Continue from the last belief, with more variance for unmeasured motion, and the same gyro bias."""
        if self._history is not None:
            self._before = self._history.newest
        self._history = None
        self._last = None
        self._waiting.clear()
        self._slip.restart()

    def _begun(self, time_ns: int) -> History:
        options, before = self._options, self._before
        if before is not None:
            first = _unsure(before)._replace(time_ns=time_ns, fixed_ns=time_ns - (before.time_ns - before.fixed_ns))
        else:
            priors = Priors(
                options.start_sigma_m,
                options.start_sigma_rad,
                options.gyro_bias_sigma_rad_s,
                options.gyro_scale_sigma,
                options.wheels_scale_sigma,
                options.left_scale_sigma,
                options.wheels_differ_sigma,
            )
            first = start(time_ns, self._start_pose if options.begin == "start" else None, priors, self._filter)
        return History(first, round(options.history_s * _NS), self._filter)

    def _move(self, history: History, motion: Motion, time_ns: int) -> None:
        belief, inertial = history.known, self._inertial
        if inertial.is_inertial and _rejects(belief):
            inertial.refute()
        seen, bias_rad_s = _calibrated(motion, belief, self._model.lever_m)
        slip_m_s = self._slip.update(seen, bias_rad_s, inertial.bias_m_s2)
        *again, newest = inertial.update(seen, bias_rad_s, slip_m_s)
        if again:
            before = history.pose
            history.replace([self._step(travel, travel.motion, slip_m_s) for travel in again])
            self._correct(history, before, belief)
        history.append(self._step(newest, motion if newest.is_rolled else newest.motion, slip_m_s), time_ns)

    def _correct(self, history: History, before: Pose, known: Belief) -> None:
        after = history.known
        is_restarted = not known.is_known or after.restarts != known.restarts
        self._release.correct(before, history.pose, is_restarted=is_restarted)

    def _step(self, travel: Travel, motion: Motion, slip_m_s: float) -> Step:
        options, lever_m = self._options, self._model.lever_m
        dt_s, forward_m, left_m, turned_rad, gyro_rad, disagreement_m, _, _ = motion
        yaw_m = lever_m * turned_rad
        way_m = math.hypot(forward_m, left_m) + abs(yaw_m)
        position_m2 = options.wheels_sigma_m**2 * way_m + travel.sigma_m_s**2 * dt_s * _SLIP_LASTS_S
        biased_s, heading_rad2 = dt_s, (options.gyro_noise_rad_s * dt_s) ** 2
        if math.isnan(gyro_rad):
            gyro_rad, biased_s = turned_rad, 0.0
            slip_rad_s = travel.sigma_m_s / lever_m
            heading_rad2 = options.wheels_sigma_rad**2 * way_m + slip_rad_s**2 * dt_s * _SLIP_LASTS_S
        return Step(
            forward_m,
            left_m,
            gyro_rad,
            biased_s,
            position_m2,
            heading_rad2,
            options.gyro_bias_walk_rad_s**2 * dt_s,
            travel.is_rolled,
            yaw_m,
            NAN if travel.sigma_m_s > 0.0 else disagreement_m,
            (self._erring_m_s + slip_m_s) * dt_s,
        )

    def _twist(self, measurement: Measurement, belief: Belief) -> BodyTwist:
        """Return the twist by the wheels as calibrated, or by the inertial sensors, and the gyro's yaw rate."""
        model = self._model
        forward, left, turning = body_twist(measurement.speed_rad_s, model.wheel_radius_m, model.lever_m)
        yaw_rate = measurement.yaw_rate_rad_s
        true_rate = turning if math.isnan(yaw_rate) else belief.turn(yaw_rate, 1.0)
        if self._inertial.is_inertial:
            return BodyTwist(*self._inertial.velocity, true_rate)
        return BodyTwist(*belief.calibrated(forward, left, model.lever_m * turning), true_rate)

    def _sort(self, history: History, now_ns: int, fixes: Sequence[MeasuredPose]) -> None:
        """Insert due fixes, keep those ahead of the newest measurement, count those out of reach."""
        due: list[MeasuredPose] = []
        later: list[MeasuredPose] = []
        for fix in (*self._waiting, *fixes):
            if fix.time_ns <= history.begin_ns:
                self._refused["too_late"] += 1
            elif fix.time_ns <= now_ns:
                due.append(fix)
            elif fix.time_ns <= now_ns + _AHEAD_NS and len(later) < _WAITING_AT_MOST:
                later.append(fix)
            else:
                self._refused["ahead"] += 1
        self._waiting = later
        if due:
            self._refused["double"] += history.insert(due)

    def _signals(self, belief: Belief, now_ns: int, fix: MeasuredPose | None) -> EstimatorSignals:
        if belief is not self._told:
            # Once for each belief: the root of a matrix costs as much as the rest of a tick.
            self._told, self._sigmas = (
                belief,
                (
                    position_sigma_m(belief.covariance),
                    math.sqrt(max(0.0, float(belief.covariance[HEADING, HEADING]))),
                ),
            )
        sigma_m, sigma_rad = self._sigmas
        age_ns = now_ns - belief.fixed_ns
        health = DEGRADED if age_ns > self._options.fix_timeout_s * _NS else GOOD
        is_contradicted = belief.streak >= _CONTRADICTED * self._options.restart_after
        if not belief.is_known or is_contradicted or sigma_m > self._options.lost_sigma_m:
            health = LOST
        return EstimatorSignals(
            sigma_m,
            sigma_rad,
            belief.mean[BIAS],
            belief.mean[FORWARD],
            belief.mean[LEFT],
            belief.mean[GYRO],
            math.sqrt(max(1.0, belief.noise)),
            belief.accepted,
            belief.rejected,
            belief.restarts,
            age_ns * 1e-6,
            float(self._slip.is_slipping or self._inertial.is_inertial),
            health,
            *(_NO_FIX if fix is None else (fix.time_ns / _NS, *fix.pose)),
        )


def _rejects(belief: Belief) -> bool:
    return belief.last_fix is not None and belief.last_fix.time_ns - belief.fixed_ns >= _REFUTED_NS


def _calibrated(motion: Motion, belief: Belief, lever_m: float) -> tuple[Motion, float]:
    """Return a motion as the calibrated wheels have it, and the gyro's bias with what its scale adds to that."""
    dt_s, forward_m, left_m, turned_rad, gyro_rad, disagreement_m, *gained = motion
    yaw_m = lever_m * turned_rad
    true_forward_m, true_left_m = belief.calibrated(forward_m, left_m, yaw_m)
    _, _, _, bias_rad_s, gyro, _, _, cross, yaw, front, *_ = belief.mean
    disagreement_m += cross * yaw_m + yaw * left_m + front * forward_m
    if not math.isnan(gyro_rad):
        bias_rad_s -= (gyro - 1.0) * gyro_rad / dt_s
    return Motion(dt_s, true_forward_m, true_left_m, turned_rad, gyro_rad, disagreement_m, *gained), bias_rad_s


def _unsure(belief: Belief) -> Belief:
    """Return the belief after a reset of the robot: it moved by an unknown way, and the streak of fixes ends."""
    covariance = belief.covariance.copy()
    covariance[[0, 1, 2], [0, 1, 2]] += _UNSEEN_M**2, _UNSEEN_M**2, _UNSEEN_RAD**2
    return belief._replace(covariance=covariance, streak=0, last_fix=None, last_belief=None)
