"""The pose by wheels and gyro alone."""

import math
from collections.abc import Sequence

from hil.core.kinematics import to_world
from hil.core.model import RobotModel
from hil.core.signals import EstimatorSignals
from hil.core.types import MeasuredPose, Pose, PoseFix, State
from hil.estimation.measurement import NO_STATUS, Estimator, Measurement, measured_twist
from hil.estimation.motion import Motion, MotionReader
from hil.estimation.slip import SlipDetector


class OdometryEstimator(Estimator):
    """Integrates the motion of the wheels (``MotionReader``) from a known pose. It uses neither truth nor fixes.

    The heading comes from the gyro if there is one, because rollers slip sideways first in a turn. Over a gap of more
    than 0.1 s between two measurements it comes from the wheels. The displacement is taken at the heading half way
    (midpoint rule). Slip is reported and not corrected.

    Raises BadInputError as ``MotionReader``.
    """

    def __init__(self, model: RobotModel, start: Pose, counts_per_revolution: int, slip_threshold_m_s: float) -> None:
        self._model = model
        self._reader = MotionReader(model, counts_per_revolution)
        self._slip = SlipDetector(model.lever_m, slip_threshold_m_s)
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
