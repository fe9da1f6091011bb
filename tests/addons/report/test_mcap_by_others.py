"""MCAP recordings, read by the ROS 2 decoder of MCAP's own authors and by rosbags."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.addons.report.urdf import WHEEL_JOINTS
from hil.core.types import WHEEL_NAMES
from hil.record.mcap_file import LOG_LEVELS, log_fields, log_message
from hil.record.reader import read

ros2 = pytest.importorskip("mcap_ros2.reader", reason="pip install mcap-ros2-support")

_ROSBAGS = "pip install rosbags"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot that drives where its estimate does not say: its odometry believes in a larger wheel."""
    file = tmp_path_factory.mktemp("mcap") / "run.mcap"
    wrong = {"loop.duration_s": 1.0, "expect": [], "estimator.source": "odometry", "plant.start.wheel_radius_m": 0.07}
    hil.run("circle_speed", set=wrong, record=file)
    return file


def test_every_value_of_a_row_is_what_a_reader_of_ros_2_messages_finds(recording: Path) -> None:
    signals = read(recording).signals
    rows = [message.ros_msg for message in ros2.read_ros2_messages(recording, topics=["/hil"])]
    assert len(rows) == len(signals["loop.t_s"]) > 0
    for name, series in signals.items():
        found = []
        for row in rows:
            value = row
            for part in name.split("."):
                value = getattr(value, part)
            found.append(value)
        assert np.array_equal(found, series, equal_nan=True), name


def test_the_robot_in_a_file_moves_as_its_rows_say(recording: Path) -> None:
    run = read(recording)
    (robot,) = ros2.read_ros2_messages(recording, topics=["/robot_description"])
    joints = {joint.attrib["name"]: joint for joint in ElementTree.fromstring(robot.ros_msg.data).iter("joint")}
    row_at = {round(t_s * 1e3): row for row, t_s in enumerate(run.signals["loop.t_s"].tolist())}
    first_ns, truths, estimates = None, 0, 0
    turned = np.zeros(4)
    last = np.zeros(4)
    for message in ros2.read_ros2_messages(recording, topics=["/tf"]):
        stamp = message.ros_msg.transforms[0].header.stamp
        first_ns = message.log_time_ns if first_ns is None else first_ns
        assert stamp.sec * 10**9 + stamp.nanosec == message.log_time_ns
        row = row_at[round((message.log_time_ns - first_ns) / 1e6) + round(run.signals["loop.t_s"][0] * 1e3)]
        frames = {transform.child_frame_id: transform for transform in message.ros_msg.transforms}
        child, group = ("ground_truth", "truth") if "ground_truth" in frames else ("base_link", "pose")
        stands = frames[child]
        x, y, z, w = (getattr(stands.transform.rotation, axis) for axis in "xyzw")
        assert stands.header.frame_id == "odom"
        assert [stands.transform.translation.x, stands.transform.translation.y] == [
            run.signals[f"{group}.x_m"][row],
            run.signals[f"{group}.y_m"][row],
        ]
        assert (x, y) == (0.0, 0.0)
        heading = run.signals[f"{group}.heading_rad"][row]
        assert np.exp(2j * np.arctan2(z, w)) == pytest.approx(np.exp(1j * heading))
        if group == "truth":
            truths += 1
            continue
        estimates += 1
        for i, name in enumerate(WHEEL_JOINTS):
            joint = joints[name]
            link, parent, origin = (joint.find(tag) for tag in ("child", "parent", "origin"))
            assert link is not None
            assert parent is not None
            assert origin is not None
            wheel = frames[link.attrib["link"]]
            assert wheel.header.frame_id == parent.attrib["link"]
            place = wheel.transform.translation
            assert [place.x, place.y, place.z] == [float(word) for word in origin.attrib["xyz"].split()]
            angle = 2 * np.arctan2(wheel.transform.rotation.y, wheel.transform.rotation.w)
            turned[i] += np.remainder(angle - last[i] + np.pi, 2 * np.pi) - np.pi
            last[i] = angle
    assert truths == estimates == 50
    for i, name in enumerate(WHEEL_NAMES):
        speed = run.signals[f"wheel.{name}.speed_rad_s"][: row + 1]
        assert turned[i] == pytest.approx(np.nansum(speed) * 0.005, abs=0.01)
        assert abs(turned[i]) > 0.1
    # The same robot twice would prove nothing.
    assert abs(run.signals["pose.x_m"][-1] - run.signals["truth.x_m"][-1]) > 0.001


def test_definitions_are_those_of_ros_2(recording: Path) -> None:
    rosbags = pytest.importorskip("rosbags.typesys", reason=_ROSBAGS)
    from mcap.reader import make_reader

    ours = rosbags.get_types_from_msg
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    with recording.open("rb") as file:
        schemas = [schema for schema in make_reader(file).get_summary().schemas.values() if "hil/" not in schema.name]
    assert {schema.name for schema in schemas} == {
        "rcl_interfaces/msg/Log",
        "std_msgs/msg/String",
        "tf2_msgs/msg/TFMessage",
    }
    for schema in schemas:
        text = re.sub(r"(?m)^MSG: (\w+)/", r"MSG: \1/msg/", schema.data.decode())
        for name, (_, fields) in ours(text, schema.name).items():
            assert fields == store.fielddefs[name][1], name


def test_rosbags_reads_the_rows_and_the_events_that_we_read(recording: Path) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason=_ROSBAGS)
    run = read(recording)
    poses, events = [], []
    with highlevel.AnyReader([recording]) as bag:
        for connection, stamp_ns, data in bag.messages():
            message = bag.deserialize(data, connection.msgtype)
            if connection.topic == "/hil":
                poses.append((message.pose.x_m, message.pose.y_m, message.pose.heading_rad))
            elif connection.topic == "/events":
                assert message.stamp.sec * 10**9 + message.stamp.nanosec == stamp_ns
                events.append((message.level, message.msg))
    ours = np.stack([run.signals[f"pose.{name}"] for name in ("x_m", "y_m", "heading_rad")], axis=-1)
    assert np.array_equal(poses, ours, equal_nan=True)
    levels = {"DEBUG": "debug", "INFO": "info", "WARN": "warning", "ERROR": "error"}
    assert events == [(LOG_LEVELS[levels[event.level]], event.text) for event in run.events]
    assert events


def test_levels_have_the_numbers_of_ros_2() -> None:
    """Those of ``rcl_interfaces/msg/Log``."""
    assert LOG_LEVELS == {"debug": 10, "info": 20, "warning": 30, "error": 40}


@given(st.integers(0, 2**31 * 10**9 - 1), st.sampled_from(list(LOG_LEVELS.values())), st.text(), st.text())
def test_an_event_of_any_text_is_a_log_of_ros_2(stamp_ns: int, level: int, name: str, text: str) -> None:
    rosbags = pytest.importorskip("rosbags.typesys", reason=_ROSBAGS)
    data = log_message(stamp_ns, level, name, text)
    log = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY).deserialize_cdr(data, "rcl_interfaces/msg/Log")
    assert (log.stamp.sec * 10**9 + log.stamp.nanosec, log.level, log.name, log.msg) == (stamp_ns, level, name, text)
    assert log_fields(data) == (level, text)


def test_events_of_a_recording_that_has_them_as_json_are_read() -> None:
    run = read(Path(__file__).parents[2] / "recordings" / "circle_speed_1edb5dc.mcap")
    assert [(event.t_s, event.level, event.text[:11]) for event in run.events] == [
        (0.0, "INFO", "robot: firm"),
        (0.0, "INFO", "link: memor"),
    ]
    assert not run.is_damaged
