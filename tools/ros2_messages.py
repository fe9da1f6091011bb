"""Between a service's API and ROS 2 messages, as values by the names of the message definitions. Pure; needs no ROS.

Definitions: geometry_msgs/msg/Twist, nav_msgs/msg/Odometry, tf2_msgs/msg/TFMessage and sensor_msgs/msg/JointState.
Frames and units: REP 103 (metres, radians, x forward, y to the left) and REP 105 (odom, base_link).
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from hil.core.errors import BadInputError
from hil.core.kinematics import to_body
from hil.core.types import Twist

Values = dict[str, Any]
_NOT_MEASURED = 1e6
"""Variance of height, roll and pitch, which a robot in the plane knows nothing of."""


class Names(NamedTuple):
    """Names of frames, and of the joints of the four wheels: front left, front right, rear right, rear left."""

    odom: str = "odom"
    base: str = "base_link"
    joints: tuple[str, ...] = ("wheel_fl_joint", "wheel_fr_joint", "wheel_rr_joint", "wheel_rl_joint")


class Deviations(NamedTuple):
    """Standard deviations that are said of pose and twist: the service's status has none. They are not measured."""

    position_m: float = 0.05
    heading_rad: float = 0.05
    speed_m_s: float = 0.02
    yaw_rate_rad_s: float = 0.05


def twist_arguments(twist: Any) -> dict[str, float]:
    """Return the arguments of the order ``twist`` for a geometry_msgs/msg/Twist, of which the plane's part is taken.

    Raises BadInputError for a number that is not finite.
    """
    arguments = {"vx_m_s": twist.linear.x, "vy_m_s": twist.linear.y, "yaw_rate_rad_s": twist.angular.z}
    for name, value in arguments.items():
        if not math.isfinite(value):
            raise BadInputError(
                f"{name} = {value}: expected a finite number; the robot stops when no other twist comes"
            )
    return arguments


def odometry(status: Mapping[str, Any], names: Names, deviations: Deviations) -> Values | None:
    """Return a nav_msgs/msg/Odometry, its twist in the robot's frame; None while pose or twist are unknown."""
    if status["pose"] is None or status["twist"] is None:
        return None
    x_m, y_m, heading_rad = status["pose"]
    forward_m_s, left_m_s, yaw_rate_rad_s = to_body(Twist(*status["twist"]), heading_rad)
    return {
        "header": _header(status, names.odom),
        "child_frame_id": names.base,
        "pose": {
            "pose": {"position": _vector(x_m, y_m, 0.0), "orientation": _quaternion(heading_rad)},
            "covariance": _covariance(deviations.position_m, deviations.heading_rad),
        },
        "twist": {
            "twist": {"linear": _vector(forward_m_s, left_m_s, 0.0), "angular": _vector(0.0, 0.0, yaw_rate_rad_s)},
            "covariance": _covariance(deviations.speed_m_s, deviations.yaw_rate_rad_s),
        },
    }


def transform(status: Mapping[str, Any], names: Names) -> Values | None:
    """Return a tf2_msgs/msg/TFMessage with the robot's frame in that of the odometry; None while it is unknown."""
    if status["pose"] is None:
        return None
    x_m, y_m, heading_rad = status["pose"]
    one = {
        "header": _header(status, names.odom),
        "child_frame_id": names.base,
        "transform": {"translation": _vector(x_m, y_m, 0.0), "rotation": _quaternion(heading_rad)},
    }
    return {"transforms": [one]}


def joint_states(status: Mapping[str, Any], names: Names) -> Values | None:
    """Return a sensor_msgs/msg/JointState with the wheels' speeds; None while they are unknown.

    Angles and efforts are left out, as the definition allows: the status has none.
    """
    if status["speed_rad_s"] is None:
        return None
    return {
        "header": _header(status, ""),
        "name": list(names.joints),
        "position": [],
        "velocity": list(status["speed_rad_s"]),
        "effort": [],
    }


def _header(status: Mapping[str, Any], frame: str) -> Values:
    seconds, nanoseconds = divmod(round(status["time_unix_s"] * 1e9), 1_000_000_000)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _vector(x: float, y: float, z: float) -> Values:
    return {"x": x, "y": y, "z": z}


def _quaternion(heading_rad: float) -> Values:
    return {"x": 0.0, "y": 0.0, "z": math.sin(heading_rad / 2.0), "w": math.cos(heading_rad / 2.0)}


def _covariance(plane: float, yaw: float) -> list[float]:
    """Return 6 × 6 numbers by rows, for x, y, z and the rotations about them."""
    variances = (plane**2, plane**2, _NOT_MEASURED, _NOT_MEASURED, _NOT_MEASURED, yaw**2)
    return [variances[row] if row == column else 0.0 for row in range(6) for column in range(6)]
