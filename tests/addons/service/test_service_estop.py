"""The port for emergency stops: it works whatever the API and other clients do, and takes nothing else."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hil.addons.service.client import find
from hil.addons.service.messages import HOST, Action
from tests.support.processes import ROOT, hil, own_state, wait_for
from tests.support.service_testbed import ControlSide, served
from tools.bench.estop import FLOODS, Target

SECONDS = 5.0
"""Limit for a busy machine; tools.bench.estop measures."""
READS = "reads-0123456789abcdef"


def answer(side: ControlSide, text: bytes) -> bytes:
    """Send bytes to the port; return what comes until it closes the connection."""
    with socket.create_connection(("127.0.0.1", port(side)), 30.0) as one, contextlib.suppress(ConnectionResetError):
        one.sendall(text)
        one.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: one.recv(4096), b""))
    return b""


def port(side: ControlSide) -> int:
    found = urlsplit(side.child.estop_url).port
    assert found is not None
    return found


def estop_pid(side: ControlSide) -> int:
    assert side.child.estop is not None
    return side.child.estop.pid or 0


def request(side: ControlSide, **changed: str) -> bytes:
    words = {
        "first": "POST /v1/estop HTTP/1.1",
        "host": f"Host: 127.0.0.1:{port(side)}",
        "token": f"authorization: {side.headers['Authorization']}",
        "end": "\r\n",
    } | changed
    return "\r\n".join(words.values()).encode()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
def test_an_estop_is_done_while_the_api_hangs(tmp_path: Path) -> None:
    with own_state(tmp_path), served() as side:
        assert side.child.pid is not None
        os.kill(side.child.pid, signal.SIGSTOP)
        try:
            done = hil("ctl", "estop")
        finally:
            os.kill(side.child.pid, signal.SIGCONT)
        assert (done.returncode, side.actions) == (0, [Action.ESTOP]), done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
@pytest.mark.parametrize("how", ["SIGKILL", "SIGSTOP"])
def test_a_process_that_fails_is_started_again_and_meanwhile_the_api_takes_the_estop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    with own_state(tmp_path), served() as side:
        pid, client = estop_pid(side), find()
        assert pid is not None
        os.kill(pid, getattr(signal, how))
        with pytest.raises(OSError, match="Address already in use"):  # by nobody who would answer "stopped"
            socket.create_server((HOST, int(side.child.estop_url.rpartition(":")[2])), reuse_port=False)
        client.order(Action.ESTOP)
        monkeypatch.setattr("hil.addons.service.api_child._HUNG_S", 0.2)
        wait_for(lambda: estop_pid(side) not in (0, pid))
        monkeypatch.undo()

        def answers() -> bool:
            with contextlib.suppress(ConnectionRefusedError):
                return answer(side, request(side)).startswith(b"HTTP/1.1 200")
            return False

        wait_for(answers)


@pytest.mark.parametrize(
    ("changed", "status", "part"),
    [
        ({}, 200, b'{"result": {}}'),
        ({"end": "Content-Length: 2\r\n\r\n{}"}, 200, b'{"result": {}}'),
        ({"first": "POST /v1/estop HTTP/1.0"}, 200, b'{"result": {}}'),
        ({"token": ""}, 401, b"is missing or wrong"),
        ({"token": "Authorization: Bearer 0123456789abcdef"}, 401, b"is missing or wrong"),
        ({"host": "Host: robot.example.com"}, 421, b"answers for 127.0.0.1:"),
        ({"host": ""}, 421, b"answers for 127.0.0.1:"),
        ({"first": "POST /v1/arm HTTP/1.1"}, 404, b"POST /v1/estop alone"),
        ({"first": "GET /v1/estop HTTP/1.1"}, 404, b"POST /v1/estop alone"),
        ({"end": "X-Long: " + 9000 * "x" + "\r\n\r\n"}, 0, b""),
        ({"end": "X-Half: "}, 0, b""),
    ],
)
def test_only_an_estop_with_a_token_is_taken(side: ControlSide, changed: dict, status: int, part: bytes) -> None:
    got = answer(side, request(side, **changed))
    assert got.startswith(b"HTTP/1.1 %d" % status if status else b"")
    assert part in got
    assert side.actions == [Action.ESTOP] * (status == 200)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=5000), st.booleans())
def test_whatever_comes_is_no_order_and_the_next_estop_is_done(side: ControlSide, text: bytes, ends: bool) -> None:
    side.forget()
    pid = estop_pid(side)
    answer(side, text + b"\r\n\r\n" * ends)
    assert side.actions == []
    assert answer(side, request(side)).startswith(b"HTTP/1.1 200")
    assert (side.actions, estop_pid(side)) == ([Action.ESTOP], pid)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGSTOP")
def test_a_request_that_ended_while_the_process_stalled_is_done(side: ControlSide) -> None:
    whole = request(side)
    with socket.create_connection(("127.0.0.1", port(side)), 30.0) as one:
        one.sendall(whole[:10])
        time.sleep(0.05)  # so that it is accepted; if not, the test shows less
        os.kill(estop_pid(side), signal.SIGSTOP)
        one.sendall(whole[10:])
        time.sleep(1.2)  # longer than a request may take
        os.kill(estop_pid(side), signal.SIGCONT)
        assert one.recv(4096).startswith(b"HTTP/1.1 200")


def test_estops_of_both_ways_are_in_the_audit_log_with_who_gave_them(tmp_path: Path) -> None:
    clients, audit = tmp_path / "clients", tmp_path / "audit.jsonl"
    clients.touch(0o600)
    clients.write_text(f"panel read {READS}\n")
    with own_state(tmp_path), served(clients_file=str(clients), audit=str(audit)) as side:
        for _ in range(20):
            assert answer(side, request(side, token=f"Authorization: Bearer {READS}")).startswith(b"HTTP/1.1 200")
        assert answer(side, request(side)).startswith(b"HTTP/1.1 200")
        assert side.request("POST", "/v1/estop").status_code == 200
    number: Counter[tuple[str, str]] = Counter()
    for one in map(json.loads, audit.read_text().splitlines()):
        assert one["client"].startswith("127.0.0.1:")
        number[one["token"], one["outcome"]] += one.get("count", 1)
    assert number == {(who, how): n for who, n in [("panel", 20), ("owner", 2)] for how in ("given", "accepted")}


@pytest.mark.alone
@pytest.mark.parametrize(
    "kind",
    [
        "pings of one byte, 64 WebSockets",
        "metrics, 64 connections",
        "e-stop's port: half headers, 1100",
    ],
)
def test_an_estop_gets_through_a_flood(tmp_path: Path, kind: str) -> None:
    clients = tmp_path / "clients"
    clients.touch(0o600)
    clients.write_text(f"panel read {READS}\n")
    with own_state(tmp_path), served(clients_file=str(clients)) as side:
        api = urlsplit(side.child.url).port
        assert api is not None
        assert kind in FLOODS
        target = json.dumps(Target(api, port(side), READS, READS))
        words = [sys.executable, "-m", "tools.bench.estop", "--flood", kind, "--target", target]
        flood = subprocess.Popen(words, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert flood.stdout is not None
        try:
            assert flood.stdout.readline() == "floods\n"
            client, took_s, until_s = find(), [], time.monotonic() + 4.0
            while time.monotonic() < until_s:
                begin_s = time.monotonic()
                client.order(Action.ESTOP)
                took_s.append(time.monotonic() - begin_s)
        finally:
            flood.kill()
            flood.communicate()
        assert max(took_s) < SECONDS, took_s
        assert side.child.restarts == 0
        assert side.child.alive, "the robot would be stopped"
