"""What is recorded as MCAP, read by the decoder of ROS 2 messages that MCAP's own authors ship."""

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import hil
from hil.core.types import WHEEL_NAMES
from hil.record.robot_model import WHEEL_JOINTS
from hil.review import read
from hil.review.export import write_export

ros2 = pytest.importorskip("mcap_ros2.reader", reason="pip install mcap-ros2-support")


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


@pytest.mark.parametrize("exported", [False, True])
def test_the_robot_in_a_file_moves_as_its_rows_say(recording: Path, exported: bool, tmp_path: Path) -> None:
    run = read(recording)
    if exported:
        recording = tmp_path / "copy.mcap"
        write_export(run, recording)
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
    rosbags = pytest.importorskip("rosbags.typesys", reason="pip install rosbags")
    from mcap.reader import make_reader

    ours = rosbags.get_types_from_msg
    store = rosbags.get_typestore(rosbags.Stores.ROS2_JAZZY)
    with recording.open("rb") as file:
        schemas = [schema for schema in make_reader(file).get_summary().schemas.values() if "/msg/" in schema.name]
    assert {schema.name for schema in schemas} == {"std_msgs/msg/String", "tf2_msgs/msg/TFMessage"}
    for schema in schemas:
        text = re.sub(r"(?m)^MSG: (\w+)/", r"MSG: \1/msg/", schema.data.decode())
        for name, (_, fields) in ours(text, schema.name).items():
            assert fields == store.fielddefs[name][1], name
