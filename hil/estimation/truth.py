"""The pose by ground truth, for reference: a real robot has none."""

from collections.abc import Sequence
from math import isfinite

from hil.core.kinematics import to_world
from hil.core.model import RobotModel
from hil.core.tuples import is_finite, make_state
from hil.core.types import MeasuredPose, PoseFix, State
from hil.estimation.measurement import NO_STATUS, Estimator, Measurement, measured_twist


class TruthEstimator(Estimator):
    """Takes the pose from the truth, and the twist too if it has one and ``twist`` is not ``"wheels"``.

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
            if isfinite(sum(pose)):
                self._truth = truth
        if self._truth is None:
            return None
        _, pose, twist = self._truth
        if self._uses_wheels or not isfinite(sum(twist)):
            twist = to_world(measured_twist(self._model, measurement), pose.heading_rad)
        return make_state(pose, twist)

    def restart(self) -> None:
        """Wait for a new sample of the truth."""
        self._truth = None
