"""Input and interface of an estimator. Time is robot time in nanoseconds; estimators have no clock."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Protocol

from hil.core.kinematics import BodyTwist, body_twist
from hil.core.model import RobotModel
from hil.core.signals import EstimatorSignals
from hil.core.types import NAN, MeasuredPose, PoseFix, State, Wheels

Counts = tuple[int, int, int, int]
"""Encoder counts of FL, FR, RR, RL as on the wire: 16 bits, wrapping (DBC ENCODERS)."""

GOOD, DEGRADED, LOST = 0.0, 1.0, 2.0
"""``estimator.health``; a robot whose estimator is LOST is held at rest."""
NO_STATUS = EstimatorSignals(*[NAN] * len(EstimatorSignals._fields))


class Measurement(Protocol):
    """The part of a feedback snapshot that estimators use (``hil.robot.snapshot.Feedback`` has more)."""

    @property
    def robot_time_ns(self) -> int:
        """Robot time of the sample; does not wrap."""

    @property
    def encoder_count(self) -> Counts | None:
        """Encoder counts, or None where there are none."""

    @property
    def speed_rad_s(self) -> Wheels:
        """Wheel speeds as the firmware estimates them."""

    @property
    def yaw_rate_rad_s(self) -> float:
        """The gyro's yaw rate; NaN where there is none."""

    @property
    def acceleration_m_s2(self) -> tuple[float, float, float]:
        """Acceleration in the body frame, 9.81 upwards at rest; NaN without an accelerometer."""


class Estimator(ABC):
    """Turns measurements into the state that the controller acts on."""

    uses_truth = False
    """Whether the state depends on the true pose, and is too old when the true pose is."""

    @property
    @abstractmethod
    def status(self) -> EstimatorSignals:
        """Uncertainty and health of the last update; NaN for what an estimator does not know."""

    @abstractmethod
    def update(
        self, measurement: Measurement, truth: PoseFix | None, fixes: Sequence[MeasuredPose] = ()
    ) -> State | None:
        """Return the state at the newest measurement, or None while it is not known.

        ``truth`` is the newest sample, ``fixes`` are those that arrived since the last call. The same measurement or
        truth may be given again.
        """

    def fix_figures(self) -> Mapping[str, int]:
        """Return the number of pose fixes by outcome; empty for an estimator that uses none."""
        return {}

    @abstractmethod
    def restart(self) -> None:
        """Continue after a reset of the robot: its clock and counts restart, the pose is the last known one."""


def measured_twist(model: RobotModel, measurement: Measurement, gyro_bias_rad_s: float = 0.0) -> BodyTwist:
    """Return the body twist of wheels and gyro; without a gyro the yaw rate too is the wheels'."""
    body = body_twist(measurement.speed_rad_s, model.wheel_radius_m, model.lever_m)
    yaw_rate = measurement.yaw_rate_rad_s
    return body if math.isnan(yaw_rate) else BodyTwist(body.forward_m_s, body.left_m_s, yaw_rate - gyro_bias_rad_s)
