"""A simulated robot as a ROS 2 node: every topic and service, with real nodes; and what is pure of it, by laws."""

import contextlib
import math
import os
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace as Values
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hil.addons.ros2 import convert
from hil.addons.ros2.settings import Settings
from hil.core.errors import BadInputError
from tests.support.processes import HIL, environment, hil, wait_for
from tests.support.ros2_testbed import Peer, needs_ros, node, twist

NUMBER = st.floats(-100.0, 100.0)
THREE = st.tuples(NUMBER, NUMBER, NUMBER)
FOUR = st.lists(NUMBER, min_size=4, max_size=4)
SIMULATED = ("circle_speed", "--mode", "lockstep", "--set", "loop.rate_hz=100")


def vector(three: tuple[float, float, float]) -> Any:
    """A Twist with parts that a robot in the plane cannot do."""
    return Values(linear=Values(x=three[0], y=three[1], z=9.0), angular=Values(x=9.0, y=9.0, z=three[2]))


@given(THREE, THREE)
def test_the_twist_of_an_odometry_is_the_world_s_in_the_robot_s_frame(
    pose: tuple[float, float, float], world: tuple[float, float, float]
) -> None:
    z, w = convert.quaternion(pose[2])
    cosine, sine = 1.0 - 2.0 * z * z, 2.0 * w * z  # the columns of the quaternion's rotation matrix
    forward, left, yaw_rate = convert.body_twist(pose, world)
    assert (cosine * forward - sine * left, sine * forward + cosine * left) == pytest.approx(world[:2], abs=1e-9)
    assert yaw_rate == world[2]
    assert math.remainder(math.atan2(sine, cosine) - pose[2], 2 * math.pi) == pytest.approx(0.0)


@given(THREE)
def test_a_twist_beyond_the_limits_keeps_its_direction(three: tuple[float, float, float]) -> None:
    arguments = convert.twist_arguments(vector(three), 0.5, 2.0)
    largest = max(math.hypot(*three[:2]) / 0.5, abs(three[2]) / 2.0, 1.0)
    scaled = dict(zip(("vx_m_s", "vy_m_s", "yaw_rate_rad_s"), (value / largest for value in three), strict=True))
    assert arguments == pytest.approx(scaled)


@given(FOUR, st.none() | st.integers(0, 2**53))
@example([0.0] * 4, 0)
@example([0.0] * 4, 2**53)
def test_wheel_commands_keep_their_ratio_and_their_sequence(wheels: list[float], sequence: int | None) -> None:
    given = wheels if sequence is None else [*wheels, float(sequence)]
    arguments = convert.wheel_arguments(given, "speed", 30.0)
    largest = max(max(map(abs, wheels)) / 30.0, 1.0)
    assert arguments["values"] == pytest.approx([value / largest for value in wheels])
    assert (arguments["sequence"], arguments["command"]) == (sequence, "speed")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ([], "has 0 numbers; expected FL, FR, RR, RL, and a fifth only as sequence"),
        ([1.0] * 3, "has 3 numbers; expected"),
        ([1.0] * 6, "has 6 numbers; expected"),
        ([1.0, 1.0, math.nan, 1.0], "has 4 numbers, not all finite; expected"),
        ([1.0, 1.0, 1.0, 1.0, 0.5], "has the sequence 0.5; expected a whole number from 0 on"),
        ([1.0, 1.0, 1.0, 1.0, -1.0], "has the sequence -1.0; expected"),
        ([1.0, 1.0, 1.0, 1.0, 2.0**53 + 2.0], "has the sequence 9007199254740994.0; expected"),
    ],
)
def test_other_data_commands_no_wheel(data: list[float], words: str) -> None:
    with pytest.raises(BadInputError, match=f"wheel_commands {re.escape(words)}"):
        convert.wheel_arguments(data, "speed", 30.0)


@given(NUMBER, NUMBER)
def test_a_covariance_has_the_variances_of_what_is_known_on_its_diagonal(position: float, yaw: float) -> None:
    matrix = np.reshape(convert.covariance(position, yaw), (6, 6))
    assert matrix == pytest.approx(np.diag([position**2, position**2, 1e6, 1e6, 1e6, yaw**2]))


def test_wheels_that_are_not_known_are_no_numbers() -> None:
    assert convert.in_order((1.0, 2.0, 3.0, 4.0)) == (1.0, 2.0, 3.0, 4.0)
    assert list(map(math.isnan, convert.in_order(None))) == [True] * 4


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"joint_names": ("a", "b", "c")}, "joint_names: 3 values; expected 4"),
        ({"pose_sigma": (0.1,)}, "pose_sigma: 1 values; expected 2"),
        ({"twist_sigma": (0.1, 0.1, 0.1)}, "twist_sigma: 3 values; expected 2"),
        ({"joint_names": ("a", "b", "c", "a")}, "joint_names: two wheels have the same name; expected FL, FR, RR, RL"),
        ({"publish_rate_hz": 0.99}, "publish_rate_hz = 0.99: expected 1 to 1000"),
        ({"publish_rate_hz": 1001.0}, "publish_rate_hz = 1001.0: expected 1 to 1000"),
        ({"command_timeout_s": 0.009}, "command_timeout_s = 0.009: expected 0.01 to 10"),
        ({"command_timeout_s": 10.1}, "command_timeout_s = 10.1: expected 0.01 to 10"),
        ({"command_rate_hz": 0.9}, "command_rate_hz = 0.9: expected 1 to 150"),
        ({"command_rate_hz": 151.0}, "command_rate_hz = 151.0: expected 1 to 150"),
        ({"real_time_factor": 0.0}, "real_time_factor = 0.0: expected 0.001 to 1000"),
        ({"real_time_factor": 1001.0}, "real_time_factor = 1001.0: expected 0.001 to 1000"),
        ({"wait_for_wheels_s": -0.1}, "wait_for_wheels_s = -0.1: expected 0 to 10"),
        ({"wait_for_wheels_s": 10.1}, "wait_for_wheels_s = 10.1: expected 0 to 10"),
    ],
)
def test_a_parameter_out_of_its_range_is_named(given: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInputError, match=re.escape(f"parameter {words}")):
        Settings(**given).check()


def test_parameters_at_the_ends_of_their_ranges_are_taken() -> None:
    low = {"publish_rate_hz": 1.0, "command_timeout_s": 0.01, "command_rate_hz": 1.0, "real_time_factor": 0.001}
    high = {"publish_rate_hz": 1000.0, "command_timeout_s": 10.0, "command_rate_hz": 150.0, "real_time_factor": 1000.0}
    for taken in (low | {"wait_for_wheels_s": 0.0}, high | {"wait_for_wheels_s": 10.0}):
        Settings(**taken).check()


def test_a_twist_that_is_not_finite_is_refused() -> None:
    with pytest.raises(BadInputError, match="expected finite numbers; the robot stops"):
        convert.twist_arguments(vector((math.nan, 0.0, 0.0)), 0.5, 1.0)


def test_without_ros_it_says_what_to_install(tmp_path: Path) -> None:
    (tmp_path / "rclpy.py").write_text("raise ImportError('no rclpy')")
    variables = environment() | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{environment()['PYTHONPATH']}"}
    done = subprocess.run([*HIL, "ros2", *SIMULATED], capture_output=True, text=True, env=variables, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("hil: ROS 2 is not there for this Python 3.")
    assert "pip install 'mecanum-hil[ros2]'" in done.stderr


def test_humble_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DISTRO", "humble")
    done = hil("ros2", *SIMULATED)
    assert (done.returncode, done.stdout) == (2, "")
    assert "ROS 2 Humble is sourced, which is made for an older Python than hil needs (3.11)" in done.stderr


def test_an_option_that_is_none_is_not_taken_for_one_of_ros() -> None:
    done = hil("ros2", *SIMULATED, "--no-such-option")
    assert (done.returncode, "'--no-such-option' is no option of hil ros2" in done.stderr) == (2, True)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Peer]:
    """Another node next to one robot, at the root, with all messages of its topics from the start."""
    peer = Peer("")
    try:
        peer.listen("odom", "ground_truth/odom", "joint_states", "imu/data_raw", "battery_state")
        peer.listen("diagnostics", "clock")
        with node(tmp_path_factory.mktemp("node"), *SIMULATED, ros=("-p", "publish_rate_hz:=50.0")):
            wait_for(lambda: peer.phase() == "disarmed", 120.0)
            yield peer
    finally:
        peer.close()


def stamp_of(message: Any) -> float:
    stamp = message["header"]["stamp"]
    return float(stamp["sec"] + 1e-9 * stamp["nanosec"])


def speed_of(message: Any) -> float:
    linear = message["twist"]["twist"]["linear"]
    return math.hypot(linear["x"], linear["y"])


def body_twist(message: Any) -> tuple[float, float, float]:
    twist = message["twist"]["twist"]
    return twist["linear"]["x"], twist["linear"]["y"], twist["angular"]["z"]


@pytest.fixture
def armed(robot: Peer) -> Iterator[Peer]:
    """The robot armed and at rest at the start; disarmed at the end."""
    wait_for(lambda: robot.phase() == "disarmed")
    robot.arm()
    yield robot
    for topic in ("cmd_vel", "wheel_commands"):
        robot.publish(topic, 0.0)
    robot.call("disarm")


@needs_ros
def test_nothing_arms_by_itself(robot: Peer) -> None:
    robot.publish("cmd_vel", 20.0, **twist(0.4))
    until_s = stamp_of(robot.next("odom")) + 1.0
    wait_for(lambda: stamp_of(robot.newest("odom")) > until_s)
    robot.publish("cmd_vel", 0.0)
    assert robot.phase() == "disarmed"
    assert speed_of(robot.newest("ground_truth/odom")) < 1e-6


@needs_ros
def test_a_twist_drives_all_topics_and_times_out(armed: Peer) -> None:
    armed.publish("cmd_vel", 50.0, **twist(0.2, 0.1, 0.3))
    wait_for(lambda: body_twist(armed.newest("odom")) == pytest.approx((0.2, 0.1, 0.3), abs=0.02))
    odom, truth = armed.newest("odom"), armed.newest("ground_truth/odom")
    assert (odom["header"]["frame_id"], odom["child_frame_id"]) == ("odom", "base_link")
    variances = [odom["pose"]["covariance"][place] for place in (0, 7, 14, 35)]
    assert variances == pytest.approx([0.0025, 0.0025, 1e6, 0.0025])
    assert truth["pose"]["pose"]["position"]["x"] == pytest.approx(odom["pose"]["pose"]["position"]["x"], abs=0.1)
    joints = armed.next("joint_states")
    ends = ("front_left", "front_right", "rear_right", "rear_left")
    assert joints["name"] == [f"{name}_wheel_joint" for name in ends]
    # The inverse kinematics of a Mecanum robot (paper, eq. 2): fl = (vx - vy - l w) / r.
    assert joints["velocity"][0] == pytest.approx((0.2 - 0.1 - 0.6 * 0.3) / 0.075, abs=0.5)
    assert joints["velocity"][2] == pytest.approx((0.2 - 0.1 + 0.6 * 0.3) / 0.075, abs=0.5)
    before = joints["position"]
    assert armed.next("joint_states")["position"][1] > before[1]
    assert armed.newest("imu/data_raw")["angular_velocity"]["z"] == pytest.approx(0.3, abs=0.05)
    assert armed.newest("battery_state")["voltage"] > 10.0

    armed.publish("cmd_vel", 0.0)
    last_s = stamp_of(armed.newest("odom"))
    wait_for(lambda: speed_of(armed.newest("odom")) < 0.01)
    assert stamp_of(armed.newest("odom")) - last_s < 0.2 + 0.25 + 0.8  # timeout, ramp, and the processes' own delay
    assert armed.phase() == "active"


@needs_ros
def test_a_law_in_another_node_commands_the_wheels_and_a_late_command_does_not(armed: Peer) -> None:
    armed.publish("wheel_commands", 20.0, data=[2.0, 2.0, 2.0, 2.0])
    wait_for(lambda: min(armed.newest("joint_states")["velocity"]) > 1.8)
    armed.publish("wheel_commands", 20.0, data=[3.0, 3.0, 3.0, 3.0, 7.0])
    wait_for(lambda: min(armed.newest("joint_states")["velocity"]) > 2.5)
    # From the second one on the sequence is an old one: the command is not renewed, and times out.
    wait_for(lambda: max(map(abs, armed.newest("joint_states")["velocity"])) < 0.2)
    armed.publish("wheel_commands", 0.0)


@needs_ros
def test_an_e_stop_latches_until_it_is_cleared(armed: Peer) -> None:
    armed.publish("cmd_vel", 20.0, **twist(0.3))
    wait_for(lambda: speed_of(armed.newest("odom")) > 0.2)
    assert armed.call("estop")["success"]
    wait_for(lambda: armed.phase() == "estop" and speed_of(armed.newest("ground_truth/odom")) < 0.01)
    refused = armed.call("arm")
    assert (refused["success"], "the robot is estop" in refused["message"]) == (False, True)
    assert armed.newest("diagnostics")["status"][0]["level"] == 2
    armed.publish("cmd_vel", 0.0)
    assert armed.call("clear")["success"]
    wait_for(lambda: armed.phase() == "disarmed")
    assert armed.call("stop")["message"].startswith("the robot is disarmed; arm it first")


@needs_ros
def test_a_second_robot_in_its_namespace_starts_elsewhere_and_takes_stamped_twists(robot: Peer, tmp_path: Path) -> None:
    stamped = ("-p", "use_stamped_vel:=true", "-p", "publish_rate_hz:=50.0", "-p", "base_frame_id:=two/base_link")
    elsewhere = ("--set", "plant.start.start_x_m=3.0", "--set", "plant.start.start_heading_rad=0.0")
    with node(tmp_path, *SIMULATED, *elsewhere, ros=stamped, namespace="/two"):
        two = Peer("/two")  # a late joiner, as far as the first robot goes
        try:
            two.listen("odom", "diagnostics", "ground_truth/odom")
            two.arm()
            kind = "geometry_msgs/msg/TwistStamped"
            first = robot.next("ground_truth/odom")["pose"]["pose"]["position"]
            two.publish("cmd_vel", 50.0, kind=kind, twist=twist(0.2))
            wait_for(lambda: speed_of(two.newest("odom")) > 0.15)
            assert two.newest("odom")["child_frame_id"] == "two/base_link"
            assert two.newest("ground_truth/odom")["pose"]["pose"]["position"]["x"] > 3.0
            assert robot.next("ground_truth/odom")["pose"]["pose"]["position"] == pytest.approx(first, abs=1e-3)
            old = {"stamp": {"sec": 0, "nanosec": 1}}  # by simulated time, whatever the node's parameters are
            two.publish("cmd_vel", 50.0, kind=kind, twist=twist(0.2), header=old)
            wait_for(lambda: speed_of(two.newest("odom")) < 0.01)
        finally:
            two.close()


@needs_ros
def test_what_is_refused_is_told_once_and_stays_in_diagnostics(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        process = stack.enter_context(node(tmp_path, *SIMULATED, namespace="/three"))
        first, stamped = (stack.enter_context(contextlib.closing(Peer("/three"))) for _ in range(2))
        first.listen("diagnostics")

        def diagnosed(key: str) -> str:
            values = first.next("diagnostics")["status"][0]["values"]
            return str({one["key"]: one["value"] for one in values}[key])

        wait_for(lambda: first.phase() == "disarmed", 120.0)
        first.publish("cmd_vel", 50.0, **twist(0.1))
        wait_for(lambda: int(diagnosed("dropped")) > 50)
        stamped.publish("cmd_vel", 1.0, kind="geometry_msgs/msg/TwistStamped")
        wait_for(lambda: "see the parameter use_stamped_vel" in (tmp_path / "node.log").read_text())
        for _ in range(2):  # as a window that is closed does it
            process.send_signal(signal.SIGHUP)
        assert process.wait(timeout=60) == 0
    said = (tmp_path / "node.log").read_text()
    assert said.count("twist refused: the robot is disarmed; arm it first") == 1
    assert (
        said.count("/three/cmd_vel: geometry_msgs/msg/TwistStamped is published, and geometry_msgs/msg/Twist is taken")
        == 1
    )
    assert "order refused" not in said, "of the service's log, without which one and why"
