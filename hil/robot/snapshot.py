"""Feedback as one snapshot: what the robot measured at one sampling instant."""

from typing import NamedTuple

from firmware_protocol.generated.messages import State
from hil.core.types import Wheels
from hil.core.wheel_map import ImuMount


class Feedback(NamedTuple):
    """What the robot measured at one sampling instant.

    ``robot_time_ns`` is the robot's own clock (TICK.time_us), unwrapped since the first snapshot. ``current_a``,
    ``acceleration_m_s2`` and ``yaw_rate_rad_s`` come at a lower rate and keep their last value; NaN before the first.
    Current and acceleration (body frame, 9.81 upwards at rest) are means over the feedback period that ends then.
    """

    robot_time_ns: int
    state: State
    command_sequence: int
    command_age_ms: int
    encoder_count: tuple[int, int, int, int]
    speed_rad_s: Wheels
    current_a: Wheels
    acceleration_m_s2: tuple[float, float, float]
    yaw_rate_rad_s: float


def mounted(feedback: Feedback, imu: ImuMount) -> Feedback:
    """Return feedback of an IMU that is mounted so, along the robot's axes; its yaw rate is NaN where none is known."""
    return feedback._replace(
        acceleration_m_s2=imu.to_body(feedback.acceleration_m_s2), yaw_rate_rad_s=imu.yaw_rate(feedback.yaw_rate_rad_s)
    )
