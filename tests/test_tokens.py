"""The tokens of servers that were killed are removed, and no others."""

import socket
from pathlib import Path

import pytest

from hil.core.tokens import clear_tokens, make_token, token_file
from hil.robot.truth import KIND
from hil.robot.truth_server import TruthServer

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
