"""A control law in a ROS 2 node of its own: run by ``tools.bench.ros2`` against the simulator of ``hil ros2``.

For each pose on ground_truth/odom it computes the law's wheel commands and sends them, with the pose's stamp as their
sequence number. Prints one JSON object: the error from the path, and after how much simulated time commands acted.
"""

import argparse
import json
import math
import time
from typing import Any

import numpy as np

from hil.core.kinematics import BodyTwist, to_world
from hil.core.types import ZERO_WHEELS, Applied, CommandMode, Pose, State, WheelCommand
from hil.references import make_reference
from hil.scenario import Scenario, load
from hil.scenario.laws import make_laws

_STEADY_S = 10.0
_LIMIT_S = 600.0


class LawNode:
    """The law and its figures. It begins when the robot is armed, and ends after the scenario's duration."""

    def __init__(self, node: Any, scenario: Scenario, latency_s: float) -> None:
        from nav_msgs.msg import Odometry
        from rclpy.qos import qos_profile_sensor_data
        from std_msgs.msg import Float64MultiArray, Int64

        self._law = make_laws(scenario, scenario.directory).controller
        self._path = make_reference(scenario.reference.kind, scenario.reference.options, scenario.directory)
        self._duration_s = scenario.loop.duration_s
        self._latency_s = latency_s
        rest = WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, ZERO_WHEELS)
        self._applied = Applied(rest, False, latency_s)
        self._message, self._to = Float64MultiArray(), node.create_publisher(Float64MultiArray, "wheel_commands", 1)
        node.create_subscription(Odometry, "ground_truth/odom", self._on_pose, qos_profile_sensor_data)
        node.create_subscription(Int64, "wheel_commands/applied", self._on_applied, qos_profile_sensor_data)
        self.is_armed = self.is_done = False
        self._begin_ns: int | None = None
        self._now_ns = self._before_ns = 0
        self._newest_applied = -1
        self.errors: list[tuple[float, float]] = []
        self.latencies_s: list[float] = []
        self._begun_s = 0.0
        self.wall_s = 0.0

    def _on_applied(self, message: Any) -> None:
        if message.data > self._newest_applied:
            self._newest_applied = message.data
            # It is said with the pose of the tick that used it.
            self.latencies_s.append(1e-9 * (self._now_ns - message.data))

    def _on_pose(self, message: Any) -> None:
        stamp, pose, twist = message.header.stamp, message.pose.pose, message.twist.twist
        self._now_ns = now_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
        if not self.is_armed or self.is_done:
            return
        yaw = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)  # about the vertical axis
        world = to_world(BodyTwist(twist.linear.x, twist.linear.y, twist.angular.z), yaw)
        state = State(Pose(pose.position.x, pose.position.y, yaw), world)
        if self._begin_ns is None:
            self._begin_ns, self._before_ns, self._begun_s = now_ns, now_ns - 1, time.monotonic()
            self._law.reset(state, self._path.at(0.0))
        t_s = 1e-9 * (now_ns - self._begin_ns)
        reference = self._path.at(t_s)
        self.errors.append((t_s, math.dist(state.pose[:2], reference.pose[:2])))
        command = self._law.update(reference, state, self._applied, 1e-9 * (now_ns - self._before_ns))
        self._before_ns = now_ns
        self._message.data = [*command.torque_n_m, float(now_ns)]
        self._to.publish(self._message)
        self._applied = Applied(command, False, self._latency_s)
        if t_s >= self._duration_s:
            self.is_done, self.wall_s = True, time.monotonic() - self._begun_s

    def figures(self) -> dict[str, float]:
        """Return errors [mm], latencies [ms] and the real-time factor that was reached."""
        steady_mm = 1e3 * np.array([error for t_s, error in self.errors if t_s >= _STEADY_S])
        latencies_ms = 1e3 * np.array(self.latencies_s[10:])
        return {
            "rms_mm": float(np.sqrt(np.mean(steady_mm**2))),
            "largest_mm": float(steady_mm.max()),
            "latency_p50_ms": float(np.percentile(latencies_ms, 50)),
            "latency_p99_ms": float(np.percentile(latencies_ms, 99)),
            "jitter_ms": float(latencies_ms.std()),
            "commands": len(self.errors),
            "real_time_factor": self.errors[-1][0] / self.wall_s,
        }


def main() -> None:
    """Arm the robot, drive it along the scenario's path, print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--latency-s", type=float, default=0.0)
    asked = parser.parse_args()
    import rclpy
    from std_srvs.srv import Trigger

    rclpy.init()
    node = rclpy.create_node("law")
    law = LawNode(node, load(asked.scenario, set=asked.set), asked.latency_s)
    arm = node.create_client(Trigger, "mecanum_hil/arm")
    limit_s = time.monotonic() + _LIMIT_S
    armed: Any = None
    while not law.is_done and time.monotonic() < limit_s:
        rclpy.spin_once(node, timeout_sec=0.1)
        if armed is None and arm.service_is_ready() and law._now_ns > 0:
            armed = arm.call_async(Trigger.Request())
        elif armed is not None and armed.done() and not law.is_armed:
            if armed.result().success:
                law.is_armed = True
            else:
                armed = None
    print(json.dumps(law.figures()))


if __name__ == "__main__":
    main()
