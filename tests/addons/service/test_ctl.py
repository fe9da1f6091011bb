"""``hil ctl`` against a real API process: its orders, its output, and its failures."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection
from websockets.sync.server import serve

from hil.addons.service.client import Client, find
from hil.addons.service.ctl_command import app
from hil.addons.service.discovery import announce, running
from hil.addons.service.messages import Action, Answer, Phase, Status
from hil.core.errors import BadInputError, LinkError
from tests.support.processes import HIL, environment, hil, is_running, own_state, wait_for
from tests.support.service_testbed import STATUS, ControlSide, served


@pytest.mark.parametrize(
    ("command", "action", "arguments"),
    [
        ("estop", Action.ESTOP, {}),
        ("stop-recording", Action.STOP_RECORDING, {}),
        (
            "track circle --set radius_m=0.5 --set name=east --here",
            Action.TRACK,
            {"reference": {"kind": "circle", "radius_m": 0.5, "name": "east"}, "here": True},
        ),
        ("go -1 .5 -90", Action.GO, {"x_m": -1.0, "y_m": 0.5, "heading_rad": pytest.approx(-1.5707963)}),
        ("gains kp=2.5 law=true", Action.GAINS, {"gains": {"kp": 2.5, "law": True}}),
        ("gains", Action.GAINS, {"gains": {}}),
        ("record a.mcap", Action.RECORD, {"name": "a.mcap"}),
        ("record", Action.RECORD, {"name": None}),
    ],
)
def test_a_command_is_an_order(side: ControlSide, command: str, action: Action, arguments: dict) -> None:
    side.answer = lambda order: Answer(order.number, result={"note": "begun"})
    done = CliRunner().invoke(app, command.split())
    assert (done.exit_code, done.stdout) == (0, "note: begun\n")
    assert [(order.action, order.arguments) for order in side.orders] == [(action, arguments)]


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("gains kp=inf", "'kp=inf': expected a finite number, true, false, a text or a list of them"),
        ("gains kp", "'kp': expected NAME=VALUE"),
        ("track --set radius_m=1", "--set is for a KIND of its own"),
        ("twist 9 0 0", "vx_m_s = 9.0: it should be less than or equal to 2"),
        ("twist 9 0 0 --for 1", "vx_m_s = 9.0: it should be less than or equal to 2"),
        ("record a.txt", "it should match pattern"),
        ("--url 127.0.0.1:1 --token-file none status", "service '127.0.0.1:1': expected http://127.0.0.1:PORT"),
        ("--url http://127.0.0.1:1 status", "service http://127.0.0.1:1: it is not one of yours; give the file"),
    ],
)
def test_bad_input_is_a_sentence(side: ControlSide, command: str, sentence: str) -> None:
    done = CliRunner().invoke(app, command.split())
    assert isinstance(done.exception, BadInputError)
    assert sentence in str(done.exception)
    assert side.orders == []


def test_bad_input_and_a_refusal_have_different_exit_codes(side: ControlSide) -> None:
    side.refuse("the robot is not armed; arm it first")
    done = hil("ctl", "twist", "0.1", "0", "0", "--for", "60")
    assert (done.returncode, done.stderr) == (3, "hil: refused: the robot is not armed; arm it first\n")
    done = hil("ctl", "go", "-1", "nan", "3")
    assert (done.returncode, done.stderr) == (2, "hil: y_m = nan: expected a finite number\n")


def test_a_twist_is_repeated_for_its_time_and_then_stopped(side: ControlSide) -> None:
    done = CliRunner().invoke(app, ["twist", "0.2", "-0.1", "0", "--for", "0.5"])
    assert (done.exit_code, done.stdout) == (0, "")
    *twists, last = side.orders
    assert last.action is Action.STOP
    assert {order.action for order in twists} == {Action.TWIST}
    assert 2 <= len(twists) <= 11, "20 a second at most"
    assert twists[0].arguments == {"vx_m_s": 0.2, "vy_m_s": -0.1, "yaw_rate_rad_s": 0.0}


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
def test_ctrl_c_stops_a_twist(side: ControlSide) -> None:
    command = [*HIL, "ctl", "twist", "0.2", "0", "0", "--for", "600"]
    driver = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment())
    wait_for(lambda: len(side.orders) > 2)
    driver.send_signal(signal.SIGINT)
    _, errors = driver.communicate(timeout=60)
    assert (driver.returncode, errors) == (130, "hil: interrupted; the robot was told to stop\n")
    assert side.actions[-1] is Action.STOP


def test_the_status_is_a_table_or_json(side: ControlSide) -> None:
    side.status = replace(
        STATUS,
        why="it was a long way",
        reference=(2.0, -3.25, -1.0),
        power_stage=True,
        health="degraded",
        gains={"kp": 3.0, "ki": 0.25},
        feedback_age_ms=1.256,
        round_trip_ms=2.344,
        frames={"sent": 10, "received": 9, "rejected": {"crc": 1, "cobs": 0, "range": 2}},
        recording="runs/a.mcap",
        recording_trouble="the disk is full",
        rows_dropped=3,
        rows_lost=4,
    )
    wait_for(lambda: side.request("GET", "/v1/status").json()["why"])
    shown = dict(re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in hil("ctl", "status").stdout.splitlines())
    assert shown == {
        "phase": "active, hold",
        "why": "it was a long way",
        "serves": "paper_circle, pid in speed mode",
        "link": "serial:/dev/ttyACM0",
        "robot": "firmware 1.2, with motors",
        "pose": "1.000 m, -0.500 m, 28.6°",
        "reference": "2.000 m, -3.250 m, -57.3°",
        "twist": "0.100 m/s, 0.000 m/s, -0.200 rad/s",
        "wheels": "1.00, 2.00, 3.00, 4.00 rad/s",
        "battery": "24.5 V",
        "estimator": "degraded",
        "gains": "kp 3, ki 0.25",
        "ticks": "1234, 2 late by a period or more",
        "lateness": "p50 51 µs, p99 90 µs",
        "feedback age": "1.26 ms",
        "round trip": "2.34 ms",
        "frames": "10 sent, 9 received, rejected: 1 crc, 2 range",
        "recoveries": "1",
        "recording": "runs/a.mcap, 3 rows dropped, 4 rows lost",
        "not recorded": "the disk is full",
        "memory": "locked",
    }
    status = json.loads(CliRunner().invoke(app, ["status", "--json"]).stdout)
    assert (status["phase"], status["battery_v"]) == ("active", 24.5)


def test_what_a_status_does_not_know_is_not_in_the_table(side: ControlSide) -> None:
    side.status = Status(scenario="paper_circle", law="pid", command="speed", link="memory:", robot="firmware 1.2")
    wait_for(lambda: side.request("GET", "/v1/status").json()["ticks"] == 0)
    shown = dict(re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in hil("ctl", "status").stdout.splitlines())
    assert shown == {
        "phase": "away",
        "serves": "paper_circle, pid in speed mode",
        "link": "memory:",
        "robot": "firmware 1.2",
        "ticks": "0, 0 late by a period or more",
        "frames": "0 sent, 0 received, rejected: none",
        "recoveries": "0",
    }


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_on_a_terminal_the_status_is_watched_until_ctrl_c(side: ControlSide) -> None:
    import pty

    ours, terminal = pty.openpty()
    watcher = subprocess.Popen(
        [*HIL, "ctl", "status", "--watch"], stdin=terminal, stdout=terminal, stderr=terminal, env=environment()
    )
    os.close(terminal)
    seen = bytearray()

    def shows(text: str) -> bool:
        seen.extend(os.read(ours, 65536))
        return text.encode() in seen

    wait_for(lambda: shows("active, hold"))
    side.status = replace(STATUS, phase=Phase.FAULT, task=None, why="encoder fl stands still")
    wait_for(lambda: shows("encoder fl stands still"))
    watcher.send_signal(signal.SIGINT)
    wait_for(lambda: shows("interrupted; the service goes on"))
    assert watcher.wait(timeout=60) == 130
    os.close(ours)


@pytest.mark.parametrize(
    ("platform", "why"),
    [
        ("win32", "teleop needs a terminal of Linux or macOS; on Windows, run it in WSL"),
        ("linux", "teleop needs a terminal for keys and screen; start it in one, without pipes"),
    ],
)
def test_teleop_is_refused_without_a_terminal(
    side: ControlSide, monkeypatch: pytest.MonkeyPatch, platform: str, why: str
) -> None:
    monkeypatch.setattr("hil.addons.service.ctl_command.sys", SimpleNamespace(platform=platform))
    done = hil("teleop", "--url", side.child.url)
    assert (done.returncode, done.stderr) == (2, f"hil: {why}\n")


def test_a_connection_that_breaks_is_told(tmp_path: Path) -> None:
    token = tmp_path / "token"
    token.write_text("a-token-of-enough-length")
    token.chmod(0o600)
    with serve(lambda live: live.socket.shutdown(socket.SHUT_RDWR), "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        url = f"http://127.0.0.1:{server.socket.getsockname()[1]}"
        with pytest.raises(LinkError) as lost:
            next(Client(url, token).watch())
    thread.join()
    assert str(lost.value) == f"service {url}: the connection was lost"


def read_on(live: ClientConnection) -> None:
    while True:
        live.recv(timeout=30.0)


def test_a_service_that_ends_informs_its_watchers_and_removes_its_files(tmp_path: Path) -> None:
    command = [*HIL, "ctl", "status", "--watch", "--json"]
    pipe = subprocess.PIPE
    with own_state(tmp_path), served() as side, side.live() as live:
        token, pid = side.child.token_file, side.child.pid
        watcher = subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=environment())
        assert watcher.stdout is not None
        assert [json.loads(watcher.stdout.readline())["ticks"] for _ in range(3)] == [1234] * 3
        side.close()
        _, errors = watcher.communicate(timeout=60)
        assert watcher.returncode == 3
        assert errors.endswith("the control process has ended\n")
        with pytest.raises(ConnectionClosed) as end:
            read_on(live)
    assert end.value.rcvd is not None
    assert (end.value.rcvd.code, end.value.rcvd.reason) == (1001, "the control process has ended")
    assert token is not None
    assert pid is not None
    assert not is_running(pid)
    assert {path.suffix for path in token.parent.iterdir()} == {".lock"}


def test_the_service_is_found_or_the_error_names_the_reason(tmp_path: Path, side: ControlSide) -> None:
    (mine,) = running()
    with own_state(tmp_path):
        with pytest.raises(LinkError, match="no service of yours runs on this machine"):
            find()
        find(mine.url, token_file=Path(mine.token_file)).order(Action.ARM)
        token = tmp_path / "token"
        token.write_text("another-token-of-enough-length")
        token.chmod(0o600)
        for ask in (Client.status, lambda client: next(client.watch())):
            with pytest.raises(BadInputError, match=f"does not accept the token in {token}"):
                ask(find(mine.url, token_file=token))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        claim = announce(replace(mine, url=f"http://127.0.0.1:{port}", title="other"))
        with pytest.raises(
            BadInputError, match=rf"2 services run: port {min(port, mine.port)} .*choose one with --port"
        ):
            find()
        find(port=mine.port).order(Action.ARM)
        find(mine.url.replace("127.0.0.1", "localhost") + "/").order(Action.ARM)
        with pytest.raises(LinkError, match="no service of yours runs at port 1: yours are port"):
            find(port=1)
    with pytest.raises(LinkError, match="it may be restarting"):
        find(port=port).status()
    claim.release()
    with pytest.raises(BadInputError) as refused:
        announce(mine)  # as one with a token file of its own does in another network namespace
    assert str(refused.value) == f"port {mine.port}: process {os.getpid()} serves there; choose another port"
    assert side.actions == [Action.ARM] * 3


def test_another_program_at_the_port_of_a_service_is_recognised(tmp_path: Path) -> None:
    web = ThreadingHTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler)
    server = threading.Thread(target=web.serve_forever)
    server.start()
    token = tmp_path / "token"
    token.write_text("a-token-of-enough-length")
    token.chmod(0o600)
    try:
        with pytest.raises(LinkError, match="it is another program"):
            Client(f"http://127.0.0.1:{web.server_port}", token).status()
    finally:
        web.shutdown()
        server.join()
        web.server_close()
