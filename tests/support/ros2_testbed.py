"""Real ROS 2 nodes in processes of their own, on the loopback interface and in a domain of this test run."""

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.processes import HIL, environment, wait_for

needs_ros = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="ROS 2 is not there; pip install -e '.[ros2]' on Linux x86_64"
)
TYPES = {
    "odom": "nav_msgs/msg/Odometry",
    "ground_truth/odom": "nav_msgs/msg/Odometry",
    "joint_states": "sensor_msgs/msg/JointState",
    "imu/data_raw": "sensor_msgs/msg/Imu",
    "battery_state": "sensor_msgs/msg/BatteryState",
    "diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "clock": "rosgraph_msgs/msg/Clock",
    "cmd_vel": "geometry_msgs/msg/Twist",
    "wheel_commands": "std_msgs/msg/Float64MultiArray",
}
TRIGGER = "std_srvs/srv/Trigger"


def ros_environment() -> dict[str, str]:
    """Return an environment in which nodes find only those of this process's tests."""
    apart = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    return environment() | apart


class Peer:
    """``tests.support.ros2_peer`` in a process of its own, for the robot in a namespace."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        command = [sys.executable, "-m", "tests.support.ros2_peer"]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=ros_environment()
        )

    def ask(self, **asked: Any) -> dict[str, Any]:
        """Say a line, and return the answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(asked) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        assert isinstance(answer, dict)
        return answer

    def listen(self, *topics: str) -> None:
        for topic in topics:
            self.ask(listen=f"{self.namespace}/{topic}", type=TYPES[topic])

    def newest(self, topic: str) -> Any:
        """Return the newest message of a topic that is listened to, or None."""
        return self.ask(newest=f"{self.namespace}/{topic}")["message"]

    def count(self, topic: str) -> int:
        return int(self.ask(newest=f"{self.namespace}/{topic}")["count"])

    def next(self, topic: str) -> Any:
        """Wait for a message that has not come yet, and return it."""
        count = self.count(topic)
        wait_for(lambda: self.count(topic) > count)
        return self.newest(topic)

    def publish(self, topic: str, rate_hz: float, **values: Any) -> None:
        kind = values.pop("kind", TYPES[topic])
        self.ask(publish=f"{self.namespace}/{topic}", type=kind, values=values, rate_hz=rate_hz)

    def once(self, topic: str, **values: Any) -> None:
        self.ask(once=f"{self.namespace}/{topic}", type=TYPES[topic], values=values)

    def call(self, service: str, kind: str = TRIGGER, **values: Any) -> Any:
        return self.ask(call=f"{self.namespace}/mecanum_hil/{service}", type=kind, values=values)["answer"]

    def phase(self) -> str:
        """Return the phase of the robot that the newest diagnostics have."""
        message = self.newest("diagnostics")
        values = {} if message is None else {one["key"]: one["value"] for one in message["status"][0]["values"]}
        return str(values.get("phase"))

    def arm(self) -> None:
        """Arm the robot, as soon as it answers, and wait until it is active."""
        wait_for(lambda: self.call("arm")["success"] or self.phase() in ("active", "arming"))
        wait_for(lambda: self.phase() == "active")

    def close(self) -> None:
        """End it. Calling twice is allowed."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(timeout=30)


@contextlib.contextmanager
def node(folder: Path, *arguments: str, ros: tuple[str, ...] = (), namespace: str = "") -> Iterator[Any]:
    """A ``hil ros2`` process; it ends by SIGINT as from ros2 launch."""
    within = ("-r", f"__ns:={namespace}") if namespace else ()
    log = (folder / "node.log").open("w")
    process = subprocess.Popen(
        [*HIL, "ros2", *arguments, "--ros-args", *within, *ros], env=ros_environment(), cwd=folder, stderr=log
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60)
        log.close()


def twist(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> dict[str, Any]:
    return {"linear": {"x": x, "y": y}, "angular": {"z": yaw}}
