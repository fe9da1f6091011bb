"""Publishes a robot's motion and status. The messages are made once, and their numbers changed."""

import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import Float64MultiArray, Int64
from tf2_msgs.msg import TFMessage

from hil.service.messages import Phase
from hil.service.ros2.convert import body_twist, covariance, in_order, quaternion
from hil.service.ros2.settings import Settings

_DEPTH = 10
_DIAGNOSTICS_S = 1.0
_TROUBLED = (Phase.AWAY, Phase.FAULT, Phase.ESTOP)
_GYRO_VARIANCE, _ACCELERATION_VARIANCE = 0.01**2, 0.1**2
_UNKNOWN = -1.0  # sensor_msgs/Imu: the first element of a covariance says that there is no such number


class Publishers:
    """The topics out of a node, for one thread. They say nothing while the node is not active."""

    def __init__(self, node: Any, settings: Settings) -> None:
        self._settings = settings
        self._diagnosed_s = -math.inf
        self._phase: str | None = None

        def publisher(kind: Any, topic: str) -> Any:
            return node.create_lifecycle_publisher(kind, topic, _DEPTH)

        self._odom, self._odom_to = self._odometry(Odometry()), publisher(Odometry, "odom")
        self._truth, self._truth_to = self._odometry(Odometry()), publisher(Odometry, "ground_truth/odom")
        self._truth.pose.covariance = self._truth.twist.covariance = covariance(0.0, 0.0)
        self._transform = TransformStamped(child_frame_id=settings.base_frame_id)
        self._transform.header.frame_id = settings.odom_frame_id
        self._tf, self._tf_to = TFMessage(transforms=[self._transform]), None
        if settings.enable_odom_tf:
            self._tf_to = publisher(TFMessage, "tf")
        self._joints = JointState(name=list(settings.joint_names))
        self._joints_to = publisher(JointState, "joint_states")
        self._imu, self._imu_to = Imu(), publisher(Imu, "imu/data_raw")
        self._imu.header.frame_id = settings.imu_frame_id
        self._imu.orientation_covariance[0] = _UNKNOWN
        self._imu.angular_velocity_covariance = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, _GYRO_VARIANCE]
        diagonal = [_ACCELERATION_VARIANCE if place % 4 == 0 else 0.0 for place in range(9)]
        self._imu.linear_acceleration_covariance = diagonal
        self._current, self._current_to = Float64MultiArray(), publisher(Float64MultiArray, "wheel_currents")
        self._applied, self._applied_to = Int64(), publisher(Int64, "wheel_commands/applied")
        self._battery, self._battery_to = BatteryState(present=True), publisher(BatteryState, "battery_state")
        for name in ("temperature", "current", "charge", "capacity", "design_capacity", "percentage"):
            setattr(self._battery, name, math.nan)
        self._diagnostics = DiagnosticArray(
            status=[DiagnosticStatus(name=f"{node.get_fully_qualified_name().lstrip('/')}: robot")]
        )
        self._diagnostics_to = publisher(DiagnosticArray, "diagnostics")

    def _odometry(self, message: Any) -> Any:
        message.header.frame_id = self._settings.odom_frame_id
        message.child_frame_id = self._settings.base_frame_id
        message.pose.covariance = covariance(*self._settings.pose_sigma)
        message.twist.covariance = covariance(*self._settings.twist_sigma)
        return message

    def motion(self, motion: Mapping[str, Any]) -> None:
        """Publish a ``Motion``; what it does not know is not published."""
        sec, nanosec = divmod(round(motion["time_unix_s"] * 1e9), 1_000_000_000)
        pose, twist = motion["pose"], motion["twist"]
        if pose is not None and twist is not None:
            if motion["sigma"] is not None:
                self._odom.pose.covariance = covariance(*motion["sigma"])
            self._publish_odometry(self._odom, self._odom_to, sec, nanosec, pose, twist)
            if self._tf_to is not None:
                _stamp(self._transform, sec, nanosec)
                moved = self._transform.transform
                moved.translation.x, moved.translation.y = pose[:2]
                moved.rotation.z, moved.rotation.w = quaternion(pose[2])
                self._tf_to.publish(self._tf)
        if motion["truth"] is not None and motion["true_twist"] is not None:
            self._publish_odometry(self._truth, self._truth_to, sec, nanosec, motion["truth"], motion["true_twist"])
        if motion["speed_rad_s"] is not None:
            joints = self._joints
            _stamp(joints, sec, nanosec)
            joints.position = list(in_order(motion["angle_rad"]))
            joints.velocity = list(motion["speed_rad_s"])
            joints.effort = list(in_order(motion["torque_n_m"]))
            self._joints_to.publish(joints)
        if motion["sequence"] is not None:
            self._applied.data = motion["sequence"]
            self._applied_to.publish(self._applied)
        if motion["current_a"] is not None:
            self._current.data = list(motion["current_a"])
            self._current_to.publish(self._current)
        if motion["yaw_rate_rad_s"] is not None:
            imu, acceleration = self._imu, motion["acceleration_m_s2"]
            _stamp(imu, sec, nanosec)
            imu.angular_velocity.z = motion["yaw_rate_rad_s"]
            if acceleration is not None:
                vector = imu.linear_acceleration
                vector.x, vector.y, vector.z = acceleration
            self._imu_to.publish(imu)

    def _publish_odometry(self, message: Any, to: Any, sec: int, nanosec: int, pose: Any, twist: Any) -> None:
        _stamp(message, sec, nanosec)
        at, turned = message.pose.pose.position, message.pose.pose.orientation
        at.x, at.y = pose[:2]
        turned.z, turned.w = quaternion(pose[2])
        linear = message.twist.twist.linear
        linear.x, linear.y, message.twist.twist.angular.z = body_twist(pose, twist)
        to.publish(message)

    def status(self, status: Mapping[str, Any], figures: Mapping[str, Any]) -> None:
        """Publish battery and diagnostics once a second and at each change of phase; ``figures`` are the node's own."""
        now_s = status["time_unix_s"]
        if 0.0 <= now_s - self._diagnosed_s < _DIAGNOSTICS_S and status["phase"] == self._phase:
            return
        self._diagnosed_s, self._phase = now_s, status["phase"]
        sec, nanosec = divmod(round(now_s * 1e9), 1_000_000_000)
        if status["battery_v"] is not None:
            _stamp(self._battery, sec, nanosec)
            self._battery.voltage = status["battery_v"]
            self._battery_to.publish(self._battery)
        trouble = figures["trouble"]
        is_well = not (status["why"] or status["recording_trouble"] or trouble)
        level = DiagnosticStatus.OK if is_well else DiagnosticStatus.WARN
        if status["phase"] in _TROUBLED:
            level = DiagnosticStatus.ERROR
        self._diagnose(level, status["why"] or trouble or status["phase"], sec, nanosec, {**_flat(status), **figures})

    def lost(self, why: str, sec: int, nanosec: int) -> None:
        """Publish that the service is away."""
        self._phase = None
        self._diagnose(DiagnosticStatus.STALE, why, sec, nanosec, {})

    def _diagnose(self, level: bytes, sentence: str, sec: int, nanosec: int, values: Mapping[str, Any]) -> None:
        _stamp(self._diagnostics, sec, nanosec)
        one = self._diagnostics.status[0]
        one.level, one.message = level, sentence
        one.values = [KeyValue(key=name, value=str(value)) for name, value in values.items()]
        self._diagnostics_to.publish(self._diagnostics)


def _stamp(message: Any, sec: int, nanosec: int) -> None:
    stamp = message.header.stamp
    stamp.sec, stamp.nanosec = sec, nanosec


def _flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a status with dotted names; unknown values are left out."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{name}.")
        elif value is not None:
            flat[prefix + name] = value
    return flat
