"""The ROS 2 bridge against recorded message definitions (rosbags') and a real API process; no ROS is run here."""

import importlib.util
import math
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from hil.service.client import Live, find
from hil.service.messages import Action, Answer
from tests.processes import environment, wait_for
from tests.service_testbed import STATUS, ControlSide, own_state, served
from tools.ros2_bridge import Bridge, options
from tools.ros2_messages import Deviations, Names, Values, joint_states, odometry, transform, twist_arguments

STORE = get_typestore(Stores.ROS2_JAZZY)
ODOMETRY, TRANSFORMS, JOINTS = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState"
TWIST = "geometry_msgs/msg/Twist"
NUMBER = st.floats(-100.0, 100.0)
THREE = st.tuples(NUMBER, NUMBER, NUMBER)


def over_the_wire(kind: str, values: Mapping[str, Any]) -> Any:
    """Return the message of these values after CDR, by the definition alone: every field set, and none besides."""
    return STORE.deserialize_cdr(STORE.serialize_cdr(_message(kind, values), kind), kind)


def _message(kind: str, values: Mapping[str, Any]) -> Any:
    _, fields = STORE.fielddefs[kind]
    assert set(values) == {name for name, _ in fields}, f"{kind} has other fields"
    made = {}
    for name, (node, of) in fields:
        value = values[name]
        if node.name == "NAME":
            value = _message(of, value)
        elif node.name in ("ARRAY", "SEQUENCE"):
            (inner, inner_of), size = of
            assert node.name == "SEQUENCE" or len(value) == size
            if inner.name == "NAME":
                value = [_message(inner_of, one) for one in value]
            elif inner_of[0] != "string":
                value = np.array(value, dtype=inner_of[0])
        made[name] = value
    return STORE.types[kind](**made)


@given(THREE, THREE, st.floats(1.0e9, 2.0e9))
def test_odometry_and_transform_are_the_pose_and_the_twist_of_the_status(
    pose: tuple[float, float, float], twist: tuple[float, float, float], time_unix_s: float
) -> None:
    status = {"pose": pose, "twist": twist, "time_unix_s": time_unix_s}
    names, deviations = Names("map", "robot"), Deviations(0.1, 0.2, 0.3, 0.4)
    values = odometry(status, names, deviations)
    assert values is not None
    told = over_the_wire(ODOMETRY, values)
    assert told.header.stamp.sec + told.header.stamp.nanosec * 1e-9 == pytest.approx(time_unix_s, abs=1e-6)
    assert (told.header.frame_id, told.child_frame_id) == ("map", "robot")
    at, turned = told.pose.pose.position, told.pose.pose.orientation
    assert (at.x, at.y, at.z) == (*pose[:2], 0.0)
    # The columns of the quaternion's rotation matrix turn the body's twist into the world's.
    cosine, sine = 1.0 - 2.0 * turned.z**2, 2.0 * turned.w * turned.z
    assert (turned.x, turned.y) == (0.0, 0.0)
    assert (cosine, sine) == pytest.approx((math.cos(pose[2]), math.sin(pose[2])), abs=1e-12)
    body = told.twist.twist
    world = (cosine * body.linear.x - sine * body.linear.y, sine * body.linear.x + cosine * body.linear.y)
    assert (*world, body.angular.z) == pytest.approx(twist, abs=1e-9)
    assert list(told.pose.covariance[[0, 7, 35]]) == pytest.approx([0.01, 0.01, 0.04])
    assert list(told.twist.covariance[[0, 7, 35]]) == pytest.approx([0.09, 0.09, 0.16])

    values = transform(status, names)
    assert values is not None
    (one,) = over_the_wire(TRANSFORMS, values).transforms
    assert (one.header, one.child_frame_id, one.transform.rotation) == (told.header, "robot", turned)
    assert (one.transform.translation.x, one.transform.translation.y) == pose[:2]


def test_joint_states_are_the_speeds_of_the_wheels_by_name() -> None:
    values = joint_states({"speed_rad_s": (1.0, 2.0, 3.0, 4.0), "time_unix_s": 1.5}, Names(joints=("a", "b", "c", "d")))
    assert values is not None
    told = over_the_wire(JOINTS, values)
    assert (told.name, list(told.velocity)) == (["a", "b", "c", "d"], [1.0, 2.0, 3.0, 4.0])
    assert (len(told.position), len(told.effort)) == (0, 0)
    assert (told.header.stamp.sec, told.header.stamp.nanosec) == (1, 500_000_000)


def test_what_is_unknown_is_not_said() -> None:
    unknown = {"pose": None, "twist": None, "speed_rad_s": None, "time_unix_s": 0.0}
    assert odometry(unknown, Names(), Deviations()) is None
    assert transform(unknown, Names()) is None
    assert joint_states(unknown, Names()) is None


def twist(forward_m_s: float, left_m_s: float, yaw_rate_rad_s: float) -> Any:
    """A Twist as it comes from the wire, with parts that a robot in the plane cannot do."""
    linear, angular = {"x": forward_m_s, "y": left_m_s, "z": 9.0}, {"x": 9.0, "y": 9.0, "z": yaw_rate_rad_s}
    return over_the_wire(TWIST, {"linear": linear, "angular": angular})


@given(THREE)
def test_a_twist_is_taken_as_it_is_meant(three: tuple[float, float, float]) -> None:
    assert tuple(twist_arguments(twist(*three)).values()) == three


@pytest.fixture(scope="module")
def side(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ControlSide]:
    with own_state(tmp_path_factory.mktemp("state")), served() as one:
        yield one


def test_the_bridge_drives_and_publishes_through_a_real_service(side: ControlSide) -> None:
    published: dict[str, Values] = {}
    warnings: list[str] = []
    with find().live() as live:
        bridge = _bridge(live, published, warnings)
        bridge.drive(twist(0.3, -0.1, 0.5))
        bridge.drive(twist(math.nan, 0.0, 0.0))
        wait_for(lambda: bridge.receive(1.0) and len(published) == 3 and side.orders)
        assert [(order.action, order.arguments) for order in side.orders] == [
            (Action.TWIST, {"vx_m_s": 0.3, "vy_m_s": -0.1, "yaw_rate_rad_s": 0.5})
        ]
        assert warnings == ["vx_m_s = nan: expected a finite number; the robot stops when no other twist comes"]
        kinds = {"odom": ODOMETRY, "/tf": TRANSFORMS, "joint_states": JOINTS}
        told = {topic: over_the_wire(kinds[topic], values) for topic, values in published.items()}
        assert told["odom"].pose.pose.position.x == 1.0
        assert list(told["joint_states"].velocity) == [1.0, 2.0, 3.0, 4.0]

        side.answer = lambda order: Answer(order.number, "the robot is disarmed; arm it first")
        side.status = replace(STATUS, pose=None, twist=None)
        bridge.drive(twist(0.1, 0.0, 0.0))
        wait_for(lambda: bridge.receive(1.0) and "refused: the robot is disarmed; arm it first" in warnings)


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is not None, reason="ROS 2 is here")
def test_without_ros_it_says_what_is_missing() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "tools.ros2_bridge"], capture_output=True, text=True, env=environment()
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("ros2_bridge: ROS 2 is not there for this Python (No module named 'rclpy')")


def _bridge(live: Live, published: dict[str, Values], warnings: list[str]) -> Bridge:
    asked = options([])
    names = Names(asked.odom_frame, asked.base_frame, tuple(asked.joints))
    return Bridge(live, names, Deviations(*asked.deviations), published.__setitem__, warnings.append)
