"""The server of the API: one process, one event loop, one socket, and a gate in front of the application.

The server listens on the loopback address only. A web page can reach that too. If it uses its own host name that points
to 127.0.0.1 (DNS rebinding), the Host header shows it; otherwise the token stops it. There is no CORS.
"""

import asyncio
import json
import socket
from collections import Counter
from collections.abc import Mapping

import uvicorn
from fastapi.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from hil.addons.service import logs
from hil.addons.service.api.access import (
    NO_TOKEN,
    OWNER,
    TOO_MANY,
    TOO_MANY_READS,
    Access,
    Client,
    Headers,
    misdirected,
    values_of,
)
from hil.addons.service.api.connections import BATCH, ConnectionPools
from hil.addons.service.api.control import Control
from hil.addons.service.api.routes import make_app
from hil.addons.service.api_process import LONGEST_QUEUE, OrderPort
from hil.addons.service.messages import ORDERS, Action

_PING_S = 5.0
_LONGEST_BYTES = 64 * 1024  # of a body or a WebSocket message
_LAST_ANSWERS_S = 1
_MOST_LIVE = 64
_MOST_LIVE_OF_ONE = 16
_TOO_MANY_STATUS = 429
_TOO_MANY_PAUSE_S = 0.1


class Gate:
    """An ASGI application in front of another one: it refuses requests without the token or with a foreign Host header.

    It also refuses a body of more than 64 KiB before reading it, and a WebSocket beyond ``_MOST_LIVE``, or beyond
    ``_MOST_LIVE_OF_ONE`` of one token that is not the service's own. Whoever is refused is disconnected: the body may
    be unread. ``dropped`` counts those without the token as ``unknown``.
    """

    def __init__(self, app: ASGIApp, access: Access, port: int, control: Control, dropped: Counter[str]) -> None:
        self._app = app
        self._dropped = dropped
        self._access = access
        self._port = port
        self._control = control
        self._live: Counter[str] = Counter()  # clients on the WebSocket, by the name of their token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request or a handshake, or pass it on."""
        client = self._access.client(scope["headers"])
        if client is not None:
            host, port = scope["client"]
            scope["state"]["client"] = client = client._replace(address=f"{host}:{port}")
        refusal = self._refusal(scope, client)
        if refusal is not None and client is not None and (action := _action(scope)) is not None:
            outcome = "too_many" if refusal.status_code == _TOO_MANY_STATUS else "invalid"
            self._control.not_sent(client, action, outcome, json.loads(bytes(refusal.body))["detail"])
        if refusal is not None and refusal.status_code == _TOO_MANY_STATUS:
            # The connection is not read meanwhile, so that a flood leaves time for other clients.
            await asyncio.sleep(_TOO_MANY_PAUSE_S)
        if refusal is not None or client is None or scope["type"] == "http":
            await (refusal or self._app)(scope, receive, send)
            return
        self._live[client.name] += 1
        try:
            await self._app(scope, receive, send)
        finally:
            self._live[client.name] -= 1

    def _refusal(self, scope: Scope, client: Client | None) -> JSONResponse | None:
        headers: Headers = scope["headers"]
        length, encoding = values_of(headers, b"content-length"), values_of(headers, b"transfer-encoding")
        if length and encoding:  # a proxy may take the one and this server the other (RFC 9112, 6.3)
            return _refuse(400, "a request has a Content-Length or a Transfer-Encoding, and this one has both")
        if (elsewhere := misdirected(headers, self._port)) is not None:
            return _refuse(421, elsewhere)
        if client is None:
            self._dropped["unknown"] += 1
            return _refuse(401, NO_TOKEN, {"www-authenticate": "Bearer"})
        if scope["type"] != "http":
            if len(self._control.watchers) >= _MOST_LIVE:
                return _refuse(503, f"{_MOST_LIVE} clients are on the WebSocket; end one of them")
            if self._live[client.name] >= _MOST_LIVE_OF_ONE and client.name != OWNER:
                return _refuse(
                    503, f"{_MOST_LIVE_OF_ONE} clients are on the WebSocket with this token; end one of them"
                )
            return None
        if encoding:
            return _refuse(411, "send the body with a Content-Length")
        size = int((length or [b"0"])[0])  # the server has checked that it is a number
        if size > _LONGEST_BYTES:
            return _refuse(413, f"a body of {size} bytes is too long; expected at most {_LONGEST_BYTES}")
        action = _action(scope)
        if action is not None and not self._access.is_in_time(client, action):
            return JSONResponse({"detail": TOO_MANY}, _TOO_MANY_STATUS, {"retry-after": "1"})
        if action is None and not self._access.may_read(client, scope["path"]):
            return JSONResponse({"detail": TOO_MANY_READS}, _TOO_MANY_STATUS, {"retry-after": "1"})
        return None


def _action(scope: Scope) -> Action | None:
    return ORDERS.get((scope.get("method", ""), scope["path"]))  # a WebSocket has no method


def _refuse(status: int, sentence: str, headers: Mapping[str, str] | None = None) -> JSONResponse:
    return JSONResponse({"detail": sentence}, status, {"connection": "close"} | dict(headers or {}))


async def serve(port: OrderPort, ready: dict[str, str]) -> None:
    """Serve the API on a port until the control process has ended or this process gets a signal.

    ``ready`` is sent to the control process when the server listens. An error of what runs beside the server ends it
    and is raised: the control process starts another.
    """
    control, access = port.control(), port.access

    class Server(uvicorn.Server):
        async def startup(self, sockets: list[socket.socket] | None = None) -> None:
            await super().startup(sockets)
            port.listener.listen(LONGEST_QUEUE)  # asyncio accepts as many in one turn as its queue is long
            port.writer.send({"ready": ready})

    pools = ConnectionPools(access)
    http, websocket = pools.protocols()
    gate = Gate(make_app(port.config, control, access, pools.dropped), access, port.number, control, pools.dropped)
    server = Server(
        uvicorn.Config(
            gate,
            http=http,
            backlog=BATCH,
            timeout_keep_alive=10,  # the pool's time for a client that has shown a token
            ws=websocket,
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

    def on_end(task: asyncio.Task[None]) -> None:
        if not task.cancelled() and task.exception() is not None:
            server.should_exit = True

    beside = [asyncio.create_task(task) for task in (*port.tasks(control), pools.sweep(), end())]
    for task in beside:
        task.add_done_callback(on_end)
    await server.serve([port.listener])
    for task in beside:
        task.cancel()
    ends = await asyncio.gather(*beside, return_exceptions=True)
    port.audit.close()
    for one in ends:
        if isinstance(one, Exception):
            logs.error("API ends because of an error", why=repr(one))
            raise one
    logs.info("API ends")
