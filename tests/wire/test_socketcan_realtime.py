"""The controller and the virtual robot as two processes at the ends of a CAN cable, in real time at 200 Hz.

Time in the guest is this machine's, which may stall: then the watchdog stops the robot, rightly, and the case is
repeated. What is asserted are laws of robot time, and counts.
"""

import contextlib
import json
import math
import signal
import subprocess
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any
from unittest import mock

import pytest

from firmware_protocol.generated.messages import State
from firmware_protocol.host import parameter_hash
from hil.core.clock import WallClock
from hil.core.errors import DeviceError
from hil.core.types import CommandMode
from hil.robot.handshake import Expected
from hil.robot.stm32 import Stm32
from hil.robot.truth_client import TruthClient, TruthRecord
from hil.runtime.robots import firmware_values, wheel_map
from hil.scenario import load
from hil.wire.conditions import ConditionedLink
from hil.wire.url import parse_link
from tests.support.processes import HIL, Device, device, environment, hil, wait_for
from tests.support.socketcan_bus import DBC, Onlooker, cable, set_up

pytestmark = pytest.mark.socketcan

HOST, ROBOT = "hil_host", "hil_robot"
REAL_TIME = ("paper_circle", "--mode", "realtime", "--set", "loop.rate_hz=200", "--set", "expect=[]")
AT_HOST_URL = parse_link(f"can:socketcan/{HOST}")
FD = "?fd=1&data_bitrate=4000000"
AT_HOST = ("--link", f"can:socketcan/{HOST}", "--record", "none")
SCENARIO = load("paper_circle", set=["loop.rate_hz=200"])
TORQUE_COMMAND = DBC.get_message_by_name("TORQUE_COMMAND")
ATTEMPTS = 3
STALL_SIGNS = ("because of COMMAND_TIMEOUT", "no feedback for", "did not become ACTIVE: it is ARMED")
PERIOD_NS = 5_000_000
START_S = 120.0


class StalledError(Exception):
    """This machine gave a run no time for longer than the watchdog waits."""


def repeated(case: Callable[[], None]) -> None:
    """Try a case until this machine lets it come to its end."""
    for _ in range(ATTEMPTS - 1):
        try:
            return case()
        except StalledError as error:
            print(error)
    return case()


@pytest.fixture(scope="module")
def robot(request: pytest.FixtureRequest) -> Iterator[Device]:
    """A robot at its end of the cable, which stays up whatever happens to the host's; its parameter is FD, or none."""
    options = getattr(request, "param", "")
    with (
        cable(HOST, ROBOT, is_fd=bool(options)),
        device(*REAL_TIME, "--link", f"can:socketcan/{ROBOT}{options}") as ready,
    ):
        yield ready


class Drive:
    """``hil run`` at the host's end, seen driving, and all that the truth tells of the robot since."""

    def __init__(self, robot: Device) -> None:
        arguments = ["--truth", robot.truth, "--set", "loop.duration_s=600", "--json"]
        self._process = subprocess.Popen(
            [*HIL, "run", *REAL_TIME, *AT_HOST, *arguments],
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._watcher = TruthClient(robot.truth, SCENARIO.hash, reset=False)
        self.seen: list[TruthRecord] = []
        wait_for(lambda: self._watcher.poll() is not None, START_S)
        self.seen += self._watcher.taken
        wait_for(lambda: self._process.poll() is not None or self._is_driven(), START_S)
        if self._process.poll() is not None:
            raise StalledError(self.end())
        del self.seen[:-1]

    def go_on(self, robot_ms: int) -> None:
        """Follow the robot for so long of its time. Raises StalledError when it is not driven throughout."""
        end_ns = self.seen[-1].fix.time_ns + robot_ms * 1_000_000
        wait_for(lambda: self._process.poll() is not None or self._follow().fix.time_ns > end_ns)
        if self._process.poll() is not None or any(r.state is not State.ACTIVE for r in self.seen):
            raise StalledError("the watchdog stopped the robot")

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def end(self) -> tuple[int, str]:
        """Wait for the run's end; return its exit code and what it said to the user."""
        _, errors = self._process.communicate(timeout=60)
        assert "Traceback" not in errors
        return self._process.returncode, errors

    def check_watchdog(self) -> None:
        """Follow the robot to rest: never ACTIVE beyond the watchdog, no set point left beyond watchdog and ramp.

        That is robot time, by the firmware's own count since the last command.
        """
        wait_for(lambda: self._follow().state is State.IDLE)
        watchdog_ms, ramp_ms = SCENARIO.firmware.watchdog_s * 1e3, SCENARIO.firmware.ramp_s * 1e3
        assert {r.state for r in self.seen} == {State.ACTIVE, State.STOPPING, State.IDLE}
        assert all(r.command_age_ms < watchdog_ms for r in self.seen if r.state is State.ACTIVE)
        assert all(not any(r.set_point_rad_s) for r in self.seen if r.command_age_ms >= watchdog_ms + ramp_ms)
        assert any(any(r.set_point_rad_s) for r in self.seen if r.state is State.STOPPING)
        assert math.hypot(self.seen[-1].fix.twist.vx_m_s, self.seen[-1].fix.twist.vy_m_s) < 0.05

    def close(self) -> None:
        self._process.kill()
        self._process.communicate(timeout=60)
        self._watcher.close()

    def _follow(self) -> TruthRecord:
        self._watcher.poll()
        self.seen += self._watcher.taken
        return self.seen[-1]

    def _is_driven(self) -> bool:
        newest = self._follow()
        return newest.state is State.ACTIVE and any(newest.set_point_rad_s)


@contextlib.contextmanager
def driving(robot: Device) -> Iterator[Drive]:
    drive = Drive(robot)
    try:
        yield drive
    finally:
        drive.close()


def check_not_stalled(code: int, errors: str, but: str) -> None:
    """Raise StalledError when a run ended because nothing of it got any time, ``but`` for the sign that is awaited."""
    if code == 3 and any(sign in errors for sign in STALL_SIGNS if sign != but):
        raise StalledError(errors)


def two_seconds(robot: Device, options: str = "", *changes: str) -> dict[str, Any]:
    """Return the figures of a run of two seconds that passed; ``options`` are those of its link."""
    at_host = ("--link", f"can:socketcan/{HOST}{options}", "--record", "none", "--truth", robot.truth)
    done = hil("run", *REAL_TIME, *at_host, "--set", "loop.duration_s=2", *changes, "--json")
    check_not_stalled(done.returncode, done.stderr, but="")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def check_run(robot: Device, options: str, *, is_fd: bool) -> None:
    """Drive for two seconds, and find each command on the bus once."""
    with contextlib.closing(Onlooker(ROBOT)) as onlooker:
        figures = two_seconds(robot, options)
        frames = onlooker.take()
    assert figures["stopped"]
    assert {frame.is_fd for frame in frames} == {is_fd}
    hosts = [f for f in frames if DBC.get_message_by_frame_id(f.can_id).senders == ["HOST"]]
    commands = [f.payload for f in hosts if f.can_id == TORQUE_COMMAND.frame_id]
    assert len(commands) >= figures["ticks"] > 0
    sequence = [TORQUE_COMMAND.decode(payload)["sequence"] for payload in commands]
    assert all((new - old) % 256 == 1 for old, new in pairwise(sequence)), "no command is lost, repeated or late"


@pytest.mark.parametrize("robot", [FD], indirect=True, ids=["fd"])
def test_a_run_over_a_can_fd_cable_goes_to_its_end(robot: Device):
    repeated(lambda: check_run(robot, FD, is_fd=True))


def test_a_run_over_the_cable_goes_to_its_end(robot: Device):
    repeated(lambda: check_run(robot, "", is_fd=False))


def test_a_killed_controller_leaves_stopped_wheels(robot: Device):
    def case() -> None:
        with driving(robot) as drive:
            drive.signal(signal.SIGKILL)
            drive.check_watchdog()

    repeated(case)


def test_an_interface_that_goes_down_ends_the_run_and_up_again_serves_the_next(robot: Device):
    def case() -> None:
        with driving(robot) as drive:
            try:
                set_up(HOST, up=False)
                code, errors = drive.end()
                drive.check_watchdog()
            finally:
                set_up(HOST, up=True)
        check_not_stalled(code, errors, but="")
        assert code == 3
        assert f"channel '{HOST}' is down; bring it up: ip link set {HOST} up type can bitrate 1000000" in errors
        with driving(robot) as drive:
            drive.signal(signal.SIGTERM)
            code, errors = drive.end()
        check_not_stalled(code, errors, but="")
        assert code == 130

    repeated(case)


def test_commands_that_the_kernel_drops_stop_the_robot_and_the_run_says_so(robot: Device):
    """Every frame towards the robot is lost in a queue of the kernel; what the robot sends still arrives."""

    def case() -> None:
        with driving(robot) as drive, netem("loss", "100%"):
            code, errors = drive.end()
            drive.check_watchdog()
        check_not_stalled(code, errors, but="because of COMMAND_TIMEOUT")
        assert code == 3
        assert "because of COMMAND_TIMEOUT" in errors

    repeated(case)


def test_a_bus_that_delays_and_doubles_commands_is_driven_over(robot: Device):
    """The second of each command is refused as stale, and counted."""

    def case() -> None:
        with netem("delay", "5ms", "duplicate", "100%"):
            figures = two_seconds(robot, "", "--set", "allow.rejected=1000")
        assert figures["frames"]["rejected"]["robot_stale"] > 100

    repeated(case)


def test_a_second_controller_is_turned_away_and_the_first_drives_on(robot: Device):
    """The second one is here: the start of another process would take the first one's time.

    It stands for one of another machine on this bus, so it asks for no lock of this machine.
    """

    def case() -> None:
        with (
            driving(robot) as drive,
            mock.patch("hil.wire.can_bus.claim_file"),
            contextlib.closing(AT_HOST_URL.open_host()) as bus,
        ):
            clock = WallClock()
            link = ConditionedLink(bus, clock)
            expected = Expected(
                parameter_hash(firmware_values(SCENARIO)), lockstep=False, allow_motion=False, speed_limit_rad_s=20.0
            )
            second = Stm32(link, CommandMode.TORQUE, expected, iter((1, 2, 3)), wheel_map(SCENARIO.device))
            second.connect()
            refusal = "none"
            try:
                second.start(clock, PERIOD_NS)
            except DeviceError as error:
                refusal = str(error)
            finally:
                second.disarm()
            drive.go_on(robot_ms=100)  # a robot that its watchdog had stopped was free for the second one
            assert "it is ACTIVE; another controller drives it; stop that controller first" in refusal
            drive.signal(signal.SIGTERM)
            code, errors = drive.end()
        check_not_stalled(code, errors, but="")
        assert code == 130

    repeated(case)


@contextlib.contextmanager
def netem(*what: str) -> Iterator[None]:
    """Let the kernel's network emulator treat what the host's end sends."""
    subprocess.run(["tc", "qdisc", "add", "dev", HOST, "root", "netem", *what], check=True)
    try:
        yield
    finally:
        subprocess.run(["tc", "qdisc", "delete", "dev", HOST, "root"], check=True)
