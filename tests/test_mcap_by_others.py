"""What is recorded as MCAP, read by the decoder of ROS 2 messages that MCAP's own authors ship."""

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.review import read

ros2 = pytest.importorskip("mcap_ros2.reader", reason="pip install mcap-ros2-support")


def test_every_value_of_a_row_is_what_a_reader_of_ros_2_messages_finds(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    hil.run("circle_speed", set={"loop.duration_s": 0.2, "expect": []}, record=file)
    signals = read(file).signals
    rows = [message.ros_msg for message in ros2.read_ros2_messages(file, topics=["/hil"])]
    assert len(rows) == len(signals["loop.t_s"]) > 0
    for name, series in signals.items():
        found = []
        for row in rows:
            value = row
            for part in name.split("."):
                value = getattr(value, part)
            found.append(value)
        assert np.array_equal(found, series, equal_nan=True), name
