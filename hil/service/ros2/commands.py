"""What comes into a node: twists, wheel commands, pose fixes and paths. None of it arms the robot."""

import contextlib
import json
import math
import re
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from nav_msgs.msg import Path as PathMessage
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray

from hil.core.errors import BadInputError, apart
from hil.core.scratch import scratch_folder
from hil.core.tokens import read_token, token_file
from hil.core.types import Pose
from hil.estimation.localisation.message import VERSION, parse_address
from hil.scenario import Scenario
from hil.service.messages import Action
from hil.service.ros2.convert import heading, path_table, plane_covariance, twist_arguments, wheel_arguments
from hil.service.ros2.robot import Robot
from hil.service.ros2.settings import Settings

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of commands only the newest counts, and none is sent again. It matches publishers of every reliability."""

_WARN_S = 30.0
_LOOK_S = 1.0
_SHORTEST_S = 1e-3
_NUMBER = re.compile(r"[-+]?\d[\d.]*")


class Commands:
    """The topics into a node.

    Attributes:
        figures: for diagnostics, the number of what came and was dropped, and as ``trouble`` what is wrong with those
            who publish on the topics.
    """

    def __init__(self, node: Any, settings: Settings, scenario: Scenario, robot: Robot) -> None:
        self._node = node
        self._settings = settings
        self._scenario = scenario
        self._robot = robot
        self._resources = contextlib.ExitStack()
        self._path_file = self._resources.enter_context(scratch_folder("path")) / "path.csv"
        self.figures: dict[str, Any] = {"cmd_vel": 0, "wheel_commands": 0, "pose_fixes": 0, "dropped": 0, "trouble": ""}
        self._said: dict[str, tuple[float, int]] = {}
        self._troubles: list[str] = []
        rate_hz = math.inf if robot.takes_all else settings.command_rate_hz
        self._twists, self._wheels = (
            _Newest(node, rate_hz, self._order(action)) for action in (Action.TWIST, Action.WHEELS)
        )
        kind = TwistStamped if settings.use_stamped_vel else Twist
        self._subscriptions = [
            node.create_subscription(kind, "cmd_vel", self._twist, _NEWEST),
            node.create_subscription(Float64MultiArray, "wheel_commands", self._wheel_command, _NEWEST),
            node.create_subscription(PathMessage, "path", self._path, 1),
        ]
        self._streams = self._subscriptions[:2]
        estimator = scenario.estimator
        if estimator.source == "fused" and estimator.fix != "simulated":
            self._fixes = _FixSender(estimator.fix)
            self._subscriptions += [
                node.create_subscription(PoseWithCovarianceStamped, "pose", self._fix, _NEWEST),
                node.create_subscription(Odometry, "odometry/filtered", self._fix, _NEWEST),
            ]

        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_LOOK_S, self._look_at_publishers, clock=steady)

    def close(self) -> None:
        """Take nothing in any more."""
        self._node.destroy_timer(self._timer)
        for one in self._subscriptions:
            self._node.destroy_subscription(one)
        self._twists.close()
        self._wheels.close()
        self._resources.close()

    def _order(self, action: Action) -> Callable[[Mapping[str, Any]], None]:
        return lambda arguments: self._robot.order(action, arguments, partial(self._answered, action))

    def _answered(self, action: Action, refused: str | None) -> None:
        if refused is not None:
            self._drop(f"{action.value} refused: {refused}")

    def _drop(self, sentence: str) -> None:
        """Count what was dropped, and say why: at once where that is new, and again with the number after a while."""
        self.figures["dropped"] += 1
        kind, now_s = _NUMBER.sub("", sentence), time.monotonic()
        said_s, count = self._said.get(kind, (-math.inf, 0))
        if now_s - said_s < _WARN_S:
            self._said[kind] = said_s, count + 1
            return
        self._said[kind] = now_s, 0
        self._node.get_logger().warning(sentence + (f" ({count} more since this was said)" if count else ""))

    def _look_at_publishers(self) -> None:
        """Compare who publishes on the topics with what is taken: ROS 2 itself drops other types without a word."""
        found = []
        for one in self._subscriptions:
            topic, taken = one.topic_name, _type_name(one.msg_type)
            publishers = self._node.get_publishers_info_by_topic(topic)
            for other in sorted({each.topic_type for each in publishers} - {taken}):
                advice = f"let it publish {taken}"
                if {taken, other} == {_type_name(Twist), _type_name(TwistStamped)}:
                    advice = f"set the parameter use_stamped_vel to {str(other == _type_name(TwistStamped)).lower()}"
                who = _names(each for each in publishers if each.topic_type == other)
                found.append(f"{topic}: {who} publishes {other}, and {taken} is taken: nothing of it arrives; {advice}")
            ours = [each for each in publishers if each.topic_type == taken]
            if len(ours) > 1 and one in self._streams:
                found.append(
                    f"{topic}: {len(ours)} publishers ({_names(ours)}), and the robot follows whichever was last; "
                    "leave one, or put a multiplexer such as twist_mux between"
                )
        for sentence in found:
            if sentence not in self._troubles:
                self._node.get_logger().warning(sentence)
        self._troubles = found
        self.figures["trouble"] = "; ".join(found)

    def _taken(self, figure: str) -> bool:
        self.figures[figure] += 1
        if self._node.is_active:
            return True
        self._drop(f"{figure} came while the node is not active; it was dropped")
        return False

    def _age_s(self, stamp: Any) -> float:
        """Return the age of a header's stamp; one that is zero says nothing, and counts as new."""
        if stamp.sec == stamp.nanosec == 0:
            return 0.0
        now_ns = self._robot.now_ns()
        if now_ns is None:
            now_ns = self._node.get_clock().now().nanoseconds
        return float(1e-9 * (now_ns - stamp.sec * 1_000_000_000 - stamp.nanosec))

    def _twist(self, message: Any) -> None:
        if not self._taken("cmd_vel"):
            return
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
        if not self._taken("wheel_commands"):
            return
        robot, command = self._scenario.robot, self._scenario.controller.command
        limit = robot.speed_limit_rad_s if command == "speed" else robot.torque_limit_n_m
        try:
            self._wheels.send(wheel_arguments(message.data, command, limit))
        except BadInputError as error:
            self._drop(str(error))

    def _fix(self, message: Any) -> None:
        """Send a pose of a localisation to the estimator, which judges it; it moves nothing by itself."""
        self.figures["pose_fixes"] += 1
        at = message.pose.pose
        try:
            pose = Pose(at.position.x, at.position.y, heading(at.orientation))
            self._fixes.send(self._age_s(message.header.stamp), pose, plane_covariance(message.pose.covariance))
        except (BadInputError, OSError) as error:
            self._drop(f"pose fix: {error}")

    def _path(self, message: Any) -> None:
        """Follow a path: at its stamps where they ascend, else at the speed of the parameter."""
        if not self._node.is_active:
            self._drop("a path came while the node is not active; it was dropped")
            return
        try:
            poses = [
                (
                    one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec,
                    one.pose.position,
                    heading(one.pose.orientation),
                )
                for one in message.poses
            ]
            text, has_times = path_table([(time_s, Pose(at.x, at.y, yaw)) for time_s, at, yaw in poses])
        except BadInputError as error:
            self._drop(f"path: {error}")
            return
        file = self._path_file
        file.write_text(text, encoding="ascii")
        reference: dict[str, Any] = {"kind": "trajectory", "file": str(file), "ramp_s": 0.0}
        if not has_times:
            settings, service = self._settings, self._scenario.service
            reference = {
                "kind": "waypoints",
                "file": str(file),
                "corners": "blend",
                "max_speed_m_s": min(settings.path_speed_m_s, service.speed_m_s),
                "max_yaw_rate_rad_s": min(settings.path_yaw_rate_rad_s, service.yaw_rate_rad_s),
                "max_acceleration_m_s2": min(0.5, service.acceleration_m_s2),
                "max_yaw_acceleration_rad_s2": min(2.0, service.yaw_acceleration_rad_s2),
            }
        self._robot.order(Action.TRACK, {"reference": reference, "here": False}, partial(self._answered, Action.TRACK))


def _type_name(kind: Any) -> str:
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def _names(publishers: Iterable[Any]) -> str:
    return ", ".join(sorted({f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in publishers}))


class _Newest:
    """Sends the newest of a stream of orders, at most so many a second: another node may flood us."""

    def __init__(self, node: Any, rate_hz: float, send: Callable[[Mapping[str, Any]], None]) -> None:
        self._send = send
        self._period_s = 1.0 / rate_hz
        self._sent_s = 0.0
        self._waiting: Mapping[str, Any] | None = None
        self._node = node
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

    def close(self) -> None:
        """Send nothing more."""
        self._waiting = None
        self._node.destroy_timer(self._timer)


class _FixSender:
    """Sends pose fixes to the estimator of a service of this user (hil/estimation/ESTIMATORS.md)."""

    def __init__(self, address: str) -> None:
        self._to = parse_address(address)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._token: str | None = None

    def send(self, age_s: float, pose: Pose, covariance: list[float]) -> None:
        """Send one. Raises BadInputError while the service has no token yet, OSError when it cannot be sent."""
        if self._token is None:
            self._token = read_token(token_file("fixes", self._to[1]))
        fix = {"version": VERSION, "token": self._token, "age_s": age_s, **pose._asdict(), "covariance": covariance}
        self._socket.sendto(json.dumps(fix).encode(), self._to)
