"""The truth socket, client against server in one process: what is refused is said, and no record is left out."""

import contextlib
import json
import re
import socket
import stat
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from firmware_protocol.generated.messages import State
from hil.core.errors import BadInputError, DeviceError
from hil.core.types import ZERO_WHEELS, Pose, PoseFix, Twist, Wheels
from hil.robot.truth_client import LONGEST_ANSWER, TruthClient, _read_answer
from hil.robot.truth_server import TruthServer
from tests.support.processes import wait_for

MS = 1_000_000
VIEW = SimpleNamespace(set_point_rad_s=ZERO_WHEELS, command_age_ticks=0, state=State.ACTIVE)


def test_a_robot_that_takes_no_faults_says_so_at_the_begin():
    with (
        contextlib.closing(TruthServer("a scenario")) as server,
        contextlib.closing(TruthClient(server.url, "a scenario", reset=False)) as client,
        pytest.raises(DeviceError, match="this robot does not support faults"),
    ):
        client.begin(0)


def answer(server: TruthServer, line: bytes) -> dict:
    with socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2])), timeout=10.0) as connection:
        connection.sendall(line + b"\n")
        return json.loads(connection.makefile().readline())


@pytest.mark.parametrize("token", [{}, {"token": ""}, {"token": 43 * "x"}, {"token": "\ud800"}, {"token": None}])
@pytest.mark.parametrize(
    "request_",
    [{"reset": False}, {"reset": True}, {"reset": False, "faults": {"arm": []}}],
    ids=["read", "reset", "arm"],
)
def test_nobody_without_the_token_reads_resets_or_arms_a_fault(token: dict, request_: dict) -> None:
    with contextlib.closing(TruthServer("a scenario")) as server:
        server.request_reset = server.run_on_faults = pytest.fail
        refused = answer(server, json.dumps({"scenario": "a scenario"} | request_ | token).encode())
        assert refused == {"error": "the token is missing or wrong"}, "and not where it is"


def test_the_token_is_for_this_user_alone_new_each_time_and_gone_at_the_end() -> None:
    with contextlib.closing(TruthServer("a scenario")) as server:
        assert stat.S_IMODE(server.token_file.stat().st_mode) == 0o600
        first = server.token_file.read_text()
    assert not server.token_file.exists()
    with contextlib.closing(TruthServer("a scenario")) as server:
        assert server.token_file.read_text() != first


def test_a_token_may_be_named_and_one_that_others_may_read_is_refused(tmp_path: Path) -> None:
    with contextlib.closing(TruthServer("a scenario")) as server:
        copy = tmp_path / "of another user"
        server.token_file.rename(copy)
        with pytest.raises(DeviceError, match=re.escape(f"missing or wrong; expected it in {server.token_file}")):
            TruthClient(server.url, "a scenario", reset=False)
        named = f"{server.url}?token_file={copy}"
        TruthClient(named, "a scenario", reset=False).close()
        copy.chmod(0o644)
        with pytest.raises(BadInputError, match="others may read it"):
            TruthClient(named, "a scenario", reset=False)


def test_clients_that_say_nothing_take_the_place_of_each_other_and_of_no_client_with_the_token() -> None:
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(contextlib.closing(TruthServer("a scenario")))
        address = ("127.0.0.1", int(server.url.rpartition(":")[2]))
        reader = stack.enter_context(contextlib.closing(TruthClient(server.url, "a scenario", reset=False)))
        silent = [stack.enter_context(socket.create_connection(address, timeout=1.5)) for _ in range(100)]
        assert silent[0].recv(1) == b"", "sooner than in the two seconds that each has"
        TruthClient(server.url, "a scenario", reset=False).close()
        server.publish(PoseFix(MS, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0)), VIEW)
        assert wait_for(reader.poll).time_ns == MS


def test_a_poll_that_waits_gives_every_record_that_came_meanwhile():
    with contextlib.closing(TruthServer("a scenario")) as server:

        def publish(*times_ms: int) -> None:
            for time_ms in times_ms:
                server.publish(PoseFix(time_ms * MS, Pose(0.0, 0.0, 0.0), Twist(0.0, 0.0, 0.0)), VIEW)

        def not_before() -> int:
            """Asked within the poll, when it has taken what was there."""
            publish(3, 4)
            return 4 * MS

        with contextlib.closing(TruthClient(server.url, "a scenario", reset=False, not_before=not_before)) as client:
            wait_for(lambda: server._clients)
            publish(1, 2)
            client.poll()
            assert [record.fix.time_ns // MS for record in client.taken] == [1, 2, 3, 4]


def test_every_field_of_a_record_arrives_under_its_name() -> None:
    fix = PoseFix(123 * MS, Pose(1.0, -2.0, 0.5), Twist(0.1, -0.2, 0.3))
    view = SimpleNamespace(set_point_rad_s=Wheels(1.0, 2.0, 3.0, 4.0), command_age_ticks=7, state=State.STOPPING)
    with (
        contextlib.closing(TruthServer("a scenario")) as server,
        contextlib.closing(TruthClient(server.url, "a scenario", reset=False)) as client,
    ):
        server.publish(fix, None)  # of a robot that is off
        server.publish(fix, view)
        assert wait_for(client.poll) == fix
        assert client.newest == (fix, (1.0, 2.0, 3.0, 4.0), 7, State.STOPPING)
        with contextlib.closing(TruthClient(server.url, "a scenario", reset=False)) as late:
            assert wait_for(late.poll) == fix, "who comes later gets the newest"
        with pytest.raises(DeviceError, match="was lost"):
            late.poll()


@pytest.mark.parametrize(
    "url", ["udp://127.0.0.1:1", "tcp://:1", "tcp://127.0.0.1", "tcp://127.0.0.1:99999", "tcp://[::1"]
)
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(BadInputError, match=r"is no valid address; expected tcp://127.0.0.1:PORT"):
        TruthClient(url, "a scenario", reset=False)


def answering(text: bytes) -> tuple[socket.socket, str]:
    """Return a server that says this to its only client, and its URL."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError), listener.accept()[0] as connection:
            connection.sendall(text)
            connection.recv(4096)

    threading.Thread(target=serve, daemon=True).start()
    return listener, f"tcp://127.0.0.1:{listener.getsockname()[1]}"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"SSH-2.0\n", "something else listens there; use the URL of hil device"),
        (b"[1, 2]\n", "something else listens there; use the URL of hil device"),
        (b"x" * 70_000, "something else listens there; use the URL of hil device"),
        (b'{"error": "it is asleep"}\n', "it is asleep"),
        (b"", "nobody answers (the connection was closed); start hil device first"),
    ],
)
def test_what_is_no_robot_or_a_robot_that_refuses_is_told(text: bytes, words: str) -> None:
    listener, url = answering(text)
    with listener, pytest.raises(DeviceError) as failed:
        TruthClient(url, "a scenario", reset=False)
    assert str(failed.value) == f"truth {url!r}: {words}"


def test_a_robot_that_has_ended_or_says_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        url = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(DeviceError, match=r"nobody answers \(.*\); start hil device first"):
        TruthClient(url, "a scenario", reset=False)
    with contextlib.closing(TruthServer("a scenario")) as server:
        client = TruthClient(server.url, "a scenario", reset=False, not_before=lambda: 1)
        monkeypatch.setattr("hil.robot.truth_client.ANSWER_S", 0.05)
        with pytest.raises(DeviceError, match="is silent; the robot's process was lost"):
            client.poll()
    with contextlib.closing(client), pytest.raises(DeviceError, match="was closed: the robot's process has ended"):
        wait_for(lambda: client.poll())


def test_a_server_says_what_it_refuses() -> None:
    with contextlib.closing(TruthServer("a scenario")) as server:
        token = server.token_file.read_text().strip()

        def asked(**changes: object) -> object:
            return answer(
                server, json.dumps({"token": token, "scenario": "a scenario", "reset": False} | changes).encode()
            )

        assert answer(server, b"hello") == {"error": "the request was not understood"}
        assert asked(faults=[1]) == {"error": "the request was not understood"}
        assert asked(scenario="b" * 64) == {
            "error": f"the robot runs another scenario (hash a scenario, asked for {'b' * 12}); start both from the "
            "same scenario and overrides"
        }
        assert asked(faults={"applied": True}) == {"error": "this robot does not support faults"}
        server.request_reset = lambda told: told(False)
        assert asked(reset=True) == {
            "error": "the robot is armed or moves, and was not put back to its start; stop its controller first"
        }
        server.request_reset = lambda told: told(True)
        assert asked(reset=True) == {"ok": True}
        server.run_on_faults = lambda run: run(SimpleNamespace(applied=lambda: [3, 4], begin=lambda tick: None))
        assert asked(faults={"begin": 5}) == {"applied": [3, 4]}
        refused = asked(faults={"begin": "soon"})
        assert str(refused["error"]).startswith("the request was not understood (")
        with contextlib.closing(TruthClient(server.url, "a scenario", reset=False)) as client:
            assert client.applied() == [3, 4]
            server.run_on_faults = lambda run: run(SimpleNamespace(applied=lambda: None))
            with pytest.raises(DeviceError, match="does not report how often a fault was applied"):
                client.applied()


def test_an_answer_may_be_as_long_as_a_server_s_longest_and_no_longer() -> None:
    """A stand-in for a socket, whose pieces are as long as they are given."""
    longest = b'{"ok": true}'.ljust(LONGEST_ANSWER)
    pieces = iter([longest, b"\n{", longest + b" ", b"\n"])
    connection: Any = SimpleNamespace(recv=lambda _: next(pieces))
    assert _read_answer(connection) == ({"ok": True}, bytearray(b"{"))
    with pytest.raises(ValueError, match="no line"):
        _read_answer(connection)
