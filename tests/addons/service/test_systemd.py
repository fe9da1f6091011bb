"""The messages of a service to systemd, over a real datagram socket, and its unit."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.addons.service import control_process
from hil.addons.service.control_process import _Ending
from hil.addons.service.systemd import Notifier, unit
from hil.core.errors import BadInputError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="systemd is Linux's")

WATCHDOG_US = 3_000_000
BEAT_NS = 1_000_000_000


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[socket.socket, dict[str, str]]]:
    """systemd's end of the socket, and the environment that it gives a service."""
    address = str(tmp_path / "notify") if request.param == "path" else f"@hil-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as end:
        end.bind("\0" + address[1:] if address[0] == "@" else address)
        environment = {"NOTIFY_SOCKET": address, "WATCHDOG_USEC": str(WATCHDOG_US), "WATCHDOG_PID": str(os.getpid())}
        yield end, environment


def heard(end: socket.socket) -> list[str]:
    told = []
    while True:
        try:
            told.append(end.recv(4096).decode())
        except BlockingIOError:
            return told


def test_the_manager_hears_of_the_whole_life(
    manager: tuple[socket.socket, dict[str, str]], recwarn: pytest.WarningsRecorder
) -> None:
    end, environment = manager
    notifier = Notifier(environment)
    notifier.ready()
    notifier.status("disarmed\non serial:/dev/ttyACM0")
    notifier.stopping()
    notifier.close()
    notifier.status("not any more")
    assert heard(end) == ["READY=1", "STATUS=disarmed on serial:/dev/ttyACM0", "STOPPING=1"]
    assert not recwarn.list, "Python warns of a socket that nobody closed"


def test_the_loop_beats_three_times_a_watchdog_period_however_often_it_turns(
    manager: tuple[socket.socket, dict[str, str]],
) -> None:
    end, environment = manager
    notifier = Notifier(environment)
    for now_ns in range(0, 10 * BEAT_NS, BEAT_NS // 1000):
        notifier.beat(now_ns)
        if now_ns % BEAT_NS == 0:
            assert heard(end) == ["WATCHDOG=1"]
    assert heard(end) == []


@pytest.mark.parametrize(
    "change", [{"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_PID": "1"}, {"NOTIFY_SOCKET": ""}]
)
def test_a_watchdog_of_another_process_gets_no_beat(
    manager: tuple[socket.socket, dict[str, str]], change: dict[str, str]
) -> None:
    end, environment = manager
    notifier = Notifier(environment | change)
    for now_ns in (0, 10**9, 10**18):
        notifier.beat(now_ns)
    assert heard(end) == []


def test_a_manager_that_does_not_read_is_not_waited_for_and_a_gone_one_is_no_error(
    manager: tuple[socket.socket, dict[str, str]],
) -> None:
    end, environment = manager
    notifier = Notifier(environment)
    sent = 0
    for now_ns in range(0, 2000 * BEAT_NS, BEAT_NS):
        notifier.beat(now_ns)
        sent += 1
    taken = heard(end)
    assert 0 < len(taken) < sent
    notifier.beat(now_ns + 1)
    assert heard(end) == ["WATCHDOG=1"], "the beat that was lost is tried again at once"
    end.close()
    notifier.beat(now_ns + 10**12)
    notifier.stopping()
    Notifier(environment).ready()


def test_without_systemd_nothing_is_sent() -> None:
    notifier = Notifier({})
    notifier.ready()
    notifier.beat(0)
    notifier.close()


def test_the_unit_names_this_program_and_the_configuration_and_systemd_takes_it(tmp_path: Path) -> None:
    folder = tmp_path / 'a robot 100% "mine" $HOME'
    folder.mkdir()
    config = folder / "my_robot.toml"
    config.touch()
    text = unit(str(config), ["--allow-motion", "--set", "link.url=serial:/dev/tty ACM0"])
    escaped = str(config).replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    assert f'serve "{escaped}" --log json --allow-motion --set "link.url=serial:/dev/tty ACM0"\n' in text
    assert not re.search("@[A-Z]+@", text)
    assert "Type=notify" in text
    assert "\nKillMode=process\n" in text, "any other kills a guardian before it has stopped its base"
    if shutil.which("systemd-analyze") is None:
        return
    path = tmp_path / "hil-serve.service"
    path.write_text(text)
    done = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True, check=False)
    complaints = [line for line in done.stderr.splitlines() if "hil-serve" in line]
    assert complaints == []


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here: install it to rate the unit")
def test_the_unit_exposes_less_than_4_of_10(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOGNAME", "robot")
    path = tmp_path / "hil-serve.service"
    path.write_text(unit("circle_speed", ["--allow-motion"]))
    command = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=40", path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Overall exposure level" in done.stdout


def test_the_unit_of_a_service_that_refuses_code_refuses_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--no-code" not in unit("circle_speed")
    monkeypatch.setenv("HIL_NO_CODE", "1")
    assert " --no-code serve circle_speed" in unit("circle_speed")


def test_a_line_break_in_a_unit_is_refused() -> None:
    with pytest.raises(BadInputError, match="a unit cannot hold a line break"):
        unit("a\nExecStartPre=b.toml")


def test_the_first_signal_ends_a_service_gently_and_a_second_one_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A window that is closed sends its signal twice."""
    handled: dict[int, Any] = {}
    monkeypatch.setattr("signal.signal", handled.__setitem__)
    hung_up: list[tuple[Any, ...]] = []
    monkeypatch.setattr(control_process, "on_signals", lambda *given: hung_up.append(given))
    ending = _Ending()
    assert handled == {signal.SIGTERM: ending, signal.SIGINT: ending}
    assert hung_up == [(ending, "SIGHUP")]
    counts = []
    for number in (signal.SIGHUP, signal.SIGHUP, signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        ending(number, None)
        counts.append(ending.requests)
    assert counts == [1, 1, 2, 2, 3]
