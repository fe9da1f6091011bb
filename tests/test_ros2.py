"""A simulated robot as a ROS 2 node: every topic and service, with real nodes; and what is pure of it, by laws."""

import contextlib
import math
import os
import signal
import subprocess
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace as Values
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.core.errors import BadInputError
from hil.core.types import Pose
from hil.service.ros2 import convert
from tests.processes import HIL, environment, hil, wait_for
from tests.ros2_testbed import Peer, needs_ros, node, twist

NUMBER = st.floats(-100.0, 100.0)
THREE = st.tuples(NUMBER, NUMBER, NUMBER)
FOUR = st.lists(NUMBER, min_size=4, max_size=4)
SIMULATED = ("circle_speed", "--mode", "lockstep", "--set", "loop.rate_hz=100")
INTERFACES = "simulation_interfaces/srv"


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
    assert math.remainder(convert.heading(Values(x=0.0, y=0.0, z=z, w=w)) - pose[2], 2 * math.pi) == pytest.approx(0.0)


@given(THREE)
def test_a_twist_beyond_the_limits_keeps_its_direction(three: tuple[float, float, float]) -> None:
    arguments = tuple(convert.twist_arguments(vector(three), 0.5, 1.0).values())
    largest = max(math.hypot(*three[:2]) / 0.5, abs(three[2]), 1.0)
    assert arguments == pytest.approx([value / largest for value in three])


@given(FOUR, st.none() | st.integers(0, 2**53))
def test_wheel_commands_keep_their_ratio_and_their_sequence(wheels: list[float], sequence: int | None) -> None:
    given = wheels if sequence is None else [*wheels, float(sequence)]
    arguments = convert.wheel_arguments(given, "speed", 30.0)
    largest = max(max(map(abs, wheels)) / 30.0, 1.0)
    assert arguments["values"] == pytest.approx([value / largest for value in wheels])
    assert arguments["sequence"] == sequence


@pytest.mark.parametrize("data", [[], [1.0] * 3, [1.0] * 6, [math.nan] * 4, [1.0, 1.0, 1.0, 1.0, 0.5]])
def test_other_data_commands_no_wheel(data: list[float]) -> None:
    with pytest.raises(BadInputError, match="wheel_commands"):
        convert.wheel_arguments(data, "speed", 30.0)


def test_a_twist_that_is_not_finite_is_refused() -> None:
    with pytest.raises(BadInputError, match="expected finite numbers; the robot stops"):
        convert.twist_arguments(vector((math.nan, 0.0, 0.0)), 0.5, 1.0)


def test_a_path_goes_by_its_times_where_they_ascend_and_turns_the_shorter_way() -> None:
    poses = [Pose(float(x), 0.0, 3.1 if x % 2 else -3.1) for x in range(4)]
    timed, has_times = convert.path_table([(100.0 + x, pose) for x, pose in enumerate(poses)])
    assert has_times
    assert timed.splitlines()[:3] == ["t_s,x_m,y_m,heading_rad", "0.0,0.0,0.0,-3.1", "1.0,1.0,0.0,3.1"]
    table, has_times = convert.path_table([(0.0, pose) for pose in (poses[0], *poses)])
    assert not has_times
    turns = [float(line.split(",")[2]) for line in table.splitlines()[1:]]
    assert len(turns) == 4
    assert max(abs(after - before) for before, after in pairwise(turns)) < 0.1


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
    """Another node beside one robot, at the root, that has heard all its topics from the start."""
    peer = Peer("")
    try:
        peer.listen("odom", "ground_truth/odom", "tf", "joint_states", "imu/data_raw", "battery_state")
        peer.listen("wheel_currents", "diagnostics", "clock")
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
    transform = armed.next("tf")["transforms"][0]
    assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("odom", "base_link")
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
    assert len(armed.newest("wheel_currents")["data"]) == 4

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
def test_a_path_is_followed_to_its_end(armed: Peer) -> None:
    at = armed.next("odom")["pose"]["pose"]["position"]
    ends = [{"position": {"x": at["x"] + dx, "y": at["y"]}, "orientation": {"w": 1.0}} for dx in (0.0, 0.3)]
    armed.once("path", poses=[{"pose": pose} for pose in ends])
    wait_for(lambda: armed.newest("odom")["pose"]["pose"]["position"]["x"] > at["x"] + 0.29)
    wait_for(lambda: speed_of(armed.newest("odom")) < 0.01)
    assert armed.newest("odom")["pose"]["pose"]["position"]["x"] == pytest.approx(at["x"] + 0.3, abs=0.03)


@needs_ros
def test_a_path_with_ascending_stamps_is_followed_at_its_times(armed: Peer) -> None:
    at = armed.next("odom")["pose"]["pose"]["position"]
    poses = [
        {
            "header": {"stamp": {"sec": 1000 + after_s}},
            "pose": {"position": {"x": at["x"] + dx, "y": at["y"]}, "orientation": {"w": 1.0}},
        }
        for after_s, dx in ((0, 0.0), (2, 0.08), (4, 0.16), (6, 0.24))
    ]
    armed.once("path", poses=poses)
    begin_s = stamp_of(armed.newest("odom"))
    wait_for(lambda: armed.newest("odom")["pose"]["pose"]["position"]["x"] > at["x"] + 0.23)
    # At the speed of the parameter it takes 1.5 s.
    assert stamp_of(armed.newest("odom")) - begin_s > 4.0
    assert armed.call("stop")["success"]


@needs_ros
def test_a_node_that_is_deactivated_stops_and_says_nothing_and_one_that_is_cleaned_up_begins_anew(armed: Peer) -> None:
    def change(transition: int) -> bool:
        answer = armed.call("change_state", "lifecycle_msgs/srv/ChangeState", transition={"id": transition})
        return bool(answer["success"])

    configure, cleanup, activate, deactivate = 1, 2, 3, 4  # lifecycle_msgs/msg/Transition
    armed.publish("cmd_vel", 20.0, **twist(0.3))
    wait_for(lambda: speed_of(armed.newest("odom")) > 0.25)
    assert change(deactivate)
    count = armed.count("odom")
    armed.publish("cmd_vel", 20.0, **twist(0.3))
    time_s = armed.next("clock")["clock"]["sec"] + 1
    wait_for(lambda: armed.newest("clock")["clock"]["sec"] > time_s)
    assert armed.count("odom") - count < 3  # those that were on their way
    assert change(activate)
    wait_for(lambda: speed_of(armed.next("odom")) > 0.25)  # the robot was stopped, and not disarmed
    assert change(deactivate)
    armed.publish("cmd_vel", 0.0)
    assert not change(configure)
    assert change(cleanup)
    assert armed.call("estop")["success"]  # in every state
    assert change(configure)
    assert change(activate)
    wait_for(lambda: armed.phase() == "estop")
    assert speed_of(armed.next("ground_truth/odom")) < 0.01
    assert armed.call("clear")["success"]
    wait_for(lambda: armed.phase() == "disarmed")


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
def test_the_simulation_pauses_steps_starts_elsewhere_and_starts_anew(robot: Peer) -> None:
    def simulator(name: str, **values: Any) -> Any:
        kind = "".join(part.capitalize() for part in name.split("_"))
        return robot.call(name, f"{INTERFACES}/{kind}", **values)

    def time_s() -> float:
        clock = robot.next("clock")["clock"]
        return float(clock["sec"] + 1e-9 * clock["nanosec"])

    def place() -> tuple[float, float]:
        at = simulator("get_entity_state", entity="robot")["state"]["pose"]["position"]
        return at["x"], at["y"]

    assert 31 in simulator("get_simulator_features")["features"]["features"]
    assert simulator("get_simulation_state")["state"]["state"] == 1
    assert simulator("step_simulation", steps=1)["result"]["result"] == 4
    assert simulator("set_simulation_state", state={"state": 2})["result"]["result"] == 1
    assert simulator("set_simulation_state", state={"state": 2})["result"]["result"] == 101
    begin_s = time_s()
    assert time_s() == begin_s
    assert simulator("step_simulation", steps=7)["result"]["result"] == 1
    assert time_s() - begin_s == pytest.approx(0.07)
    assert simulator("get_entity_state", entity="table")["result"]["result"] == 2
    moved = {"pose": {"position": {"x": 2.0, "y": -1.0}, "orientation": {"z": math.sin(0.5), "w": math.cos(0.5)}}}
    assert simulator("set_entity_state", entity="robot", state=moved, set_twist=True)["result"]["result"] == 0
    assert simulator("set_entity_state", entity="robot", state=moved, set_pose=True)["result"]["result"] == 1
    assert simulator("step_simulation", steps=2)["result"]["result"] == 1
    assert place() == pytest.approx((2.0, -1.0), abs=1e-3)
    assert time_s() > begin_s
    assert simulator("reset_simulation")["result"]["result"] == 1
    assert simulator("step_simulation", steps=1)["result"]["result"] == 1
    assert time_s() < 0.05
    assert place() == pytest.approx((0.5, 0.0), abs=1e-3)  # as circle_speed has it
    assert simulator("set_simulation_state", state={"state": 1})["result"]["result"] == 1
    wait_for(lambda: robot.phase() == "disarmed")


@needs_ros
def test_a_second_robot_in_its_namespace_starts_elsewhere_and_takes_stamped_twists(robot: Peer, tmp_path: Path) -> None:
    stamped = ("-p", "use_stamped_vel:=true", "-p", "publish_rate_hz:=50.0", "-p", "base_frame_id:=two/base_link")
    with node(tmp_path, *SIMULATED, ros=(*stamped, "-p", "spawn_pose:=[3.0, 1.0, 0.0]"), namespace="/two"):
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
def test_what_is_refused_and_who_publishes_amiss_is_told_once_and_stays_in_diagnostics(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        process = stack.enter_context(node(tmp_path, *SIMULATED, namespace="/three"))
        first, second, stamped = (stack.enter_context(contextlib.closing(Peer("/three"))) for _ in range(3))
        first.listen("diagnostics")

        def diagnosed(key: str) -> str:
            values = first.next("diagnostics")["status"][0]["values"]
            return str({one["key"]: one["value"] for one in values}[key])

        wait_for(lambda: first.phase() == "disarmed", 120.0)
        first.publish("cmd_vel", 50.0, **twist(0.1))
        wait_for(lambda: int(diagnosed("dropped")) > 50)
        second.publish("cmd_vel", 1.0, **twist(0.1))
        stamped.publish("cmd_vel", 1.0, kind="geometry_msgs/msg/TwistStamped")
        wait_for(lambda: "twist_mux" in diagnosed("trouble") and "use_stamped_vel to true" in diagnosed("trouble"))
        assert first.next("diagnostics")["status"][0]["level"] == 1
        for one in (second, stamped):
            one.close()
        wait_for(lambda: not diagnosed("trouble"))
        for _ in range(2):  # as a window that is closed does it
            process.send_signal(signal.SIGHUP)
        assert process.wait(timeout=60) == 0
    said = (tmp_path / "node.log").read_text()
    assert said.count("twist refused: the robot is disarmed; arm it first") == 1
    assert "order refused" not in said, "of the service's log, without which one and why"
    assert said.count("geometry_msgs/msg/TwistStamped, and geometry_msgs/msg/Twist is taken") == 1
    assert said.count("2 publishers") == 1
