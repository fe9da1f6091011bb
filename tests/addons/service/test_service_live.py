"""The WebSocket, and the life of the API process beside the control process."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from hil.addons.service.api_child import ApiChild, OrderProcess
from hil.addons.service.messages import Action, Answer, ApiConfig, Motion, Phase
from hil.core.errors import BadInputError, DeviceError
from hil.core.subprocesses import module_command
from tests.support.processes import environment, is_running, own_state, wait_for
from tests.support.service_testbed import LIMITS, STATUS, ControlSide, served

CONFIG = ApiConfig(title="paper_circle", device="a test", limits=LIMITS, port=0)
TWIST = {"vx_m_s": 0.5, "vy_m_s": 0.0, "yaw_rate_rad_s": 0.0}
UPGRADE = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13"}
UPGRADE["Sec-WebSocket-Key"] = "dGhlIHNhbXBsZSBub25jZQ=="
CLOSE = b"\x88\x80" + bytes(4)
"""A client's Close, which its library would send only while it reads (RFC 6455, 5.5.1)."""


def order(live: ClientConnection, number: int, action: str, arguments: object) -> None:
    live.send(json.dumps({"order": {"number": number, "action": action, "arguments": arguments}}))


def next_answer(live: ClientConnection) -> dict[str, Any]:
    while "answer" not in (told := json.loads(live.recv(timeout=30.0))):
        pass
    answer: dict[str, Any] = told["answer"]
    return answer


def flood(side: ControlSide, live: ClientConnection) -> None:
    """Give orders and read no answers, until the service counts no client any more; then read all that had come."""

    def is_ended_by_more() -> bool:
        # The library reads 16 frames by itself, and then waits; what follows fills the buffers of both ends.
        for number in range(500):
            order(live, number, "twist", TWIST)
        return tells(side, "hil_api_live_clients 0.0")

    wait_for(is_ended_by_more, 60.0)
    read_to_the_end(live)


def tells(side: ControlSide, figure: str) -> bool:
    return figure in side.request("GET", "/metrics").text.splitlines()


def read_to_the_end(live: ClientConnection) -> None:
    while True:
        live.recv(timeout=30.0)


def test_websocket_orders_come_in_order_and_answers_by_the_clients_numbers(side: ControlSide) -> None:
    with side.live() as live:
        for number in range(100, 150):
            order(live, number, "twist", TWIST | {"vx_m_s": number / 100.0})
        order(live, 7, "stop", {})
        answers = [next_answer(live) for _ in range(51)]
    assert [answer["number"] for answer in answers] == [*range(100, 150), 7]
    assert {answer["refused"] for answer in answers} == {None}
    assert [one.arguments.get("vx_m_s") for one in side.orders] == [*(n / 100.0 for n in range(100, 150)), None]


@pytest.mark.parametrize(
    ("message", "number", "part"),
    [
        ('{"order": {"number": 3, "action": "twist", "arguments": {"vx_m_s": NaN}}}', 3, "vx_m_s = nan: it should be"),
        ('{"order": {"number": 3, "action": "twist", "arguments": {"vx_m_s": 1}}}', 3, "vy_m_s is missing"),
        ('{"order": {"number": 3, "action": "arm", "arguments": {"now": true}}}', 3, "now: unknown name"),
        ('{"order": {"number": 3, "action": "dance"}}', -1, "order.action = 'dance'"),
        ("hello", -1, "not an order"),
        ("{}", -1, "this is not an order: the body: expected order or motion"),
    ],
)
def test_a_message_that_is_no_order_is_answered_with_a_sentence_and_the_client_stays(
    side: ControlSide, message: str, number: int, part: str
) -> None:
    with side.live() as live:
        live.send(message)
        answer = next_answer(live)
        assert answer["number"] == number
        assert part in answer["refused"]
        order(live, 4, "arm", {})
        assert next_answer(live) == {"number": 4, "refused": None, "result": {}}
    assert side.actions == [Action.ARM]


def test_who_asks_for_the_motion_gets_the_newest_and_the_control_process_knows_how_often(side: ControlSide) -> None:
    with side.live() as plain, side.live() as live:
        for rate_hz in (50.0, 200.0):
            live.send(json.dumps({"motion": {"rate_hz": rate_hz}}))
            wait_for(lambda rate_hz=rate_hz: side.child.motion_hz == rate_hz)
        with side.turn:
            side.child.send(Motion(time_unix_s=1.0, pose=(1.0, 2.0, 3.0), sequence=5))
        while (motion := json.loads(live.recv(timeout=30.0)).get("motion")) is None:
            pass
        assert (motion["pose"], motion["sequence"], motion["truth"]) == ([1.0, 2.0, 3.0], 5, None)
        assert all("status" in json.loads(plain.recv(timeout=30.0)) for _ in range(3))
        live.send('{"motion": {"rate_hz": 2000}}')
        assert "motion.rate_hz = 2000" in next_answer(live)["refused"]
    wait_for(lambda: side.child.motion_hz == 0.0)


def test_a_refusal_and_a_missing_answer_reach_the_client(side: ControlSide) -> None:
    side.answer = lambda one: Answer(one.number, "not armed") if one.action is Action.TWIST else None
    with side.live() as live:
        order(live, 1, "twist", TWIST)
        order(live, 2, "arm", {})
        assert next_answer(live)["refused"] == "not armed"
        assert "has not answered arm" in next_answer(live)["refused"]


def test_a_client_that_does_not_read_delays_no_other_and_later_gets_the_newest_status(side: ControlSide) -> None:
    with side.live() as slow, side.live() as quick:
        # What the sockets take in is read away, so that only the newest is left to be sent.
        for ticks in range(2000, 2020):
            side.status = replace(STATUS, ticks=ticks, why="x" * 1000)
            while json.loads(quick.recv(timeout=30.0)).get("status", {}).get("ticks") != ticks:
                pass
        side.status = replace(STATUS, phase=Phase.ESTOP)
        while json.loads(slow.recv(timeout=30.0)).get("status", {}).get("phase") != "estop":
            pass


def test_when_a_client_that_drives_is_killed_nothing_more_is_sent_for_it(side: ControlSide) -> None:
    script = (
        "import sys, json, time\nfrom websockets.sync.client import connect\n"
        "with connect(sys.argv[1], additional_headers={'Authorization': sys.argv[2]}, proxy=None) as live:\n"
        "    for number in range(10**6):\n"
        f"        live.send(json.dumps({{'order': {{'number': number, 'action': 'twist', 'arguments': {TWIST}}}}}))\n"
        "        time.sleep(0.02)\n"
    )
    address = side.child.url.replace("http", "ws", 1) + "/v1/live"
    driver = subprocess.Popen([sys.executable, "-c", script, address, side.headers["Authorization"]], env=environment())
    wait_for(lambda: len(side.orders) > 3)
    driver.kill()
    driver.wait()
    wait_for(lambda: tells(side, "hil_api_live_clients 0.0"))
    taken = len(side.orders)
    assert side.request("POST", "/v1/stop").status_code == 200
    assert side.actions[taken:] == [Action.STOP], "that the twist times out is the control process's doing"


def test_a_twist_that_waited_for_longer_than_it_would_be_in_force_is_not_taken(tmp_path: Path) -> None:
    limits = replace(LIMITS, twist_timeout_s=0.2)
    with own_state(tmp_path), served(limits=limits) as side, side.live() as live:
        pid = side.child.pid
        assert pid is not None
        os.kill(pid, signal.SIGSTOP)
        order(live, 0, "twist", TWIST)
        time.sleep(limits.twist_timeout_s + 0.2)  # the stall itself, shorter than what makes the child count as gone
        os.kill(pid, signal.SIGCONT)
        assert next_answer(live)["refused"] == "the API stalled while this order waited; give it again"
        assert Action.TWIST not in side.actions

        def is_taken() -> bool:
            order(live, 1, "twist", TWIST)
            return next_answer(live)["refused"] is None

        wait_for(is_taken)


def test_a_burst_held_up_by_a_stalled_api_moves_nothing_but_its_estop_is_done(
    side: ControlSide, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.addons.service.api_child._HUNG_S", 600.0)  # the test decides when it goes on
    pid = side.child.pid
    assert pid is not None
    with side.live() as live:
        os.kill(pid, signal.SIGSTOP)
        for number in range(100):
            order(live, number, "twist", TWIST)
        order(live, 100, "arm", {})
        order(live, 101, "estop", {})
        wait_for(lambda: not side.child.alive)  # which is what disarms the robot
        os.kill(pid, signal.SIGCONT)
        answers = {answer["number"]: answer["refused"] for answer in (next_answer(live) for _ in range(102))}
        assert answers.pop(101) is None
        assert set(answers.values()) == {"the API stalled while this order waited; give it again"}
        assert side.actions == [Action.ESTOP]
        wait_for(lambda: side.child.alive)

        def is_taken() -> bool:
            order(live, 7, "twist", TWIST)
            return next_answer(live)["refused"] is None

        wait_for(is_taken)


@pytest.mark.alone  # it answers no ping meanwhile, and would be closed for that first
def test_a_client_that_sends_more_than_it_reads_is_closed_and_drives_no_longer(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with own_state(tmp_path), served() as side:
        with side.turn, side.live() as live, pytest.raises(ConnectionClosed) as closed:  # the control side is slow
            flood(side, live)
        # Where it sends too fast for a busy machine, that is told instead, and what was unread may cost the reason.
        assert closed.value.rcvd is None or closed.value.rcvd.code == 1008
        wait_for(lambda: tells(side, "hil_api_live_clients 0.0"))
        assert len(side.orders) <= 64, "no more are open at a time"
        # There is no room for another before the control side has had its turn and answered those that are open.
        wait_for(lambda: side.request("POST", "/v1/stop").status_code == 200)
        assert side.actions[-1] is Action.STOP
        assert side.request("GET", "/v1/live", headers=UPGRADE).status_code == 401
    said = capfd.readouterr().err
    assert "it does not read its answers" in said or "connections dropped flood=1" in said
    assert " error " not in said, "what could not be sent any more, and a handshake that is refused, is no failure"


def fill(side: ControlSide) -> None:
    """Send until nothing more can be sent to clients that do not read."""
    side.status = replace(STATUS, why="x" * 60_000)
    with side.live() as reads:
        for _ in range(60):
            reads.recv(timeout=30.0)


def test_clients_that_read_nothing_are_ended_however_they_leave(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with (
        own_state(tmp_path),
        served() as side,
        side.live() as stays,
        side.live() as closes,
        side.live() as hangs_up,
    ):
        fill(side)
        closes.socket.sendall(CLOSE)
        hangs_up.socket.shutdown(socket.SHUT_WR)
        wait_for(lambda: tells(side, 'hil_api_connections_dropped_total{cause="late"} 3.0'), 60.0)
        assert tells(side, "hil_api_live_clients 0.0")
        for live in (stays, closes, hangs_up):
            with pytest.raises(ConnectionClosed):
                read_to_the_end(live)
    assert " error " not in capfd.readouterr().err


def test_the_api_ends_in_order_while_a_client_that_reads_nothing_closes(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with own_state(tmp_path), served() as side, side.live() as live:
        fill(side)
        live.socket.sendall(CLOSE)
        wait_for(lambda: tells(side, "hil_api_live_clients 0.0"))
        side.child.close()
        with pytest.raises(ConnectionClosed):
            read_to_the_end(live)
    said = capfd.readouterr().err
    assert "API ends" in said
    assert "Traceback" not in said


def test_emergency_stops_come_before_other_waiting_orders(side: ControlSide) -> None:
    with side.live() as live:
        with side.turn:
            order(live, 1, "twist", TWIST)
            order(live, 2, "estop", {})
            order(live, 3, "stop", {})
            live.send("so that what came before has been taken")
            next_answer(live)
        assert [next_answer(live)["number"] for _ in range(3)] == [2, 1, 3]
    assert side.actions == [Action.ESTOP, Action.TWIST, Action.STOP]


def test_an_api_process_that_is_killed_or_hangs_is_restarted_with_its_port_and_token(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.addons.service.api_child._HUNG_S", 0.2)
    token = tmp_path / "token"
    token.write_text("a-token-of-my-own-which-is-long-enough\n")
    token.chmod(0o600)
    with own_state(tmp_path), served(token_file=str(token)) as side:
        before = (side.child.url, side.headers)
        side.status = replace(STATUS, why="x" * 60_000)  # so that the pipe of one that hangs is soon full
        for restarts, how in enumerate([signal.SIGKILL, signal.SIGSTOP], 1):
            pid = side.child.pid
            assert pid is not None
            os.kill(pid, how)
            wait_for(lambda restarts=restarts: side.child.restarts == restarts and side.child.alive)
            assert (side.child.url, side.headers) == before
            assert side.request("POST", "/v1/estop").status_code == 200
            assert not is_running(pid)
    assert token.exists(), "it is the user's"


def test_an_api_process_is_not_killed_because_the_control_process_stalled(
    side: ControlSide, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.addons.service.api_child._HUNG_S", 0.3)
    before = (side.child.pid, side.child.restarts)
    with side.turn:  # as when the control process stands still after it has looked
        begin_s = time.monotonic()
        wait_for(lambda: time.monotonic() > begin_s + 0.5)
        side.child.send(STATUS)
        assert side.child.alive
    assert side.request("POST", "/v1/stop").status_code == 200
    assert (side.child.pid, side.child.restarts) == before


def test_the_api_process_ends_when_its_control_process_is_killed(tmp_path: Path) -> None:
    script = (
        "import sys, time\nfrom hil.addons.service.api_child import ApiChild\n"
        "from hil.addons.service.messages import ApiConfig, Limits\n"
        "child = ApiChild(ApiConfig(title='t', device='d', limits=Limits(1, 1, 1, 1, 1), port=0))\n"
        "print(child.pid, flush=True)\ntime.sleep(600)\n"
    )
    control = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        text=True,
        env=environment() | {"XDG_STATE_HOME": str(tmp_path)},
    )
    assert control.stdout is not None
    pid = int(control.stdout.readline())
    assert is_running(pid)
    control.kill()
    control.communicate()
    wait_for(lambda: not is_running(pid))


def test_a_port_in_use_is_refused_with_a_sentence(tmp_path: Path) -> None:
    with own_state(tmp_path), socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(
            BadInputError,
            match=rf"cannot listen on 127\.0\.0\.1:{port} \(Address already in use\); .* choose another port",
        ):
            ApiChild(replace(CONFIG, port=port))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no modes of files")
def test_a_token_file_that_others_may_read_or_without_a_token_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text("this has spaces, and is no token")
    path.chmod(0o644)
    for match in (r"others may read it .* chmod 600", "are no token"):
        with own_state(tmp_path), pytest.raises(BadInputError, match=match):
            ApiChild(replace(CONFIG, token_file=str(path)))
        path.chmod(0o600)


def test_a_process_that_does_not_start_is_told_with_a_remedy() -> None:
    process = OrderProcess("hil.addons.service.no_such_process", "API", CONFIG)
    with pytest.raises(DeviceError) as refused:
        process.wait_until_ready()
    process.close()
    remedy = "'pip install --force-reinstall fastapi uvicorn' helps where a package of it is broken"
    assert str(refused.value) == f"the API process did not start; its output is above, and {remedy}"


def test_a_process_that_cannot_come_back_is_told_at_each_attempt(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    ready = """echo '{"ready": {"url": "http://127.0.0.1:1"}}'"""
    refused = """echo '{"refused": "the port is taken"}'; exec sleep 60"""
    commands = iter([["sh", "-c", ready], ["./no-such-program"], ["sh", "-c", refused]])
    monkeypatch.setattr("hil.addons.service.api_child.module_command", lambda *_: next(commands))
    monkeypatch.setattr("hil.wire.reopening._FIRST_NS", 1_000_000)
    process = OrderProcess("not used", "API", CONFIG)
    process.wait_until_ready()
    wait_for(lambda: process.orders() or len(caplog.records) == 3)
    process._process.kill()  # type: ignore[union-attr]
    process.close()
    ended, away, cannot = ({"event": line.getMessage(), **vars(line)["fields"]} for line in caplog.records)
    assert ended == {"event": "process ended", "which": "API", "exit_status": 0, "again_in_s": 0.001}
    assert away["event"] == "process could not be started"
    assert (away["which"], away["again_in_s"]) == ("API", 0.002)
    assert "'./no-such-program'" in away["why"]
    assert cannot == {"event": "process cannot start again", "which": "API", "why": "the port is taken"}


def test_an_api_process_without_a_control_process_ends_at_once() -> None:
    done = subprocess.run(
        module_command("hil.addons.service.api_process"),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
