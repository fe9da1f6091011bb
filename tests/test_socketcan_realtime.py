"""The controller and the virtual robot as two processes at the ends of a CAN cable, in real time at 200 Hz.

Time in the guest is this machine's, which may stall: then the watchdog stops the robot, rightly, and the run is
repeated. What is asserted are laws of robot time and counts.
"""

import json
import signal
import subprocess
from collections.abc import Callable, Iterator

import pytest

from firmware_protocol.generated.messages import State
from hil.devices.truth import TruthClient, TruthRecord
from hil.scenario import load
from tests.processes import HIL, Device, device, environment, hil, wait_for
from tests.socketcan_bus import DBC, Onlooker, cable, ip

pytestmark = pytest.mark.socketcan

HOST, ROBOT = "hil_host", "hil_robot"
REAL_TIME = ("paper_circle", "--mode", "realtime", "--set", "loop.rate_hz=200")
SCENARIO = load("paper_circle", mode="realtime", set=["loop.rate_hz=200"])
ENDLESS_S = 600
ATTEMPTS = 5


@pytest.fixture(scope="module")
def robot() -> Iterator[Device]:
    """A robot at its end of the cable; its end stays up whatever happens to the host's."""
    with cable(HOST, ROBOT), device(*REAL_TIME, "--link", f"can:socketcan/{ROBOT}") as ready:
        yield ready


class Controller:
    """``hil run`` at the host's end, which drives for as long as it is let, and the truth of the robot meanwhile."""

    def __init__(self, robot: Device, duration_s: float = ENDLESS_S) -> None:
        arguments = ["--link", f"can:socketcan/{HOST}", "--truth", robot.truth, "--record", "none", "--json"]
        limits = ["--set", f"loop.duration_s={duration_s}", "--set", "expect=[]"]
        self.process = subprocess.Popen(
            [*HIL, "run", *REAL_TIME, *limits, *arguments],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.records: list[TruthRecord] = []

    def end(self) -> tuple[int, dict, str]:
        """Wait for its end; return exit code, result and what it said to the user."""
        output, errors = self.process.communicate(timeout=120)
        assert "Traceback" not in errors
        return self.process.returncode, json.loads(output) if output else {}, errors


def stalled(errors: str) -> bool:
    """Tell whether a run ended because this machine gave it no time."""
    return "COMMAND_TIMEOUT" in errors or "no feedback for" in errors
