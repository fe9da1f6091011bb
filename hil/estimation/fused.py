"""The pose by wheels, gyro and pose fixes, which may be late, out of order, wrong or missing."""

import math
from bisect import bisect_left, insort
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from hil.core.kinematics import BodyTwist, to_world
from hil.core.model import RobotModel
from hil.core.signals import EstimatorSignals
from hil.core.types import NAN, Axes, MeasuredPose, Pose, PoseFix, State
from hil.estimation.estimators import FilterOptions
from hil.estimation.inertial import Inertial, Travel
from hil.estimation.kalman import (
    Acceptance,
    Belief,
    Step,
    corrected,
    gate_of,
    moved,
    position_sigma_m,
    start,
    start_unknown,
)
from hil.estimation.measurement import DEGRADED, GOOD, LOST, NO_STATUS, Estimator, Measurement, measured_twist
from hil.estimation.slip import SlipDetector
from hil.estimation.wheel_motion import Motion, MotionReader


@dataclass(slots=True)
class _Node:
    """The belief at a measurement, with the step that leads to it and the fixes within that step, in order."""

    belief: Belief
    step: Step | None
    fixes: list[MeasuredPose] = field(default_factory=list)


class History:
    """Beliefs at the measurements of the last ``length_ns``, in order.

    A fix is applied at its own instant, within the step that contains it. The result is exactly that of fixes without
    delay and in order. The cost is to recompute the steps since that instant, at most those of ``length_ns``.
    """

    def __init__(self, first: Belief, length_ns: int, acceptance: Acceptance) -> None:
        self._length_ns = length_ns
        self._acceptance = acceptance
        self._nodes = deque([_Node(first, None)])

    @property
    def newest(self) -> Belief:
        """The belief at the newest measurement."""
        return self._nodes[-1].belief

    @property
    def begin_ns(self) -> int:
        """Fixes must be later than this instant."""
        return self._nodes[0].belief.time_ns

    def append(self, step: Step, time_ns: int) -> None:
        """Add one step and drop steps older than ``length_ns``."""
        self._nodes.append(_Node(moved(self.newest, step, time_ns), step))
        while self._nodes[1].belief.time_ns <= time_ns - self._length_ns:
            self._nodes.popleft()

    def replace(self, steps: Sequence[Step]) -> None:
        """Put these steps in place of the newest, in order; those before the first node do not matter any more."""
        first = max(1, len(self._nodes) - len(steps))
        for index in range(first, len(self._nodes)):
            self._nodes[index].step = steps[index - len(self._nodes)]
            self._recompute(self._nodes[index - 1].belief, self._nodes[index])

    def insert(self, fixes: list[MeasuredPose]) -> int:
        """Apply fixes later than ``begin_ns`` and not later than the newest measurement, in any order.

        Returns the number of duplicates, which are not applied twice.
        """
        earliest, doubles = len(self._nodes), 0
        for fix in fixes:
            index = len(self._nodes) - 1
            while self._nodes[index - 1].belief.time_ns >= fix.time_ns:
                index -= 1
            held = self._nodes[index].fixes
            place = bisect_left(held, fix)
            if place < len(held) and held[place] == fix:
                doubles += 1
                continue
            # Ordered by all their numbers, so that fixes of one instant have a fixed order too.
            insort(held, fix)
            earliest = min(earliest, index)
        for index in range(earliest, len(self._nodes)):
            self._recompute(self._nodes[index - 1].belief, self._nodes[index])
        return doubles

    def _recompute(self, belief: Belief, node: _Node) -> None:
        assert node.step is not None, "the first node has no step, and no fix is before it"
        begin_ns, end_ns = belief.time_ns, node.belief.time_ns
        for fix in node.fixes:
            if fix.time_ns > belief.time_ns:
                share = (fix.time_ns - belief.time_ns) / (end_ns - begin_ns)
                belief = moved(belief, node.step, fix.time_ns, share)
            belief = corrected(belief, fix, self._acceptance)
        if end_ns > belief.time_ns:
            belief = moved(belief, node.step, end_ns, (end_ns - belief.time_ns) / (end_ns - begin_ns))
        node.belief = belief


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

    def correct(self, before: Belief, after: Belief) -> None:
        """Hold back the change that fixes made. A restart of the filter is applied at once."""
        if not before.is_known or after.restarts != before.restarts or self._release_s == 0.0:
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

    def pose(self, belief: Belief) -> Pose:
        """Return the pose to report."""
        x, y, heading = self._held
        return Pose(belief.x_m - x, belief.y_m - y, belief.heading_rad - heading)


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
        self._acceptance = Acceptance(
            gate_of(options.gate_probability),
            options.restart_after,
            options.gyro_bias_sigma_rad_s**2,
            options.fix_noise_most**2,
        )
        self._reader = MotionReader(model, counts_per_revolution)
        self._slip = SlipDetector(model.lever_m, slip_threshold_m_s, self._reader.count_m)
        self._inertial = Inertial()
        self._last: Measurement | None = None
        self._history: History | None = None
        self._before: Belief | None = None
        self._waiting: list[MeasuredPose] = []
        self._release = Release(options.release_s)
        self._status = NO_STATUS
        self._refused = {"too_late": 0, "double": 0, "ahead": 0}

    @property
    def status(self) -> EstimatorSignals:
        """Uncertainty and health of the last update."""
        return self._status

    def fix_figures(self) -> dict[str, int]:
        """Return the number of fixes by outcome; ``restarts`` counts streaks of rejected ones that were accepted."""
        belief = self._history.newest if self._history is not None else self._before
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
            before = self._history.newest
            self._sort(self._history, last.robot_time_ns, fixes)
            self._release.correct(before, self._history.newest)
        belief = self._history.newest
        self._status = self._signals(belief, fixes[-1] if fixes else None)
        if not belief.is_known:
            return None
        pose = self._release.pose(belief)
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
        elif options.begin == "fix":
            first = start_unknown(time_ns, options.gyro_bias_sigma_rad_s, options.wheels_scale_sigma)
        else:
            sigmas = options.start_sigma_m, options.start_sigma_rad, options.gyro_bias_sigma_rad_s
            first = start(time_ns, self._start_pose, *sigmas, options.wheels_scale_sigma)
        return History(first, round(options.history_s * _NS), self._acceptance)

    def _move(self, history: History, motion: Motion, time_ns: int) -> None:
        bias_rad_s = history.newest.bias_rad_s
        if self._inertial.is_inertial and _rejects(history.newest):
            self._inertial.refute()
        slip_m_s = self._slip.update(motion, bias_rad_s, self._inertial.bias_m_s2)
        *again, newest = [self._step(travel) for travel in self._inertial.update(motion, bias_rad_s, slip_m_s)]
        before = history.newest
        history.replace(again)
        self._release.correct(before, history.newest)
        history.append(newest, time_ns)

    def _step(self, travel: Travel) -> Step:
        options, motion = self._options, travel.motion
        way_m = math.hypot(motion.forward_m, motion.left_m) + self._model.lever_m * abs(motion.turned_rad)
        dt_s = motion.dt_s
        position_m2 = options.wheels_sigma_m**2 * way_m + travel.sigma_m_s**2 * dt_s * _SLIP_LASTS_S
        bias_rad2_s2 = options.gyro_bias_walk_rad_s**2 * dt_s
        turned_rad, biased_s = motion.gyro_rad, dt_s
        heading_rad2 = (options.gyro_noise_rad_s * dt_s) ** 2
        if math.isnan(motion.gyro_rad):
            slip_rad_s = travel.sigma_m_s / self._model.lever_m
            turned_rad, biased_s = motion.turned_rad, 0.0
            heading_rad2 = options.wheels_sigma_rad**2 * way_m + slip_rad_s**2 * dt_s * _SLIP_LASTS_S
        return Step(
            motion.forward_m,
            motion.left_m,
            turned_rad,
            biased_s,
            position_m2,
            heading_rad2,
            bias_rad2_s2,
            travel.is_rolled,
        )

    def _twist(self, measurement: Measurement, belief: Belief) -> BodyTwist:
        """Return the twist by the wheels' true size, or by the inertial sensors, and the gyro's yaw rate."""
        forward_m_s, left_m_s, yaw_rate_rad_s = measured_twist(self._model, measurement, belief.bias_rad_s)
        if self._inertial.is_inertial:
            return BodyTwist(*self._inertial.velocity, yaw_rate_rad_s)
        return BodyTwist(belief.scale * forward_m_s, belief.scale * left_m_s, yaw_rate_rad_s)

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

    def _signals(self, belief: Belief, fix: MeasuredPose | None) -> EstimatorSignals:
        sigma_m = position_sigma_m(belief.covariance)
        age_ns = belief.time_ns - belief.fixed_ns
        health = DEGRADED if age_ns > self._options.fix_timeout_s * _NS else GOOD
        if not belief.is_known or sigma_m > self._options.lost_sigma_m:
            health = LOST
        return EstimatorSignals(
            sigma_m,
            math.sqrt(max(0.0, belief.covariance.hh)),
            belief.bias_rad_s,
            belief.scale,
            math.sqrt(max(1.0, belief.noise)),
            belief.accepted,
            belief.rejected,
            age_ns * 1e-6,
            float(self._slip.is_slipping or self._inertial.is_inertial),
            health,
            *(_NO_FIX if fix is None else (fix.time_ns / _NS, *fix.pose)),
        )


def _rejects(belief: Belief) -> bool:
    return belief.last_fix is not None and belief.last_fix.time_ns - belief.fixed_ns >= _REFUTED_NS


def _unsure(belief: Belief) -> Belief:
    """Return the belief after a reset of the robot: it moved by an unknown way, and the streak of fixes ends."""
    p = belief.covariance
    grown = p._replace(xx=p.xx + _UNSEEN_M**2, yy=p.yy + _UNSEEN_M**2, hh=p.hh + _UNSEEN_RAD**2)
    return belief._replace(covariance=grown, streak=0, last_fix=None, last_belief=None)
