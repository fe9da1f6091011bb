"""The tokens of servers that were killed are removed, and no others."""

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from hil.addons.service.discovery import Service, announce
from hil.core.errors import BadInputError
from hil.core.private_files import write_private
from hil.core.tokens import clear_tokens, make_token, token_file
from hil.robot.truth_client import KIND
from hil.robot.truth_server import TruthServer
from tests.support.processes import environment, hil, network_of_its_own

pytestmark = pytest.mark.usefixtures("state_home")


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def made(kind: str, port: int) -> Path:
    path = token_file(kind, port)
    make_token(path)
    return path


def test_the_token_of_a_port_where_nobody_listens_goes_unless_it_is_kept() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        lives, dead, kept = made("services", server.getsockname()[1]), made("services", free_port()), free_port()
        restarts = made("services", kept)
        mine = lives.with_name("mine.token")
        mine.write_text("of a user")
        clear_tokens("services", [kept])
        assert not dead.exists()
        assert all(path.exists() for path in (lives, restarts, mine))
    clear_tokens("services")
    assert not lives.exists()


def test_a_truth_server_removes_the_tokens_of_killed_ones_of_its_kind() -> None:
    dead, another = made(KIND, free_port()), made("fixes", free_port())
    server = TruthServer("hash")
    try:
        assert not dead.exists()
        assert another.exists()
        assert server.token_file.exists()
        second = TruthServer("hash")
        second.close()
        assert server.token_file.exists()
    finally:
        server.close()


ELSEWHERE = """
import os, signal
from hil.robot.truth_server import TruthServer
print(TruthServer("hash").url, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="network namespaces are Linux's")
def test_servers_in_two_network_namespaces_leave_the_tokens_of_each_other() -> None:
    ours = TruthServer("hash")
    try:
        command = [*network_of_its_own(), sys.executable, "-c", ELSEWHERE]
        done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False)
        assert done.returncode == -signal.SIGKILL, done.stderr
        theirs = int(done.stdout.rpartition(":")[2])
        assert ours.token_file.exists()
        TruthServer("hash").close()
        assert token_file(KIND, theirs).exists(), "nobody listens there, here; and so it is for a living one"
        with pytest.raises(BadInputError) as refused:
            TruthServer("hash", theirs)
        assert str(refused.value) == (
            f"truth port {theirs}: {token_file(KIND, theirs)} has the token of a robot on another machine, or in "
            "another network namespace (a container); choose another port, or remove the file when that has ended"
        )
    finally:
        ours.close()


@pytest.mark.parametrize("text", ["0123abcd.of-another-machine", 43 * "x", ""], ids=["elsewhere", "older", "empty"])
def test_a_token_that_was_not_made_here_stays(text: str) -> None:
    path = token_file("services", free_port())
    write_private(path, text)
    clear_tokens("services")
    assert path.read_text() == text


def test_a_service_replaces_no_token_of_one_that_has_its_port_in_another_namespace() -> None:
    port = free_port()
    path = made("services", port)
    text = path.read_text()
    claim = announce(Service(f"http://127.0.0.1:{port}", 1, "theirs", "memory:", str(path)))
    try:
        done = hil("serve", "circle_speed", "--set", f"service.port={port}")
        assert (done.returncode, path.read_text()) == (2, text)
        assert f"hil: port {port}: a service in another network namespace" in done.stderr
    finally:
        claim.release()
