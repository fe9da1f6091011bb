"""``hil teleop`` in a real terminal, against a real ``hil serve`` and its virtual robot: let go, and it stops."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

if sys.platform == "win32":
    pytest.skip("teleop needs a terminal as POSIX has it", allow_module_level=True)

from hil.addons.service.client import Client, find
from hil.addons.service.messages import Action
from tests.support.processes import HIL, environment, own_state, wait_for
from tests.support.terminal_window import Window

pytestmark = pytest.mark.alone

TIMEOUT_S = 0.5  # an API that waits for a processor for 0.1 s longer refuses the twist of a key


class Robot:
    """A served robot: its service's client, the orders to it, and the oldest twist that ever drove it."""

    def __init__(self, client: Client, log: Path, pid: int) -> None:
        self._client = client
        self._log = log
        self._pid = pid
        self.oldest_twist_s = 0.0
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def speed_m_s(self) -> float:
        x, y, _ = self._client.status()["twist"]
        return float((x * x + y * y) ** 0.5)

    def arm(self) -> None:
        if self._client.status()["phase"] in ("fault", "estop"):
            self._client.order(Action.CLEAR)
            wait_for(lambda: self._client.status()["phase"] == "disarmed")
        if self._client.status()["phase"] == "disarmed":
            self._client.order(Action.ARM)
        self.rests()

    def drives(self, speed_m_s: float = 0.02) -> None:
        wait_for(lambda: self.speed_m_s > speed_m_s)

    def rests(self) -> None:
        """Wait until it is armed, held and at rest: whatever drove it has ended."""
        wait_for(lambda: (self._client.status()["phase"], self._client.status()["task"]) == ("active", "hold"))
        wait_for(lambda: self.speed_m_s < 0.01)

    def phase(self, phase: str) -> None:
        wait_for(lambda: self._client.status()["phase"] == phase)

    def ordered(self, action: Action) -> int:
        """How often this was ordered so far."""
        return self._log.read_text().count(f'"action": "{action.value}"')

    def lose_its_api(self) -> None:
        """Kill the service's API process; its control process starts another one."""
        shown = subprocess.run(
            ["pgrep", "-P", str(self._pid), "-f", "hil.addons.service.api_process"],
            capture_output=True,
            text=True,
            check=True,
        )
        os.kill(int(shown.stdout), signal.SIGKILL)

    def _watch(self) -> None:
        with contextlib.suppress(Exception):
            for status in self._client.watch():
                self.oldest_twist_s = max(self.oldest_twist_s, status["twist_age_s"] or 0.0)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("state")
    log = folder / "log"
    keys = ("service.port=0", "loop.rate_hz=200", f"service.twist_timeout_s={TIMEOUT_S}")
    sets = [part for key in keys for part in ("--set", key)]
    with own_state(folder), log.open("w") as stderr:
        command = [*HIL, "serve", "circle_speed", "--log", "json", *sets]
        process = subprocess.Popen(command, stderr=stderr, env=environment())
        try:
            wait_for(lambda: '"phase": "disarmed"' in log.read_text())
            yield Robot(find(), log, process.pid)
        finally:
            process.terminate()
            process.wait(timeout=30)


@pytest.fixture
def robot(service: Robot) -> Robot:
    service.arm()
    return service


@contextlib.contextmanager
def teleop(command: Sequence[str] = (*HIL, "teleop")) -> Iterator[Window]:
    """``hil teleop`` in a window, when it shows that the robot is active."""
    window = Window(command)
    try:
        window.says("active, hold")
        yield window
    finally:
        window.close()
        window.process.kill()
        window.process.wait()


def test_keys_that_repeat_drive_and_the_last_repeat_stops(robot: Robot) -> None:
    stops = robot.ordered(Action.STOP)
    with teleop() as window:
        with window.repeating("i"):
            robot.drives(0.15)  # which is more than the share of a first press
        robot.rests()
        wait_for(lambda: robot.ordered(Action.STOP) == stops + 1)
        window.type("\x03")
        assert window.process.wait(timeout=30) == 130
        window.says("hil: interrupted; the robot was told to stop")
        assert window.modes == window.before
        assert window.shown.count(b"\x1b[?1049h") == window.shown.count(b"\x1b[?1049l")


def test_a_closed_window_stops(robot: Robot) -> None:
    stops = robot.ordered(Action.STOP)
    with teleop() as window, window.repeating("i"):
        robot.drives()
        window.close()
        assert window.process.wait(timeout=30) == 3
    assert robot.ordered(Action.STOP) == stops + 1
    robot.rests()


def test_a_termination_stops_and_the_terminal_is_put_back(robot: Robot) -> None:
    stops = robot.ordered(Action.STOP)
    with teleop() as window, window.repeating("i"):
        robot.drives()
        window.process.terminate()
        assert window.process.wait(timeout=30) == 130
        assert window.modes == window.before
    assert robot.ordered(Action.STOP) == stops + 1
    robot.rests()


def test_a_stalled_or_killed_process_sends_nothing_and_the_twist_times_out(robot: Robot) -> None:
    stops = robot.ordered(Action.STOP)
    with teleop() as window:
        with window.repeating("i"):
            robot.drives()
            window.process.send_signal(signal.SIGSTOP)
            robot.rests()
        window.type("j")  # typed while nobody looks
        window.process.send_signal(signal.SIGCONT)
        window.says("continued; press again")
        robot.rests()
        assert robot.ordered(Action.STOP) <= stops + 1, "the key was not driven by"
        stops = robot.ordered(Action.STOP)
        with window.repeating("i"):
            robot.drives()
            window.process.kill()
            window.process.wait()
            robot.rests()
    assert robot.ordered(Action.STOP) == stops
    tick_s = 1.0 / 200.0
    assert robot.oldest_twist_s <= TIMEOUT_S + 2.0 * tick_s


def test_a_button_that_is_let_go_and_a_gamepad_that_is_unplugged_stop(robot: Robot, tmp_path: Path) -> None:
    pytest.importorskip("sdl2", reason="needs the extra 'teleop': pip install 'mecanum-hil[teleop]'")
    fifo = tmp_path / "pad"
    os.mkfifo(fifo)
    command = [sys.executable, "-m", "tests.support.teleop_with_pad", str(fifo)]
    with teleop(command) as window, fifo.open("w", buffering=1) as pad:
        window.says("none; plug one in")
        print("plug", file=pad)
        window.says("Virtual Controller: hold the left shoulder")
        print("press", "forward", sep="\n", file=pad)
        robot.drives(0.2)
        print("let_go", file=pad)
        robot.rests()
        print("press", file=pad)
        robot.drives(0.2)
        stops = robot.ordered(Action.STOP)
        print("unplug", file=pad)
        robot.rests()
        assert robot.ordered(Action.STOP) == stops + 1
        window.type("q")
        assert window.process.wait(timeout=30) == 0


def test_ctrl_z_stops_the_robot_and_the_shell_has_its_terminal(robot: Robot) -> None:
    shell = Window(["bash", "--norc", "-i"])
    try:
        shell.type(f"{' '.join(HIL)} teleop; echo code $?\n")
        shell.says("active, hold")
        with shell.repeating("i"):
            robot.drives()
            shell.type("\x1a")
            shell.says("Stopped")
        robot.rests()
        shell.type("\x15stty -a | tr ' ' '\\n' | grep -x -e -icanon -e icanon -e -echo -e echo | tr '\\n' '/'\n")
        shell.says("icanon/echo/")
        shell.type("fg\n")
        shell.says("continued; press again")
        shell.type("q")
        shell.says("the robot was told to stop; it is active")
    finally:
        shell.close()
        shell.process.kill()
        shell.process.wait()


def test_arming_takes_two_keys_and_an_emergency_stop_one(robot: Robot) -> None:
    with teleop() as window:
        window.type("e")
        robot.phase("estop")
        window.type("c")
        robot.phase("disarmed")
        window.type("aii\r")
        window.says("refused: the robot is disarmed; arm it first")
        robot.phase("disarmed")
        window.type("a\r")
        robot.phase("active")


def test_a_lost_service_ends_it_and_the_terminal_is_put_back(robot: Robot) -> None:
    with teleop() as window:
        robot.lose_its_api()
        assert window.process.wait(timeout=30) == 3
        assert window.modes == window.before
