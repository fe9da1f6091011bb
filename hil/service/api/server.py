"""The server of the API: one process, one event loop, one socket, and a gate in front of the application.

The server listens on the loopback address only. A web page can reach that too. If it uses its own host name that points
to 127.0.0.1 (DNS rebinding), the Host header shows it; otherwise the token stops it. There is no CORS.
"""

import asyncio
import secrets
import socket

import uvicorn
from fastapi.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from hil.core.json_lines import LineReader, LineWriter
from hil.service import logs
from hil.service.api.control import Control
from hil.service.api.routes import make_app
from hil.service.messages import HOST, ApiConfig

_PING_S = 5.0
_LONGEST_BYTES = 64 * 1024  # of a body or a WebSocket message
_LAST_ANSWERS_S = 1


class Gate:
    """An ASGI application in front of another one: it refuses requests without the token or with a foreign Host header.

    It also refuses a body of more than 64 KiB before reading it.
    """

    def __init__(self, app: ASGIApp, *, token: str, hosts: frozenset[bytes]) -> None:
        self._app = app
        self._authorization = f"Bearer {token}".encode()
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request or a handshake, or pass it on."""
        await (self._refusal(scope) or self._app)(scope, receive, send)

    def _refusal(self, scope: Scope) -> JSONResponse | None:
        def values_of(header: bytes) -> list[bytes]:
            return [value for name, value in scope["headers"] if name == header]

        if values_of(b"host") not in [[host] for host in self._hosts]:
            hosts = " or ".join(sorted(host.decode() for host in self._hosts))
            return _refuse(421, f"this service answers for {hosts} only, and the Host header names another")
        shown = values_of(b"authorization")
        if len(shown) != 1 or not secrets.compare_digest(shown[0], self._authorization):
            sentence = "the header 'Authorization: Bearer TOKEN' with the token of this start is missing or wrong"
            return _refuse(401, sentence, {"www-authenticate": "Bearer"})
        if scope["type"] != "http":
            return None
        if values_of(b"transfer-encoding"):
            return _refuse(411, "send the body with a Content-Length")
        length = int((values_of(b"content-length") or [b"0"])[0])  # the server has checked that it is a number
        if length > _LONGEST_BYTES:
            sentence = f"a body of {length} bytes is too long; expected at most {_LONGEST_BYTES}"
            return _refuse(413, sentence, {"connection": "close"})  # the body was not read
        return None


def _refuse(status: int, sentence: str, headers: dict[str, str] | None = None) -> JSONResponse:
    return JSONResponse({"detail": sentence}, status, headers)


async def serve(
    config: ApiConfig, listener: socket.socket, token: str, lines: LineReader, writer: LineWriter, ready: dict[str, str]
) -> None:
    """Serve the API on a listening socket until the control process has ended or this process gets a signal.

    ``token`` is the one that clients must send; ``ready`` is sent to the control process when the server listens.
    """
    control = Control(lines, writer, config.limits.twist_timeout_s)
    port = listener.getsockname()[1]
    hosts = frozenset(f"{name}:{port}".encode() for name in (HOST, "localhost"))

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            writer.send({"ready": ready})

    server = Server(
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
        )
    )

    async def end() -> None:
        await control.gone.wait()
        server.should_exit = True

    beside = [asyncio.create_task(task) for task in (control.live(), end())]
    await server.serve([listener])
    for task in beside:
        task.cancel()
    logs.info("API ends")
