"""Motors of another maker as a process of their own on a real SocketCAN bus, in real time: remote frames too."""

import pytest

from tests.support.processes import device, run_json
from tests.support.socketcan_bus import cable

pytestmark = pytest.mark.socketcan

HOST, ROBOT = "hil_host", "hil_robot"
REAL_TIME = ("circle_speed", "--mode", "realtime", "--set", "loop.rate_hz=50", "--set", "device.driver=odrive")


def test_odrives_are_driven_over_a_cable() -> None:
    with (
        cable(HOST, ROBOT, is_fd=False),
        device(*REAL_TIME, "--link", f"can:socketcan/{ROBOT}") as robot,
    ):
        figures = run_json(
            *(*REAL_TIME, "--link", f"can:socketcan/{HOST}", "--truth", robot.truth, "--allow-motion"),
            # The guest's one processor may stall for longer than the host's patience with its robot.
            *("--set", "loop.duration_s=2", "--set", "loop.rearm=true", "--set", "expect=[]", "--record", "none"),
        )
    assert figures["failure"] is None
    assert figures["stopped"]
    assert figures["ticks"] > 50
