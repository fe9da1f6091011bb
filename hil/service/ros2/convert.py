"""Between a service's messages and those of ROS 2: plain values only, so that it needs no ROS 2.

Frames and units: REP 103 (metres, radians, x forward, y to the left) and REP 105 (odom, base_link).
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any

from hil.core.errors import BadInputError
from hil.core.kinematics import to_body
from hil.core.types import FourWheels, Pose, Twist

NOT_MEASURED = 1e6
"""Variance of height, roll and pitch, of which a robot in the plane knows nothing."""

_PLACES = (0, 1, 5, 7, 11, 35)  # of xx, xy, xh, yy, yh, hh in 6 × 6 numbers


def body_twist(pose: Sequence[float], twist: Sequence[float]) -> tuple[float, float, float]:
    """Return a twist in the world frame as nav_msgs/Odometry has it: in the robot's frame."""
    return tuple(to_body(Twist(*twist), pose[2]))  # type: ignore[return-value]


def quaternion(heading_rad: float) -> tuple[float, float]:
    """Return z and w of the rotation about the vertical axis; x and y are 0."""
    return math.sin(heading_rad / 2.0), math.cos(heading_rad / 2.0)


def heading(orientation: Any) -> float:
    """Return the heading [rad] of a geometry_msgs/Quaternion. Raises BadInputError unless it has unit length."""
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    length = math.hypot(x, y, z, w)
    if not 0.99 < length < 1.01:
        raise BadInputError(f"orientation of length {length:.3g}: expected a unit quaternion")
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def covariance(position: float, yaw: float) -> list[float]:
    """Return 6 × 6 numbers by rows for standard deviations in the plane and of the heading."""
    variances = (position**2, position**2, NOT_MEASURED, NOT_MEASURED, NOT_MEASURED, yaw**2)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(6)]


def plane_covariance(six: Sequence[float]) -> list[float]:
    """Return the upper triangle for x, y and heading of 6 × 6 numbers by rows."""
    return [float(six[place]) for place in _PLACES]


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


def path_table(poses: Sequence[tuple[float, Pose]]) -> tuple[str, bool]:
    """Return the CSV file of a nav_msgs/Path, given as times [s] and poses, and whether it goes by its times.

    It does where at least four times ascend. Otherwise equal poses are left out, and BadInputError is raised for fewer
    than two.
    """
    times = [time_s for time_s, _ in poses]
    if len(times) >= 4 and all(after > before for before, after in itertools.pairwise(times)):
        lines = [f"{time_s - times[0]!r},{x!r},{y!r},{yaw!r}" for time_s, (x, y, yaw) in poses]
        return "\n".join(["t_s,x_m,y_m,heading_rad", *lines]), True
    kept: list[Pose] = []
    for _, pose in poses:
        if kept:  # headings of a path turn the shorter way
            pose = pose._replace(heading_rad=kept[-1][2] + math.remainder(pose[2] - kept[-1][2], 2.0 * math.pi))
        if not kept or math.dist(pose[:2], kept[-1][:2]) >= 0.001 or abs(pose[2] - kept[-1][2]) > 0.001:
            kept.append(pose)
    if len(kept) < 2:
        raise BadInputError(f"path has {len(kept)} different poses; expected at least 2")
    return "\n".join(["x_m,y_m,heading_rad", *(f"{x!r},{y!r},{yaw!r}" for x, y, yaw in kept)]), False
