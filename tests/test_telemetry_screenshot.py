"""The layout that a recording ships, as a real viewer draws it."""

import struct
from pathlib import Path

import pytest

from hil.telemetry import Recording
from tests.recorded_circle import circle_rows

DRIVERS = [Path("/usr/share/vulkan/icd.d"), Path("/etc/vulkan/icd.d")]

pytestmark = pytest.mark.skipif(
    not any(directory.is_dir() and any(directory.iterdir()) for directory in DRIVERS),
    reason="needs a Vulkan driver: apt-get install -y mesa-vulkan-drivers libvulkan1",
)


def test_every_view_of_a_recording_can_be_drawn(tmp_path: Path) -> None:
    from tools.screenshot import take_screenshot

    recording, picture = tmp_path / "run.rrd", tmp_path / "run.png"
    with Recording(recording, properties={"scenario_name": "made_up_circle"}, blocking=True) as recorder:
        recorder.event(0.0, "info", "ACTIVE")
        for row in circle_rows(1600):
            recorder.put(row)
        assert recorder.finish({"passed": True}).complete
    views = take_screenshot(recording, picture)
    shown = {view.name for view in views}
    for part in ("Trajectory", "Position error", "Wheel speed", "Wheel torque", "Gain K1", "Gain K2", "Robot state"):
        assert any(name.startswith(part) for name in shown), part
    header = picture.read_bytes()[:24]
    assert header.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", header[16:24])
    assert width >= 1000
    assert height >= 600
