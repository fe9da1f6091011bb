"""``[estimator]`` of a scenario, the estimators without fixes, and the estimator and source of fixes that it names."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

from hil.core.errors import BadInputError
from hil.core.kinematics import to_world
from hil.core.model import RobotModel
from hil.core.options import Range
from hil.core.ports import FixSource
from hil.core.signals import EstimatorSignals
from hil.core.tuples import is_finite, make_state
from hil.core.types import MeasuredPose, Pose, PoseFix, State
from hil.estimation.fix_errors import SimulatedOptions
from hil.estimation.measurement import NO_STATUS, Estimator, Measurement, measured_twist
from hil.estimation.slip import SlipDetector
from hil.estimation.wheel_motion import Motion, MotionReader


def _reachable(fix: str) -> str:
    if fix != "simulated":
        from hil.estimation.udp_fixes import parse_address

        try:
            parse_address(fix)
        except BadInputError as error:
            raise ValueError(str(error).removeprefix(f"estimator.fix = {fix!r}: ")) from error
    return fix


@dataclass(frozen=True)
class FilterOptions:
    """``[estimator.filter]``: the filter of source "fused". Sigmas are standard deviations.

    Raises ValueError for shares of more than 1 in all.
    """

    begin: Annotated[Literal["start", "fix"], "at the scenario's start pose, or unknown"] = "start"
    start_sigma_m: Annotated[float, Range(ge=0, le=100), "of the start pose, each axis"] = 0.01
    start_sigma_rad: Annotated[float, Range(ge=0, le=10), "of the start pose's heading"] = 0.01
    wheels_sigma_m: Annotated[float, Range(gt=0, le=10), "of each axis after 1 m rolled"] = 0.0003
    wheels_scale_sigma: Annotated[float, Range(ge=0, le=0.5), "of the true way forward over that of the wheels"] = 0.01
    left_scale_sigma: Annotated[float, Range(ge=0, le=0.5), "of the true way to the left over that of the wheels"] = (
        0.03
    )
    wheels_differ_sigma: Annotated[float, Range(ge=0, le=0.5), "of one wheel's radius over the mean of the four"] = (
        0.006
    )
    gyro_scale_sigma: Annotated[float, Range(ge=0, le=0.5), "of the true turn over that of the gyro"] = 0.005
    wheels_sigma_rad: Annotated[float, Range(gt=0, le=10), "of the heading after 1 m, without gyro"] = 0.02
    gyro_noise_rad_s: Annotated[float, Range(gt=0, le=10), "of one sample of the gyro"] = 0.01
    gyro_bias_sigma_rad_s: Annotated[float, Range(ge=0, le=10), "of the gyro's bias at the start"] = 0.02
    gyro_bias_walk_rad_s: Annotated[float, Range(ge=0, le=10), "of the bias's random walk in 1 s"] = 3e-4
    gate_probability: Annotated[float, Range(ge=0.5, le=0.999999), "of a right fix to be accepted"] = 0.999
    restart_after: Annotated[int, Range(ge=2, le=1000), "rejected fixes in a row that agree, to be believed"] = 10
    fix_noise_most: Annotated[
        float, Range(ge=1, le=100), "how many times noisier than they tell fixes may prove; 1: as they tell"
    ] = 4.0
    fix_held_share: Annotated[float, Range(ge=0, le=1), "of a fix's variance, by errors that last"] = 0.0
    fix_held_s: Annotated[float, Range(gt=0, le=3600), "their time constant"] = 2.0
    fix_map_share: Annotated[float, Range(ge=0, le=1), "of a fix's variance, by errors of the map at a place"] = 0.0
    fix_map_scale_m: Annotated[float, Range(gt=0, le=1000), "way after which those are others"] = 5.0
    fix_timeout_s: Annotated[float, Range(gt=0, le=3600), "age of the newest fix that counts as degraded"] = 0.5
    lost_sigma_m: Annotated[float, Range(gt=0, le=1000), "of the position, beyond which the robot is held at rest"] = (
        0.25
    )
    history_s: Annotated[float, Range(ge=0.01, le=10), "how late a fix may come"] = 1.0
    release_s: Annotated[
        float, Range(ge=0, le=10), "time constant with which the pose follows a correction; 0: it jumps"
    ] = 0.2

    def __post_init__(self) -> None:
        if self.fix_held_share + self.fix_map_share > 1.0:
            raise ValueError(
                f"fix_held_share = {self.fix_held_share:g} and fix_map_share = {self.fix_map_share:g} are shares of "
                "one variance: expected at most 1 in all"
            )


@dataclass(frozen=True)
class EstimatorOptions:
    """``[estimator]``: the source of the state that the controller acts on."""

    source: Annotated[
        Literal["truth", "odometry", "fused"], "true pose, wheels and gyro alone, or these with pose fixes"
    ] = "truth"
    twist: Annotated[
        Literal["source", "wheels"], "the source's own, or that of wheels and gyro even where the truth has one"
    ] = "source"
    slip_threshold_m_s: Annotated[
        float, Range(gt=0, le=100), "contradiction of wheels, gyro and accelerometer that is slip"
    ] = 0.05
    fix: Annotated[str, _reachable, 'pose fixes of "fused": simulated, or udp://127.0.0.1:PORT'] = "simulated"
    filter: FilterOptions = field(default_factory=FilterOptions)
    simulated_fix: SimulatedOptions = field(default_factory=SimulatedOptions)


class TruthEstimator(Estimator):
    """Takes the pose from the truth, for reference: a real robot has none.

    It takes the twist too if the truth has one and ``twist`` is not ``"wheels"``.

    Otherwise the twist is that of wheels and gyro. Between two samples of the truth the last one holds. A sample whose
    pose is not finite is ignored. Before the first sample the state is None.
    """

    uses_truth = True
    status = NO_STATUS

    def __init__(self, model: RobotModel, twist: str = "source") -> None:
        self._model = model
        self._uses_wheels = twist == "wheels"
        self._truth: PoseFix | None = None

    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Return the newest true pose, and the twist."""
        if truth is not None:
            _, pose, twist = truth
            state = make_state(pose, twist)
            if is_finite(state) and not self._uses_wheels:
                self._truth = truth
                return state
            if math.isfinite(sum(pose)):
                self._truth = truth
        if self._truth is None:
            return None
        _, pose, twist = self._truth
        if self._uses_wheels or not math.isfinite(sum(twist)):
            twist = to_world(measured_twist(self._model, measurement), pose.heading_rad)
        return make_state(pose, twist)

    def restart(self) -> None:
        """Wait for a new sample of the truth."""
        self._truth = None


class OdometryEstimator(Estimator):
    """Integrates the motion of wheels and gyro (``MotionReader``) from a known pose. It uses neither truth nor fixes.

    The heading comes from the gyro if there is one, because rollers slip sideways first in a turn. Over a gap of more
    than 0.1 s between two measurements it comes from the wheels. The displacement is taken at the heading half way
    (midpoint rule). Slip is reported and not corrected.

    Raises BadInputError as ``MotionReader``.
    """

    def __init__(self, model: RobotModel, start: Pose, counts_per_revolution: int, slip_threshold_m_s: float) -> None:
        self._model = model
        self._reader = MotionReader(model, counts_per_revolution)
        self._slip = SlipDetector(model.lever_m, slip_threshold_m_s, self._reader.count_m)
        self._pose = start
        self._last: Measurement | None = None

    @property
    def status(self) -> EstimatorSignals:
        """Slip; everything else is NaN."""
        return NO_STATUS._replace(slip=float(self._slip.is_slipping))

    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Return the integrated pose, and the twist of wheels and gyro. The first call is at the start."""
        last = self._last
        if last is None or measurement.robot_time_ns > last.robot_time_ns:
            if last is not None:
                motion = self._reader.between(last, measurement)
                self._slip.update(motion)
                self._pose = _moved(self._pose, motion)
            self._last = last = measurement
        return State(self._pose, to_world(measured_twist(self._model, last), self._pose.heading_rad))

    def restart(self) -> None:
        """Continue from the next measurement; the motion in between is unknown."""
        self._last = None
        self._slip.restart()


def _moved(pose: Pose, motion: Motion) -> Pose:
    turned = motion.turned_rad if math.isnan(motion.gyro_rad) else motion.gyro_rad
    x, y, heading = pose
    middle = heading + 0.5 * turned
    c, s = math.cos(middle), math.sin(middle)
    forward, left = motion.forward_m, motion.left_m
    return Pose(x + c * forward - s * left, y + s * forward + c * left, heading + turned)


def make_estimator(options: EstimatorOptions, model: RobotModel, start: Pose, counts_per_revolution: int) -> Estimator:
    """Return the estimator of a scenario. Raises BadInputError as ``MotionReader`` for the counts."""
    if options.source == "truth":
        return TruthEstimator(model, options.twist)
    if options.source == "odometry":
        return OdometryEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s)
    from hil.estimation.fused import FusedEstimator  # it takes FilterOptions from here

    return FusedEstimator(model, start, counts_per_revolution, options.slip_threshold_m_s, options.filter)


def make_fixes(options: EstimatorOptions, seed: int, truth_age_ns: int) -> FixSource | None:
    """Return the source of pose fixes of a scenario; None for an estimator that uses none.

    ``truth_age_ns`` is how old the truth is when it arrives, and ``seed`` that of simulated fixes. Raises BadInputError
    as ``UdpFixes`` does.
    """
    if options.source != "fused":
        return None
    if options.fix == "simulated":
        from hil.estimation.simulated_fixes import SimulatedFixes

        return SimulatedFixes(options.simulated_fix, seed, truth_age_ns)
    from hil.estimation.udp_fixes import UdpFixes

    return UdpFixes(options.fix, options.filter.history_s)
