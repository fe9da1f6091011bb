"""Where the robot is by ground truth: for reference, not for a robot that has to find out itself."""

import math

from hil.estimator.measurement import Measurement, measured_twist
from hil.kinematics import to_world
from hil.model import RobotModel
from hil.types import PoseFix, State


class TruthEstimator:
    """Takes the pose from the truth, and the twist too where it has one and ``twist`` is not ``"wheels"``.

    Else the twist is that of the wheels and the gyro. Between two samples of the truth the last one stands. One whose
    pose is not finite is ignored. None until there is one.
    """

    def __init__(self, model: RobotModel, twist: str = "source") -> None:
        self._model = model
        self._uses_wheels = twist == "wheels"
        self._fix: PoseFix | None = None

    def update(self, measurement: Measurement, fix: PoseFix | None) -> State | None:
        """Return the newest true pose and the twist."""
        if fix is not None and math.isfinite(sum(fix.pose)):
            self._fix = fix
        if self._fix is None:
            return None
        pose, twist = self._fix.pose, self._fix.twist
        if self._uses_wheels or not math.isfinite(sum(twist)):
            twist = to_world(measured_twist(self._model, measurement), pose.heading_rad)
        return State(pose, twist)

    def restart(self) -> None:
        """Wait for a new sample of the truth."""
        self._fix = None
