"""Where the robot is by ground truth: for reference, not for a robot that has to find out itself."""

from collections.abc import Mapping, Sequence
from math import isfinite

from hil.core.kinematics import to_world
from hil.core.model import RobotModel
from hil.core.types import MeasuredPose, PoseFix, State, make_state
from hil.estimation.measurement import NO_STATUS, Measurement, measured_twist


class TruthEstimator:
    """Takes the pose from the truth, and the twist too where it has one and ``twist`` is not ``"wheels"``.

    Else the twist is that of the wheels and the gyro. Between two samples of the truth the last one stands. One whose
    pose is not finite is ignored. None until there is one.
    """

    uses_truth = True
    status = NO_STATUS
    """Nothing to tell: the truth is not estimated."""

    def __init__(self, model: RobotModel, twist: str = "source") -> None:
        self._model = model
        self._uses_wheels = twist == "wheels"
        self._truth: PoseFix | None = None

    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Return the newest true pose and the twist."""
        if truth is not None:
            x, y, heading = truth.pose
            if isfinite(x + y + heading):
                self._truth = truth
        if self._truth is None:
            return None
        _, pose, twist = self._truth
        vx, vy, yaw_rate = twist
        if self._uses_wheels or not isfinite(vx + vy + yaw_rate):
            twist = to_world(measured_twist(self._model, measurement), pose.heading_rad)
        return make_state((pose, twist))

    def fix_figures(self) -> Mapping[str, int]:
        """Fixes have no part in it."""
        return {}

    def restart(self) -> None:
        """Wait for a new sample of the truth."""
        self._truth = None
