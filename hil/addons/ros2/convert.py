"""Between a service's messages and those of ROS 2: plain values only, so that it needs no ROS 2.

Frames and units: REP 103 (metres, radians, x forward, y to the left) and REP 105 (odom, base_link).
"""

import math
from collections.abc import Sequence
from typing import Any

from hil.core.errors import BadInputError
from hil.core.kinematics import to_body
from hil.core.types import FourWheels, Twist

NOT_MEASURED = 1e6
"""Variance of height, roll and pitch, of which a robot in the plane knows nothing."""


def body_twist(pose: Sequence[float], twist: Sequence[float]) -> tuple[float, float, float]:
    """Return a twist in the world frame as nav_msgs/Odometry has it: in the robot's frame."""
    return tuple(to_body(Twist(*twist), pose[2]))  # type: ignore[return-value]


def quaternion(heading_rad: float) -> tuple[float, float]:
    """Return z and w of the rotation about the vertical axis; x and y are 0."""
    return math.sin(heading_rad / 2.0), math.cos(heading_rad / 2.0)


def covariance(position: float, yaw: float) -> list[float]:
    """Return 6 × 6 numbers by rows for standard deviations in the plane and of the heading."""
    variances = (position**2, position**2, NOT_MEASURED, NOT_MEASURED, NOT_MEASURED, yaw**2)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(6)]


def twist_arguments(twist: Any, speed_m_s: float, yaw_rate_rad_s: float) -> dict[str, float]:
    """Return the order's arguments for a geometry_msgs/Twist, of which the plane's part is taken.

    A twist beyond the limits is scaled as a whole. Raises BadInputError for a number that is not finite.
    """
    three = twist.linear.x, twist.linear.y, twist.angular.z
    if not math.isfinite(sum(three)):
        raise BadInputError(f"cmd_vel has {three}: expected finite numbers; the robot stops when no other twist comes")
    x, y, yaw = (
        value / max(math.hypot(*three[:2]) / speed_m_s, abs(three[2]) / yaw_rate_rad_s, 1.0) for value in three
    )
    return {"vx_m_s": x, "vy_m_s": y, "yaw_rate_rad_s": yaw}


def wheel_arguments(data: Sequence[float], command: str, limit: float) -> dict[str, Any]:
    """Return the order's arguments for the data of a std_msgs/Float64MultiArray: FL, FR, RR, RL, and maybe a sequence.

    Wheels beyond the limit [rad/s or N·m] are scaled together. Raises BadInputError for other data.
    """
    if len(data) not in (4, 5) or not math.isfinite(sum(data)):
        raise BadInputError(
            f"wheel_commands has {len(data)} numbers{'' if math.isfinite(sum(data)) else ', not all finite'}; expected "
            "FL, FR, RR, RL, and a fifth only as sequence"
        )
    largest = max(max(map(abs, data[:4])) / limit, 1.0)
    values = [value / largest for value in data[:4]]
    sequence = None
    if len(data) == 5:
        if data[4] != round(data[4]) or not 0 <= data[4] <= 2**53:
            raise BadInputError(f"wheel_commands has the sequence {data[4]}; expected a whole number from 0 on")
        sequence = int(data[4])
    return {"command": command, "values": values, "sequence": sequence}


def in_order(values: Sequence[float] | None) -> FourWheels:
    """Return four wheels for a message that has no way to say that it does not know: NaN."""
    return (math.nan,) * 4 if values is None else (values[0], values[1], values[2], values[3])
