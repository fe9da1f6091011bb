"""The server of the API: one process, one event loop, one socket, and a gate in front of the application.

The server listens on the loopback address only. A web page can reach that too. If it uses its own host name that points
to 127.0.0.1 (DNS rebinding), the Host header shows it; otherwise the token stops it. There is no CORS.
"""

import asyncio
import json
import secrets
import socket
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

import uvicorn

from hil.core.json_lines import LineReader, LineWriter
from hil.service import logs
from hil.service.api.control import Control
from hil.service.api.routes import make_app
from hil.service.messages import ApiConfig

_PING_S = 5.0
_LONGEST_BYTES = 64 * 1024  # of a body or a WebSocket message
_LAST_ANSWERS_S = 1

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


class Gate:
    """An ASGI application in front of another one: it refuses requests without the token or with a foreign Host header.

    It also refuses a body of more than 64 KiB before reading it.
    """

    def __init__(self, app: App, *, token: str, hosts: frozenset[bytes]) -> None:
        self._app = app
        self._authorization = f"Bearer {token}".encode()
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request or a handshake, or pass it on."""
        refusal = self._refusal(scope)
        if refusal is None:
            await self._app(scope, receive, send)
            return
        status, sentence = refusal
        body = json.dumps({"detail": sentence}).encode()
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
        if status == 401:
            headers.append((b"www-authenticate", b"Bearer"))
        if status == 413:
            headers.append((b"connection", b"close"))  # the body was not read
        kind = "websocket.http.response" if scope["type"] == "websocket" else "http.response"
        await send({"type": f"{kind}.start", "status": status, "headers": headers})
        await send({"type": f"{kind}.body", "body": body})

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers: list[tuple[bytes, bytes]] = scope["headers"]
        if [value for name, value in headers if name == b"host"] not in [[host] for host in self._hosts]:
            hosts = " or ".join(sorted(host.decode() for host in self._hosts))
            return 421, f"this service answers for {hosts} only, and the Host header names another"
        shown = [value for name, value in headers if name == b"authorization"]
        if len(shown) != 1 or not secrets.compare_digest(shown[0], self._authorization):
            return 401, "the header 'Authorization: Bearer TOKEN' with the token of this start is missing or wrong"
        return _too_long(headers) if scope["type"] == "http" else None


def _too_long(headers: list[tuple[bytes, bytes]]) -> tuple[int, str] | None:
    if any(name == b"transfer-encoding" for name, _ in headers):
        return 411, "send the body with a Content-Length"
    # The server has checked that it is a number.
    length = int(next((value for name, value in headers if name == b"content-length"), b"0"))
    if length > _LONGEST_BYTES:
        return 413, f"a body of {length} bytes is too long; expected at most {_LONGEST_BYTES}"
    return None


class _Server(uvicorn.Server):
    """Uvicorn, which tells the control process when it listens."""

    def __init__(self, config: uvicorn.Config, writer: LineWriter, ready: dict[str, str]) -> None:
        super().__init__(config)
        self._writer = writer
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._writer.send({"ready": self._ready})


async def serve(
    config: ApiConfig, listener: socket.socket, token: str, lines: LineReader, writer: LineWriter, ready: dict[str, str]
) -> None:
    """Serve the API on a listening socket until the control process has ended or this process gets a signal.

    ``token`` is the one that clients must send; ``ready`` is sent to the control process when the server listens.
    """
    control = Control(lines, writer, config.limits.twist_timeout_s)
    living = asyncio.create_task(control.live())
    port = listener.getsockname()[1]
    hosts = frozenset(f"{name}:{port}".encode() for name in (config.host, "localhost"))
    server = _Server(
        uvicorn.Config(
            Gate(make_app(config, control), token=token, hosts=hosts),
            http="h11",
            ws="websockets-sansio",
            loop="asyncio",
            lifespan="off",
            ws_ping_interval=_PING_S,
            ws_ping_timeout=_PING_S,
            ws_max_size=_LONGEST_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=_LAST_ANSWERS_S,
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
        ),
        writer,
        ready,
    )
    serving = asyncio.create_task(server.serve([listener]))
    gone = asyncio.create_task(control.gone.wait())
    await asyncio.wait((serving, gone), return_when=asyncio.FIRST_COMPLETED)
    server.should_exit = True
    await serving
    gone.cancel()
    living.cancel()
    logs.info("API ends")
