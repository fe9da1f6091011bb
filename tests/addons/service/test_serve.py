"""hil serve as users run it: real processes and a pseudo-terminal; the true pose is read past the service."""

import contextlib
import json
import math
import os
import queue
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.addons.service.client import Client
from hil.addons.service.discovery import running
from hil.addons.service.messages import Action
from hil.core.errors import DeviceError, LinkError
from hil.core.tokens import token_file
from hil.record.reader import RecordedRun, read
from hil.robot.truth_client import TruthClient
from hil.scenario import load
from tests.support.processes import HIL, READY_S, Device, device, environment, hil, is_running, wait_for

pytestmark = [pytest.mark.alone, pytest.mark.usefixtures("state_home")]
OVERRIDES = ("--set", "loop.rate_hz=100")
TWIST = {"vx_m_s": 0.3, "vy_m_s": 0.0, "yaw_rate_rad_s": 0.0}


class Serving:
    """A ``hil serve`` process; ``lines`` are those of its log, as they come."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.folder = folder
        self.process = subprocess.Popen(
            [*HIL, "serve", "circle_speed", *OVERRIDES, "--set", "service.port=0", "--log", "json", *arguments],
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            env=environment() | {"PYTHONFAULTHANDLER": "1"},
        )
        self._come: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.lines: list[dict[str, Any]] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        listens = self.line("API listens")
        self.api_pid = int(listens["pid"])
        port = int(listens["url"].rpartition(":")[2])
        self.client = Client(listens["url"], token_file("services", port))

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self._come.put(json.loads(line) if line.startswith("{") else {"event": line})

    def line(self, event: str, **fields: str) -> dict[str, Any]:
        """Wait for a line of the log that was not there before, whose fields begin as given."""
        while True:
            self.lines.append(line := self._come.get(timeout=READY_S))
            if line["event"] == event and all(str(line.get(name)).startswith(text) for name, text in fields.items()):
                return line

    def status(self) -> dict[str, Any]:
        with contextlib.suppress(LinkError):  # while the API starts again
            return self.client.status()
        return {"phase": None, "task": None}

    def takes(self, action: Action) -> bool:
        """Give an order; return whether it was taken."""
        with contextlib.suppress(LinkError):
            self.client.order(action)
            return True
        return False

    def until(self, **wanted: Any) -> dict[str, Any]:
        """Wait until the status is as wanted."""
        status: dict[str, Any] = wait_for(
            lambda: status if (status := self.status()).items() >= wanted.items() else None
        )
        return status

    def exit_code(self) -> int:
        """Wait for its end. If it does not end, report its log since then, and where its threads are."""
        try:
            return self.process.wait(READY_S)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)  # faulthandler writes where the threads are
            self._reader.join(READY_S)
            lines = [str(self._come.get()) for _ in range(self._come.qsize())]
            pytest.fail("\n".join(["the service does not end:", *lines]))

    def drive(self) -> None:
        """Arm, and follow the circle."""
        self.until(phase="disarmed")
        self.client.order(Action.ARM)
        self.until(phase="active")
        self.client.order(Action.TRACK, {"here": True})
        wait_for(lambda: max(map(abs, self.status().get("speed_rad_s") or [0.0])) > 2.0)


@contextlib.contextmanager
def serving(folder: Path, *arguments: str) -> Iterator[Serving]:
    one = Serving(folder, *arguments)
    try:
        yield one
    finally:
        one.process.kill()
        one.process.wait()


@contextlib.contextmanager
def served_device(folder: Path) -> Iterator[tuple[Device, Serving]]:
    """Yield a robot in a process of its own, and a service of it over a pseudo-terminal."""
    port = folder / "robot"
    with (
        device("circle_speed", *OVERRIDES, "--mode", "realtime", "--link", f"serial:pty?symlink={port}") as robot,
        serving(folder, "--link", f"serial:{port}", "--truth", robot.truth) as service,
    ):
        yield robot, service


@contextlib.contextmanager
def truth_of(robot: Device) -> Iterator[TruthClient]:
    scenario = load("circle_speed", set=[OVERRIDES[1]])
    truth = TruthClient(robot.truth, scenario.hash, reset=False)
    try:
        yield truth
    finally:
        truth.close()


def is_at_rest(truth: TruthClient) -> bool:
    fix = truth.poll()
    return fix is not None and max(map(abs, fix.twist)) < 0.002


def test_sigterm_ramps_down_disarms_closes_the_recording_and_exits_0(tmp_path: Path) -> None:
    with serving(tmp_path, "--record", "run.mcap") as service:
        service.drive()
        service.process.send_signal(signal.SIGTERM)
        assert service.exit_code() == 0
        service.line("phase", phase="disarmed")
        assert service.line("recording finished")["lost"] == 0
        assert not is_running(service.api_pid)
    run = read(tmp_path / "runs/run.mcap")
    assert max(abs(run.signals[f"wheel.{wheel}.speed_rad_s"][-1]) for wheel in ("fl", "fr", "rr", "rl")) < 0.5
    assert any("the robot is stopping" in event.text for event in run.events)
    [audit] = (tmp_path / "state/mecanum-hil/audit").iterdir()
    orders = [json.loads(line) for line in audit.read_text().splitlines()]
    assert [(one["action"], one["token"]) for one in orders if one["outcome"] == "accepted"] == [
        ("arm", "owner"), ("track", "owner"),
    ]  # fmt: skip


def test_a_killed_services_recording_is_still_there_after_its_next_start(tmp_path: Path) -> None:
    recorded = []
    for _ in range(2):
        with serving(tmp_path, "--record", "n.mcap") as service:
            recorded.append(service.until(phase="disarmed")["recording"])
            service.process.kill()
            service.process.wait()
        shutil.rmtree(tmp_path / "state")  # with the token of the killed one
    assert recorded == ["runs/n.mcap", "runs/n_2.mcap"]
    assert any((line.get("asked"), line.get("path")) == ("runs/n.mcap", "runs/n_2.mcap") for line in service.lines)
    first, second = (wait_for(lambda name=name: has_rows(tmp_path / name)) for name in recorded)  # type: ignore[misc]
    assert first.properties["started"] < second.properties["started"]


def has_rows(path: Path) -> RecordedRun | None:
    """Return the rows so far of a recorder whose service was killed; None while it has no row."""
    run = read(path)
    return run if len(run.signals["loop.t_s"]) else None


def test_when_the_control_process_is_killed_the_firmware_stops_the_wheels(tmp_path: Path) -> None:
    with served_device(tmp_path) as (robot, service), truth_of(robot) as truth:
        service.drive()
        wait_for(lambda: not is_at_rest(truth))
        service.process.kill()
        wait_for(lambda: is_at_rest(truth))
        wait_for(lambda: not is_running(service.api_pid))
        # Nothing is left that keeps the next one away.
        with serving(tmp_path / "..", "--link", f"serial:{tmp_path / 'robot'}", "--truth", robot.truth) as next_one:
            next_one.until(phase="disarmed")


def test_the_token_of_a_killed_service_goes_with_the_next_start_and_that_of_a_living_one_stays(tmp_path: Path) -> None:
    with serving(tmp_path) as killed, serving(tmp_path) as living:
        tokens = Path(token_file("services", 0)).parent
        assert len(list(tokens.glob("*.token"))) == 2
        wait_for(lambda: len(running()) == 2)
        (its,) = (one for one in running() if one.pid == living.process.pid)
        killed.process.kill()
        killed.process.wait()
        wait_for(lambda: not is_running(killed.api_pid))
        with serving(tmp_path):
            wait_for(lambda: len(running()) == 2)
            left = {path.name for path in tokens.glob("*.token")}
            names = {Path(one.token_file).name for one in running()}
            assert left == names
            assert len(left) == 2
            assert Path(its.token_file).name in names
        living.until(phase="disarmed")


def test_when_the_api_process_is_killed_or_hangs_the_robot_ramps_down_and_the_api_comes_back(tmp_path: Path) -> None:
    with serving(tmp_path) as service:
        service.drive()
        os.kill(service.api_pid, signal.SIGKILL)
        service.line("phase", why="the API process ended or hangs")
        service.api_pid = int(service.line("API listens")["pid"])
        assert "the API process ended or hangs" in service.until(phase="disarmed")["why"]
        service.drive()
        os.kill(service.api_pid, signal.SIGSTOP)
        service.line("phase", why="the API process ended or hangs")
        service.line("phase", phase="disarmed")
        os.kill(service.api_pid, signal.SIGCONT)
        service.until(phase="disarmed")
        # At first it takes orders for ones that have waited.
        wait_for(lambda: service.takes(Action.ARM))
        service.until(phase="active")


def test_a_device_has_one_service_which_has_it_also_while_it_is_unplugged(tmp_path: Path) -> None:
    with served_device(tmp_path) as (robot, service):
        service.drive()
        link = ("--link", f"serial:{tmp_path / 'robot'}", "--set", "estimator.source=odometry")
        second = hil("serve", "circle_speed", *OVERRIDES, *link, "--set", "service.port=0")
        assert second.returncode == 3
        assert f"(process {service.process.pid}) has had the device since" in second.stderr
        run = hil("run", "circle_speed", *OVERRIDES, "--mode", "realtime", *link, "--record", "none")
        assert run.returncode == 3
        assert "hil ctl" in run.stderr
        robot.process.kill()
        robot.process.wait()
        lost = service.line("note", text=f"truth '{robot.truth}' was ", level="error")["text"]
        assert lost.endswith(
            "; a state estimate that uses it is unknown from now on: restart the service to have it again"
        )
        away = service.until(phase="away")
        assert away["pose"] is None
        with pytest.raises(DeviceError, match="refused: the robot is away"):
            service.client.order(Action.ARM)


def test_a_stalled_control_process_waits_disarmed_and_knows_where_the_robot_is(
    tmp_path: Path,
) -> None:
    port = tmp_path / "robot"
    with (
        device("circle_speed", *OVERRIDES, "--mode", "realtime", "--link", f"serial:pty?symlink={port}") as robot,
        serving(tmp_path, "--link", f"serial:{port}", "--set", "estimator.source=odometry") as service,
        truth_of(robot) as truth,
    ):
        service.drive()
        start = load("circle_speed").plant.start
        begin = (start["start_x_m"], start["start_y_m"])
        wait_for(lambda: math.dist(begin, truth.poll().pose[:2]) > 0.15)  # type: ignore[union-attr, arg-type]
        os.kill(service.process.pid, signal.SIGSTOP)
        service.until(phase=None)  # a second without any status
        assert is_at_rest(truth)
        os.kill(service.process.pid, signal.SIGCONT)
        pose = service.until(phase="disarmed")["pose"]
        assert math.dist(pose[:2], truth.poll().pose[:2]) < 0.05  # type: ignore[union-attr]
        assert not any("was reset" in str(line) for line in service.lines)


def test_a_robot_with_other_parameters_is_never_armed(tmp_path: Path) -> None:
    """Its pages of HELLO may come while the service waits for the next tick, or in the tick."""
    port = tmp_path / "robot"
    other = ("--set", "firmware.speed_kp_n_m_s_rad=0.31")
    with (
        device("circle_speed", *OVERRIDES, *other, "--mode", "realtime", "--link", f"serial:pty?symlink={port}"),
        serving(tmp_path, "--link", f"serial:{port}", "--set", "estimator.source=odometry") as service,
    ):
        wait_for(lambda: "the robot's firmware parameters" in str(service.status().get("why")))
        for _ in range(20):
            assert service.status()["phase"] == "away"
            with pytest.raises(DeviceError, match="refused: the robot is away"):
                service.client.order(Action.ARM)


def test_a_service_waits_for_a_robot_that_is_not_there_yet(tmp_path: Path) -> None:
    port = tmp_path / "robot"
    link = ("--link", f"serial:{port}", "--set", "estimator.source=odometry", "--allow-motion")
    with serving(tmp_path, *link) as service:
        assert str(port) in service.line("link cannot be opened")["why"]
        wait_for(lambda: str(port) in str(service.until(phase="away")["why"]))
        with pytest.raises(DeviceError, match="refused: the robot is away"):
            service.client.order(Action.ARM)
        with device("circle_speed", *OVERRIDES, "--mode", "realtime", "--link", f"serial:pty?symlink={port}"):
            service.line("robot not commissioned", why="nobody has commissioned this robot: a wheel")
            service.drive()
        service.process.send_signal(signal.SIGINT)
        assert service.exit_code() == 0


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a server is refused that takes nobody in")
def test_orders_are_answered_while_a_link_is_slow_to_open(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server:
        address = server.getsockname()
        # Nobody accepts this one, and who comes after it is not even answered.
        with socket.create_connection(address):
            link = f"serial:socket://127.0.0.1:{address[1]}"
            with serving(tmp_path, "--link", link, "--set", "estimator.source=odometry") as service:
                assert service.until(phase="away")["why"] == "its link is being opened"
                service.client.order(Action.ESTOP)
                service.process.send_signal(signal.SIGTERM)
                assert service.exit_code() == 0
    assert not any("cannot be opened" in str(line) for line in service.lines)


def test_a_link_that_is_lost_as_soon_as_it_is_open_is_opened_again(tmp_path: Path) -> None:
    dropped: list[object] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def drop_all() -> None:
            with contextlib.suppress(OSError):  # the test is over
                while True:
                    server.accept()[0].close()
                    dropped.append(None)

        threading.Thread(target=drop_all, daemon=True).start()
        link = f"serial:socket://127.0.0.1:{server.getsockname()[1]}"
        with serving(tmp_path, "--link", link, "--set", "estimator.source=odometry") as service:
            wait_for(lambda: len(dropped) > 2)
            assert service.until(phase="away")["why"]
            service.process.send_signal(signal.SIGTERM)
            assert service.exit_code() == 0
        server.shutdown(socket.SHUT_RDWR)


def test_twists_that_end_stop_the_robot_and_an_estop_latches(tmp_path: Path) -> None:
    # An API that waits for a processor for 0.1 s longer refuses a twist.
    with serving(tmp_path, "--set", "service.twist_timeout_s=0.9") as service:
        service.until(phase="disarmed")
        service.client.order(Action.ARM)
        service.until(phase="active")
        service.client.twist(TWIST, 0.5)
        service.client.order(Action.TWIST, TWIST)
        service.until(task="hold")  # nobody repeats it
        service.client.order(Action.ESTOP)
        service.until(phase="estop")
        service.client.order(Action.CLEAR)
        service.until(phase="disarmed")


def test_gains_change_and_recordings_come_and_go(tmp_path: Path) -> None:
    with serving(tmp_path, "--record", "none") as service:
        service.drive()
        gains = service.client.order(Action.GAINS, {"gains": {"k1_1_s": 6.0}})
        assert gains["gains"]["k1_1_s"] == 6.0
        wait_for(lambda: service.status().get("gains", {}).get("k1_x_1_s") == 6.0)
        assert service.status()["task"] == "track"
        with pytest.raises(DeviceError, match=r"unknown key controller\.gains\.k3"):
            service.client.order(Action.GAINS, {"gains": {"k3": 6.0}})
        begun = service.client.order(Action.RECORD, {"name": "one.mcap"})
        path = begun["path"]
        with pytest.raises(DeviceError, match=r"one\.mcap is being written"):
            service.client.order(Action.RECORD)
        assert service.until(recording=path)["phase"] == "active"
        report = service.client.order(Action.STOP_RECORDING)
        assert report["complete"]
        assert (tmp_path / "runs/one.mcap").stat().st_mode & 0o007 == 0, "whatever the umask gives to other users"
        t_s = read(tmp_path / "runs/one.mcap").signals["loop.t_s"]
        assert len(t_s) == report["rows"] > 0
        assert t_s[0] == pytest.approx(begun["from_s"], abs=1e-6)
        assert begun["from_s"] > 0.0
        for _ in range(2):  # as a window that is closed does it
            service.process.send_signal(signal.SIGHUP)
        assert service.exit_code() == 0
        service.line("phase", phase="disarmed")


def test_lockstep_is_no_mode_for_a_service() -> None:
    done = hil("serve", "circle_speed", "--set", "loop.mode=lockstep")
    assert (done.returncode, "a service runs in real time" in done.stderr) == (2, True)
