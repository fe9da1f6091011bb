"""What an estimator is given and what it gives back. Time is robot time in nanoseconds; nobody here has a clock."""

import math
from typing import Protocol

from hil.kinematics import BodyTwist, body_twist
from hil.model import RobotModel
from hil.types import PoseFix, State, Wheels

Counts = tuple[int, int, int, int]
"""Encoder counts of FL, FR, RR, RL as on the wire: 16 bits, wrapping (DBC ENCODERS)."""


class Measurement(Protocol):
    """What one feedback snapshot has for an estimator (``hil.devices.snapshot.Feedback`` has more)."""

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


class Estimator(Protocol):
    """Turns measurements into the state that the controller acts on."""

    def update(self, measurement: Measurement, fix: PoseFix | None) -> State | None:
        """Return the state at the newest measurement, or None while it is not known.

        ``fix`` is the newest one there is; the same measurement or fix may be given again.
        """

    def restart(self) -> None:
        """Go on with a robot that was reset: its clock and its counts began anew, the pose is the last one known."""


def measured_twist(model: RobotModel, measurement: Measurement) -> BodyTwist:
    """Return the body twist of wheels and gyro; without a gyro the yaw rate too is the wheels'."""
    body = body_twist(measurement.speed_rad_s, model.wheel_radius_m, model.lever_m)
    yaw_rate = measurement.yaw_rate_rad_s
    return body if math.isnan(yaw_rate) else body._replace(yaw_rate_rad_s=yaw_rate)
