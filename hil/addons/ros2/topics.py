"""The topics of a node: motion and status go out; twists and wheel commands come in, and arm nothing."""

import math
import re
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import TransformStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, Imu, JointState
from std_msgs.msg import Float64MultiArray, Int64

from hil.addons.ros2.convert import body_twist, covariance, in_order, quaternion, twist_arguments, wheel_arguments
from hil.addons.ros2.robot import ServedRobot
from hil.addons.ros2.settings import Settings
from hil.addons.ros2.simulation import Simulation
from hil.addons.service.messages import Action, Phase
from hil.core.errors import BadInputError, apart
from hil.scenario import Scenario

try:
    from tf2_msgs.msg import TFMessage
except ImportError:  # it has no wheel; an installation of ROS 2 has it
    TFMessage = None

_DEPTH = 10
_DIAGNOSTICS_S = 1.0
_TROUBLED = (Phase.AWAY, Phase.FAULT, Phase.ESTOP)
_GYRO_VARIANCE, _ACCELERATION_VARIANCE = 0.01**2, 0.1**2
_UNKNOWN = -1.0  # sensor_msgs/Imu: the first element of a covariance says that there is no such number

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of commands only the newest counts, and none is sent again. It matches publishers of every reliability."""

_WARN_S = 30.0
_LOOK_S = 1.0
_SHORTEST_S = 1e-3
_NUMBER = re.compile(r"[-+]?\d[\d.]*")


class Publishers:
    """The topics out of a node, for one thread."""

    def __init__(self, node: Any, settings: Settings) -> None:
        self._settings = settings
        self._diagnosed_s = -math.inf
        self._phase: str | None = None

        def publisher(kind: Any, topic: str) -> Any:
            return node.create_publisher(kind, topic, _DEPTH)

        self._odom, self._odom_to = self._odometry(Odometry()), publisher(Odometry, "odom")
        self._truth, self._truth_to = self._odometry(Odometry()), publisher(Odometry, "ground_truth/odom")
        self._truth.pose.covariance = self._truth.twist.covariance = covariance(0.0, 0.0)
        self._transform = TransformStamped(child_frame_id=settings.base_frame_id)
        self._transform.header.frame_id = settings.odom_frame_id
        self._tf_to = None
        if settings.enable_odom_tf and TFMessage is None:
            node.get_logger().warning("tf is not published: tf2_msgs is not there; source an installation of ROS 2")
        elif settings.enable_odom_tf:
            self._tf, self._tf_to = TFMessage(transforms=[self._transform]), publisher(TFMessage, "tf")
        self._joints = JointState(name=list(settings.joint_names))
        self._joints_to = publisher(JointState, "joint_states")
        self._imu, self._imu_to = Imu(), publisher(Imu, "imu/data_raw")
        self._imu.header.frame_id = settings.imu_frame_id
        self._imu.orientation_covariance[0] = _UNKNOWN
        self._imu.angular_velocity_covariance = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, _GYRO_VARIANCE]
        diagonal = [_ACCELERATION_VARIANCE if place % 4 == 0 else 0.0 for place in range(9)]
        self._imu.linear_acceleration_covariance = diagonal
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
        is_well = not (status["why"] or status["recording_trouble"])
        level = DiagnosticStatus.OK if is_well else DiagnosticStatus.WARN
        if status["phase"] in _TROUBLED:
            level = DiagnosticStatus.ERROR
        self._diagnose(level, status["why"] or status["phase"], sec, nanosec, {**_flat(status), **figures})

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


class Commands:
    """The topics into a node.

    Attributes:
        figures: for diagnostics, the numbers of messages received and dropped.
    """

    def __init__(self, node: Any, settings: Settings, scenario: Scenario, robot: ServedRobot | Simulation) -> None:
        self._node = node
        self._settings = settings
        self._scenario = scenario
        self._robot = robot
        self.figures = {"cmd_vel": 0, "wheel_commands": 0, "dropped": 0}
        self._mismatches: set[tuple[str, str]] = set()
        self._said: dict[str, tuple[float, int]] = {}
        rate_hz = math.inf if isinstance(robot, Simulation) else settings.command_rate_hz
        self._twists, self._wheels = (
            _Newest(node, rate_hz, self._order(action)) for action in (Action.TWIST, Action.WHEELS)
        )
        kind = TwistStamped if settings.use_stamped_vel else Twist
        self._subscriptions = [
            node.create_subscription(kind, "cmd_vel", self._twist, _NEWEST),
            node.create_subscription(Float64MultiArray, "wheel_commands", self._wheel_command, _NEWEST),
        ]
        node.create_timer(_LOOK_S, self._look_at_publishers, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _order(self, action: Action) -> Callable[[Mapping[str, Any]], None]:
        return lambda arguments: self._robot.order(action, arguments, partial(self._answered, action))

    def _answered(self, action: Action, refused: str | None) -> None:
        if refused is not None:
            self._drop(f"{action.value} refused: {refused}")

    def _drop(self, sentence: str) -> None:
        """Count a dropped message. Log a new reason at once, and a repeated one with its number after ``_WARN_S``."""
        self.figures["dropped"] += 1
        kind, now_s = _NUMBER.sub("", sentence), time.monotonic()
        said_s, count = self._said.get(kind, (-math.inf, 0))
        if now_s - said_s < _WARN_S:
            self._said[kind] = said_s, count + 1
            return
        self._said[kind] = now_s, 0
        self._node.get_logger().warning(sentence + (f" ({count} more since this was said)" if count else ""))

    def _look_at_publishers(self) -> None:
        """Warn once of a publisher with another message type, which ROS 2 drops silently."""
        for one in self._subscriptions:
            topic, taken = one.topic_name, f"{one.msg_type.__module__.partition('.')[0]}/msg/{one.msg_type.__name__}"
            for other in {each.topic_type for each in self._node.get_publishers_info_by_topic(topic)} - {taken}:
                if (topic, other) not in self._mismatches:
                    self._mismatches.add((topic, other))
                    advice = "; see the parameter use_stamped_vel" if topic.endswith("cmd_vel") else ""
                    self._node.get_logger().warning(f"{topic}: {other} is published, and {taken} is taken{advice}")

    def _age_s(self, stamp: Any) -> float:
        """Return the age of a header's stamp; one that is zero says nothing, and counts as new."""
        if stamp.sec == stamp.nanosec == 0:
            return 0.0
        robot, clock = self._robot, self._node.get_clock()
        now_ns = robot.now_ns() if isinstance(robot, Simulation) else clock.now().nanoseconds
        return float(1e-9 * (now_ns - stamp.sec * 1_000_000_000 - stamp.nanosec))

    def _twist(self, message: Any) -> None:
        self.figures["cmd_vel"] += 1
        twist = message
        if self._settings.use_stamped_vel:
            age_s, twist = self._age_s(message.header.stamp), message.twist
            if age_s > (limit_s := self._settings.command_timeout_s):
                self._drop(
                    f"cmd_vel is {apart(age_s, limit_s)} s old, more than command_timeout_s = {limit_s:g}; it was "
                    "dropped"
                )
                return
        service = self._scenario.service
        try:
            self._twists.send(twist_arguments(twist, service.speed_m_s, service.yaw_rate_rad_s))
        except BadInputError as error:
            self._drop(str(error))

    def _wheel_command(self, message: Any) -> None:
        self.figures["wheel_commands"] += 1
        robot, command = self._scenario.robot, self._scenario.controller.command
        limit = robot.speed_limit_rad_s if command == "speed" else robot.torque_limit_n_m
        try:
            self._wheels.send(wheel_arguments(message.data, command, limit))
        except BadInputError as error:
            self._drop(str(error))


class _Newest:
    """Sends the newest of a stream of orders, at most at ``rate_hz``: another node may flood us."""

    def __init__(self, node: Any, rate_hz: float, send: Callable[[Mapping[str, Any]], None]) -> None:
        self._send = send
        self._period_s = 1.0 / rate_hz
        self._sent_s = 0.0
        self._waiting: Mapping[str, Any] | None = None
        self._timer = node.create_timer(
            max(self._period_s, _SHORTEST_S), self._later, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()

    def send(self, arguments: Mapping[str, Any]) -> None:
        """Send it at once, or when the period is over, if nothing newer has come by then."""
        now_s = time.monotonic()
        if now_s - self._sent_s >= 0.9 * self._period_s:
            self._waiting, self._sent_s = None, now_s
            self._send(arguments)
        else:
            if self._waiting is None:
                self._timer.reset()
            self._waiting = arguments

    def _later(self) -> None:
        self._timer.cancel()
        if (waiting := self._waiting) is not None:
            self._waiting, self._sent_s = None, time.monotonic()
            self._send(waiting)
