"""Connections of the emergency stop's port: a header in parts, many that wait, and those that send nothing."""

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.addons.service import estop_process
from hil.addons.service.api.access import Access
from hil.addons.service.api.control import Control
from hil.addons.service.estop_process import _Connections
from hil.addons.service.messages import Action, Answer

TOKEN = "t" * 16
Do = Callable[["Port"], Awaitable[None]]


class Port:
    """The port in this process, with a control that answers when it is told to."""

    def __init__(self, listener: socket.socket) -> None:
        self.number = listener.getsockname()[1]
        self.orders: list[Action] = []
        self.notes: list[tuple[str, bool]] = []
        self.go_on = asyncio.Event()
        audit = SimpleNamespace(
            note=lambda client, action, what, why=None, in_series=False: self.notes.append((what, in_series))
        )
        control = SimpleNamespace(order=self._order, audit=audit)
        self.connections = _Connections(listener, Access(TOKEN, {}), cast("Control", control))

    async def _order(self, action: Action, _arguments: object, _client: object) -> Answer:
        self.orders.append(action)
        await self.go_on.wait()
        return Answer(1, None, {"n": len(self.orders)})

    def request(self, token: str = TOKEN) -> bytes:
        head = f"POST /v1/estop HTTP/1.1\r\nHost: 127.0.0.1:{self.number}\r\nAuthorization: Bearer {token}\r\n"
        return head.encode() + b"Content-Length: 0\r\n\r\n"

    async def connect(self, data: bytes = b"") -> "Caller":
        caller = Caller(*await asyncio.open_connection("127.0.0.1", self.number))
        caller.writer.write(data)
        await asyncio.sleep(0.02)  # two rounds of the port
        return caller


class Caller:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def answer(self) -> tuple[int, Any]:
        """Return status and body; 0 where the connection was closed without an answer."""
        try:
            text = await self.reader.read()
        except ConnectionResetError:
            text = b""
        finally:
            self.writer.close()
        head, _, body = text.partition(b"\r\n\r\n")
        return (int(head.split()[1]), json.loads(body)) if text else (0, None)


def at_port(do: Do) -> None:
    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            port = Port(listener)
            task = asyncio.create_task(port.connections.carry_out())
            await do(port)
            task.cancel()
            asyncio.get_running_loop().remove_reader(listener)

    with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:
        runner.run(asyncio.wait_for(main(), 60.0))


def test_a_header_may_come_in_parts_and_each_time_anew() -> None:
    async def do(port: Port) -> None:
        port.go_on.set()
        for number in (1, 2):  # the port has nothing to read between them
            text = port.request()
            caller = await port.connect(text[:30])
            for part in (text[30:60], text[60:]):
                await asyncio.sleep(0.02)
                caller.writer.write(part)
            assert await caller.answer() == (200, {"result": {"n": number}})
        assert port.orders == [Action.ESTOP] * 2

    at_port(do)


def test_those_that_come_meanwhile_are_one_order_and_of_too_many_the_oldest_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(estop_process, "_MOST_WAITING", 2)

    async def do(port: Port) -> None:
        callers = []
        for number in range(5):
            callers.append(await port.connect(port.request()))
            while len(port.orders) + len(port.connections._waiting) + len(port.notes) <= number:
                await asyncio.sleep(0.001)
        why = {"detail": "2 emergency stops wait for their answer; the robot is told to stop"}
        assert [await one.answer() for one in callers[1:3]] == [(503, why)] * 2
        port.go_on.set()
        assert await callers[0].answer() == (200, {"result": {"n": 1}})
        assert [await one.answer() for one in callers[3:]] == [(200, {"result": {"n": 2}})] * 2
        assert len(port.orders) == 2
        assert port.notes == [("unanswered", True), ("unanswered", True), ("given", True), ("accepted", True)]

    at_port(do)


def test_one_that_is_no_emergency_stop_is_refused_with_why() -> None:
    async def do(port: Port) -> None:
        texts = {
            404: port.request().replace(b"/v1/estop", b"/v1/arm"),
            421: port.request().replace(b"Host: 127.0.0.1", b"Host: example.org"),
            401: port.request("u" * 16),
        }
        for status, text in texts.items():
            assert (await (await port.connect(text)).answer())[0] == status
        assert port.connections._dropped == 3
        assert port.orders == []

    at_port(do)


def test_who_sends_no_whole_header_is_dropped_after_a_second_or_for_a_newer_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = SimpleNamespace(now_s=50.0)
    monkeypatch.setattr(estop_process, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    monkeypatch.setattr(estop_process, "_MOST", 3)

    async def do(port: Port) -> None:
        first = await port.connect(b"POST")
        clock.now_s += 1.0
        others = [await port.connect(b"POST") for _ in range(2)]
        await asyncio.sleep(0.03)
        assert port.connections._dropped == 0
        assert not first.reader.at_eof()
        clock.now_s += 0.01
        assert await first.answer() == (0, None)
        more = [await port.connect(b"POST") for _ in range(2)]
        assert await others[0].answer() == (0, None), "three have a place"
        assert port.connections._dropped == 2
        long = await port.connect(b"x" * 4095)
        assert await others[1].answer() == (0, None)
        long.writer.write(b"x")
        assert await long.answer() == (0, None), "it is longer than any header"
        gone = more.pop()
        gone.writer.close()
        await asyncio.sleep(0.03)
        assert port.connections._dropped == 5
        assert port.orders == []

    at_port(do)
