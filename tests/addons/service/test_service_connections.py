"""The API under clients without a token, and under more orders than it can take: the emergency stop gets through."""

import asyncio
import contextlib
import json
import re
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import cast
from urllib.parse import urlsplit

import httpx
import pytest
import uvicorn
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.server import ServerState
from websockets.exceptions import ConnectionClosed

from hil.addons.service.api.access import Access
from hil.addons.service.api.connections import ConnectionPools, HttpConnection
from hil.addons.service.messages import Action
from tests.support.processes import own_state, wait_for
from tests.support.service_testbed import ControlSide, served

if sys.platform != "win32":
    import resource

SOON_S = 5.0  # on a busy machine; tools.bench.estop measures
HALF_A_HEADER = b"POST /v1/estop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: "

HANDSHAKE = (
    b"GET /v1/live HTTP/1.1\r\nHost: %s\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n%s\r\n"
)


@contextlib.contextmanager
def connections(side: ControlSide, number: int, text: bytes) -> Iterator[list[socket.socket]]:
    """Open connections, each of which sends a text and then nothing."""
    port = urlsplit(side.child.url).port
    with contextlib.ExitStack() as stack:
        opened = []
        for _ in range(number):
            opened.append(stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=30.0)))
            opened[-1].sendall(text)
        yield opened


def closed(one: socket.socket) -> bool:
    """Whether the service has closed a connection."""
    try:
        return one.recv(1) == b""
    except ConnectionResetError:
        return True


def estop_s(side: ControlSide) -> float:
    """Give an e-stop over a connection of its own; return how long it took [s]."""
    begin_s = time.monotonic()
    with httpx.Client(trust_env=False, verify=False, timeout=30.0) as client:
        assert client.post(side.child.url + "/v1/estop", headers=side.headers).status_code == 200
    return time.monotonic() - begin_s


def answer(side: ControlSide, text: bytes) -> bytes:
    """Send a text; return all that comes until the service closes the connection."""
    with connections(side, 1, text) as [one]:
        return b"".join(iter(lambda: one.recv(65536), b""))


@pytest.mark.alone
def test_an_estop_gets_through_1100_connections_that_send_half_a_header(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with own_state(tmp_path), served() as side:
        capfd.readouterr()
        with connections(side, 1100, HALF_A_HEADER) as strangers:
            assert estop_s(side) < SOON_S
            assert side.request("GET", "/v1/status").status_code == 200
            assert all(map(closed, strangers)), "the oldest at once, and each after two seconds"
        assert Action.ESTOP in side.actions
        wait_for(lambda: "connections dropped" in (said := capfd.readouterr().err) and len(said.splitlines()) < 5)


FLOOD = """
import asyncio, sys, time

async def orders(host, port, request, period_s, until_s):
    reader, writer = await asyncio.open_connection(host, port)
    answers = asyncio.create_task(reader.read(-1))
    due_s = sent = 0
    while time.monotonic() < until_s:
        writer.write(request)
        sent += 1
        due_s = max(due_s, time.monotonic() - 0.5) + period_s
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
    answers.cancel()
    return sent

async def main(host, port, text, number, per_s, for_s):
    request, until_s = text.encode(), time.monotonic() + for_s
    each = [orders(host, port, request, number / per_s, until_s) for _ in range(number)]
    print("begins", flush=True)
    print(sum(await asyncio.gather(*each)))

asyncio.run(main(sys.argv[1], int(sys.argv[2]), sys.argv[3], 64, 2000, 3.0))
"""


@pytest.mark.alone
def test_an_estop_gets_through_2000_orders_a_second(tmp_path: Path) -> None:
    with own_state(tmp_path), served() as side:
        host, port = urlsplit(side.child.url).netloc.split(":")
        body = json.dumps({"vx_m_s": 0.1, "vy_m_s": 0.0, "yaw_rate_rad_s": 0.0})
        request = (
            f"POST /v1/twist HTTP/1.1\r\nHost: {host}:{port}\r\nAuthorization: {side.headers['Authorization']}\r\n"
            f"Content-Type: application/json\r\nContent-Length: {len(body)}\r\n\r\n{body}"
        )
        flood = subprocess.Popen([sys.executable, "-c", FLOOD, host, port, request], stdout=subprocess.PIPE, text=True)
        assert flood.stdout is not None
        assert flood.stdout.readline() == "begins\n"
        took_s = []
        while flood.poll() is None:
            took_s.append(estop_s(side))
        assert int(flood.stdout.read()) > 3 * 2000 * 0.9
        flood.stdout.close()
    assert max(took_s) < SOON_S, took_s
    assert len(took_s) > 5


def test_a_client_with_the_token_keeps_its_connection_while_strangers_come(side: ControlSide) -> None:
    with contextlib.closing(HTTPConnection(urlsplit(side.child.url).netloc, timeout=30.0)) as known:

        def status() -> int:
            known.request("GET", "/v1/status", headers=side.headers)
            answer = known.getresponse()
            answer.read()
            return answer.status

        assert status() == 200
        known.auto_open = 0
        with connections(side, 600, HALF_A_HEADER) as strangers:
            assert all(map(closed, strangers[:300]))
            assert status() == 200


def test_whole_requests_of_strangers_crowd_out_no_request_with_the_token() -> None:
    """A stranger's request is answered with 401, but in one turn of the loop many come before any answer."""

    class One:
        def __init__(self, *, is_known: bool) -> None:
            self.is_known, self.aborted, self.transport = is_known, False, self

        def abort(self) -> None:
            self.aborted = True

    pools = ConnectionPools(Access("t" * 16, {}))
    known, strangers = One(is_known=True), [One(is_known=False) for _ in range(400)]
    for one in (known, *strangers):
        pools.place(cast(HttpConnection, one), in_request=True)
    assert not known.aborted
    assert sum(one.aborted for one in strangers) == 400 - 256


def test_a_websocket_that_was_closed_for_want_of_pongs_is_a_client_that_has_gone() -> None:
    """To uvicorn what is sent then is an error of the application, and a traceback for each such client."""

    async def send() -> None:
        config = uvicorn.Config(lambda *_: None, log_config=None)
        live = ConnectionPools(Access("t" * 16, {})).protocols()[1](config, ServerState(), {})
        live.close_sent = True
        await live.send({"type": "websocket.send", "text": "{}"})

    with pytest.raises(ClientDisconnected):
        asyncio.run(send())


PING, PONG, TEXT, BEGIN, ON = (
    b"\x89\x81\0\0\0\0x",
    b"\x8a\x80\0\0\0\0",
    b"\x81\x82\0\0\0\0{}",
    b"\1\x80\0\0\0\0",
    b"\0\x80\0\0\0\0",
)
LONG = b"\x82\xfe\xff\xff\0\0\0\0" + bytes(0xFFFF)


@pytest.mark.parametrize(
    ("sent", "why"),
    [
        (2000 * PING, "more than 300 frames a second"),
        (2000 * PONG, "more than 300 frames a second"),
        (2000 * TEXT, "more than 300 frames a second"),
        (BEGIN + 500 * ON, "a message in more than 64 fragments"),
        (20 * LONG, "more than 262144 bytes a second"),
    ],
)
def test_a_websocket_that_sends_too_fast_is_closed_and_counted(side: ControlSide, sent: bytes, why: str) -> None:
    def floods() -> float:
        return float(re.findall(r'dropped_total\{cause="flood"\} (\S+)', side.request("GET", "/metrics").text)[0])

    before = floods()
    with side.live() as live, side.live() as other:
        with contextlib.suppress(OSError):
            live.socket.sendall(sent)
        with pytest.raises(ConnectionClosed) as closed:
            deque(iter(lambda: live.recv(timeout=30.0), None), 0)
        assert closed.value.rcvd is not None
        assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1008, f"{why}; pings count too")
        assert floods() == before + 1
        other.recv(timeout=30.0)


def test_the_websocket_has_room_for_64_and_others_are_told(side: ControlSide) -> None:
    def live_clients() -> int:
        text = side.request("GET", "/metrics").text
        return int(float(re.findall(r"^hil_api_live_clients (\S+)", text, re.MULTILINE)[0]))

    handshake = HANDSHAKE % (
        urlsplit(side.child.url).netloc.encode(),
        b"Authorization: %s\r\n" % side.headers["Authorization"].encode(),
    )
    with connections(side, 64, handshake):
        wait_for(lambda: live_clients() == 64)
        refused = answer(side, handshake)
        assert refused.startswith(b"HTTP/1.1 503")
        assert b"64 clients are on the WebSocket" in refused
        assert estop_s(side) < 30.0
    wait_for(lambda: live_clients() == 0)


@pytest.mark.parametrize("header", [b"Content-Length: 3\r\n", b"X-Long: " + 9000 * b"x" + b"\r\n", 200 * b"X: x\r\n"])
def test_a_handshake_that_the_websocket_never_answers_is_dropped(side: ControlSide, header: bytes) -> None:
    with connections(side, 3, HANDSHAKE % (urlsplit(side.child.url).netloc.encode(), header)) as strangers:
        assert all(map(closed, strangers))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux sets the limits of another process")
def test_connections_that_cannot_be_accepted_are_one_line_of_the_log(
    capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with own_state(tmp_path), served() as side:
        assert side.child.pid is not None
        resource.prlimit(side.child.pid, resource.RLIMIT_NOFILE, (64, 64))
        capfd.readouterr()
        with connections(side, 200, HALF_A_HEADER):
            said = []
            wait_for(lambda: said.append(capfd.readouterr().err) or "not_accepted=" in "".join(said))
        assert estop_s(side) < 30.0
    assert len("".join(said).splitlines()) == 1


@pytest.mark.parametrize("length", [b"2", b"4"])
def test_a_request_with_two_lengths_is_refused_and_its_connection_closed(side: ControlSide, length: bytes) -> None:
    text = b"POST /v1/arm HTTP/1.1\r\nHost: %s\r\nAuthorization: %s\r\nContent-Length: %s\r\n" % (
        urlsplit(side.child.url).netloc.encode(),
        side.headers["Authorization"].encode(),
        length,
    )
    # For whoever reads by the first header, the second request is in the body of the first.
    inside = b"Transfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + text + b"\r\n"
    got = answer(side, text + inside)
    assert got.startswith(b"HTTP/1.1 400")
    assert (got.count(b"HTTP/1.1"), b"connection: close" in got.lower(), side.orders) == (1, True, [])
