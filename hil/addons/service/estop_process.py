"""The process that takes emergency stops for a service, and nothing else; ``hil.addons.service.api_child`` starts it.

It has a port and a pipe to the control process of its own, so no client of the API can delay an emergency stop by a
flood, or by making the API hang. A thread of the API would wait for its interpreter, and end with it. A connection is
one request, ``POST /v1/estop`` with any valid token; a body is not read. Tokens, Host header and audit log are as in
the API. The API alone renames the audit log when it is full.
"""

import asyncio
import contextlib
import json
import socket
import sys
import time
from http import HTTPStatus
from pathlib import Path
from typing import NamedTuple

from hil.addons.service import logs
from hil.addons.service.api.access import NO_TOKEN, Access, Client, misdirected
from hil.addons.service.api.audit import Audit
from hil.addons.service.api.control import Control, NotDoneError
from hil.addons.service.api_process import LONGEST_QUEUE, OrderPort, begin, known, listen
from hil.addons.service.messages import HOST, Action
from hil.core.errors import BadInputError

_LONGEST_BYTES = 4096  # of a request's header
_MOST = 384  # connections whose header is incomplete; another one takes the place of the oldest
_MOST_WAITING = 384
_BATCH = 64  # connections accepted in a turn of the loop
_DEADLINE_S = 1.0
_READ_S = 0.01
_LOG_PERIOD_S = 10.0


class _Refused(NamedTuple):
    status: HTTPStatus
    detail: str


class _Connections:
    """The listening socket and its connections, for the tasks of one event loop."""

    def __init__(self, listener: socket.socket, access: Access, control: Control) -> None:
        self._loop = asyncio.get_running_loop()
        self._listener = listener
        self._access, self._control = access, control
        self._headers: dict[socket.socket, tuple[bytes, float]] = {}  # incomplete, and until when; oldest first
        self._is_reading = False
        self._waiting: list[tuple[socket.socket, Client]] = []
        self._asked = asyncio.Event()
        self._dropped = 0
        listener.setblocking(False)
        self._loop.add_reader(listener, self._accept)

    def _accept(self) -> None:
        for _ in range(_BATCH):
            try:
                connection, _ = self._listener.accept()
            except BlockingIOError:
                break
            except OSError:  # it has gone already, or no descriptor is left: there may be one after the oldest is gone
                self._drop_oldest()
                break
            connection.setblocking(False)
            self._headers[connection] = b"", time.monotonic() + _DEADLINE_S
            self._read(connection)  # mostly the whole request has come already
            if len(self._headers) > _MOST:
                self._drop_oldest()
        if self._headers and not self._is_reading:
            self._is_reading = True
            self._loop.call_later(_READ_S, self._read_on)

    def _read_on(self) -> None:
        """Read on all incomplete headers. In a flood this costs less than a reader of the loop for each connection."""
        now_s = time.monotonic()
        for connection, (_, until_s) in list(self._headers.items()):
            self._read(connection)  # also of an overdue one: after a stall of this process its request may be there
            if now_s > until_s and connection in self._headers:
                self._drop(connection)
        self._is_reading = bool(self._headers)
        if self._is_reading:
            self._loop.call_later(_READ_S, self._read_on)

    def _drop_oldest(self) -> None:
        for connection in list(self._headers)[:1]:
            self._drop(connection)

    def _drop(self, connection: socket.socket) -> None:
        self._dropped += 1
        del self._headers[connection]
        connection.close()

    def _read(self, connection: socket.socket) -> None:
        try:
            data = connection.recv(_LONGEST_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        header, until_s = self._headers[connection]
        header += data
        self._headers[connection] = header, until_s
        if not data:
            self._drop(connection)
        elif b"\r\n\r\n" in header:
            del self._headers[connection]
            found = self._caller(header.partition(b"\r\n\r\n")[0], connection)
            if isinstance(found, Client):
                self._wait(connection, found)
            else:
                self._dropped += 1
                _answer(connection, found.status, {"detail": found.detail})
        elif len(header) >= _LONGEST_BYTES:
            self._drop(connection)

    def _wait(self, connection: socket.socket, client: Client) -> None:
        self._waiting.append((connection, client))
        self._asked.set()
        if len(self._waiting) > _MOST_WAITING:  # the order goes out nevertheless
            oldest, client = self._waiting.pop(0)
            why = f"{_MOST_WAITING} emergency stops wait for their answer; the robot is told to stop"
            self._control.audit.note(client, Action.ESTOP, "unanswered", why=why, in_series=True)
            _answer(oldest, HTTPStatus.SERVICE_UNAVAILABLE, {"detail": why})

    def _caller(self, header: bytes, connection: socket.socket) -> Client | _Refused:
        """Return who gives the emergency stop, or why it is none."""
        first, *lines = header.split(b"\r\n")
        pairs = [(name.lower(), value.strip()) for name, _, value in (line.partition(b":") for line in lines)]
        if first.split(b" ")[:2] != [b"POST", b"/v1/estop"]:
            return _Refused(HTTPStatus.NOT_FOUND, "this port takes POST /v1/estop alone; the API has a port of its own")
        if (elsewhere := misdirected(pairs, self._listener.getsockname()[1])) is not None:
            return _Refused(HTTPStatus.MISDIRECTED_REQUEST, elsewhere)
        if (client := self._access.client(pairs)) is None:
            return _Refused(HTTPStatus.UNAUTHORIZED, NO_TOKEN)
        with contextlib.suppress(OSError):  # it has gone, and wants its emergency stop nevertheless
            client = client._replace(address=":".join(map(str, connection.getpeername())))
        return client

    async def carry_out(self) -> None:
        """Order emergency stops until cancelled: those that came while one was on the way become one order."""
        while True:
            await self._asked.wait()
            self._asked.clear()
            waiting, self._waiting = self._waiting, []
            (_, first), *others = waiting
            status, outcome, why = HTTPStatus.OK, "accepted", None
            body: dict[str, object] = {}
            try:
                answer = await self._control.order(Action.ESTOP, {}, first)
                body = {"result": answer.result}
                if (why := answer.refused) is not None:
                    status, outcome = HTTPStatus.CONFLICT, "refused"
            except NotDoneError as error:
                status, outcome, why = HTTPStatus(error.http_status), error.outcome, str(error)
            for _, client in others:
                self._control.audit.note(client, Action.ESTOP, "given", in_series=True)
                self._control.audit.note(client, Action.ESTOP, outcome, why=why, in_series=True)
            for connection, _ in waiting:
                _answer(connection, status, body if why is None else {"detail": why})

    async def report(self) -> None:
        """Log how many connections were dropped or refused, until cancelled."""
        while True:
            await asyncio.sleep(_LOG_PERIOD_S)
            if self._dropped:
                logs.warning("connections to the e-stop's port were dropped or refused", number=self._dropped)
                self._dropped = 0


def _answer(connection: socket.socket, status: HTTPStatus, body: object) -> None:
    """Answer and close; never waits. Received bytes of a body are read, or the client would lose the answer."""
    text = json.dumps(body).encode()
    header = f"HTTP/1.1 {status.value} {status.phrase}\r\nContent-Type: application/json\r\nConnection: close\r\n"
    with contextlib.suppress(OSError), connection:
        connection.send(f"{header}Content-Length: {len(text)}\r\n\r\n".encode() + text)
        connection.shutdown(socket.SHUT_WR)
        connection.recv(65536)


async def _serve(port: OrderPort) -> None:
    """Serve until the control process has ended. An error of a task is raised: the control process starts another."""
    control = port.control()
    connections = _Connections(port.listener, port.access, control)
    port.writer.send({"ready": {"url": f"http://{HOST}:{port.number}"}})
    tasks = (control.gone.wait(), connections.carry_out(), connections.report(), *port.tasks(control))
    try:
        ended, _ = await asyncio.wait(map(asyncio.ensure_future, tasks), return_when=asyncio.FIRST_COMPLETED)
        for one in ended:
            one.result()
    finally:
        port.audit.close()


def main() -> int:
    """Serve until the control process ends, and return 0. Return 2 when that is impossible as configured."""
    if (begun := begin("estop")) is None:
        return 0
    config, _, writer = begun
    assert config.token_file is not None
    assert config.audit is not None
    try:
        # Where sockets are inherited, the control process holds this one, and its number is the argument.
        listener = socket.socket(fileno=int(sys.argv[1])) if sys.argv[1:] else listen(config.port)
        who = known(config, Path(config.token_file))
        port = OrderPort(*begun, listener, *who, Audit(Path(config.audit), longest_bytes=sys.maxsize))
    except BadInputError as error:
        writer.send({"refused": str(error)})
        return error.exit_code
    listener.listen(LONGEST_QUEUE)
    with asyncio.Runner(loop_factory=asyncio.SelectorEventLoop) as runner:  # that of Windows knows no add_reader
        runner.run(_serve(port))
    return 0


if __name__ == "__main__":
    sys.exit(main())
