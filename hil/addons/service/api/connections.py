"""The connections of the API: how many there may be, how long each may stay idle, and how fast a WebSocket may send.

uvicorn limits none of this. Each connection is in one pool, by whether it has shown a valid token and by its state. A
pool has a limit of connections, beyond which the oldest is dropped, and of time. So clients without a token, which open
connections and send nothing or half a header, take places from each other, never from a client with a token.

A WebSocket's frames, of every kind, are counted before they are handled: 64 KiB of pings would keep all others waiting.
One that sends faster than its rates is closed (1008).
"""

import asyncio
import contextlib
import math
import socket
import sys
import time
from collections import Counter
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode

from hil.addons.service import logs
from hil.addons.service.api.access import Access
from hil.addons.service.logs import Rate

BATCH = 64
"""Connections accepted in one turn of the event loop; a new one is read two turns later, while it is still young."""

_FILES = 704  # the pools, 64 WebSockets, and what the process itself has open
_SWEEP_S = 0.25
_UNSENT_BYTES = 64 * 1024  # for each WebSocket, in the kernel's send buffer
_LOG_PERIOD_S = 10.0
_PIECE_BYTES = 512  # at most 85 frames, so only a few above the limit are parsed
_MOST_FRAGMENTS = 64  # of a message; an empty one counts for no byte

FRAMES_PER_S = 300.0
"""Frames of one WebSocket, of any kind; twice as many after a pause. A token may give 200 orders a second."""

BYTES_PER_S = 256.0 * 1024
"""Bytes of one WebSocket; twice as many after a pause."""


def _most_files() -> float:
    """Return how many files this process may have open; take what it may take at most, up to ``_FILES``."""
    if sys.platform == "win32":
        return _FILES
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft < _FILES:
        soft = min(_FILES, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    return soft


class _Pool:
    """Connections by the time at which they came in, oldest first."""

    def __init__(self, most: int, limit_s: float) -> None:
        self.most = most
        self.limit_s = limit_s
        self.since_s: dict[AnyConnection, float] = {}

    def oldest(self) -> "AnyConnection":
        return next(iter(self.since_s))

    def overdue(self, now_s: float) -> list["AnyConnection"]:
        return [one for one, since_s in self.since_s.items() if now_s - since_s > self.limit_s]


class ConnectionPools:
    """Holds the connections of one server, in pools that this process's limit of file descriptors has space for.

    ``access`` knows the tokens.

    Attributes:
        dropped: number of connections by cause: ``late``, ``crowded``, ``flood`` (a WebSocket that sent too fast),
            ``not_accepted``, and ``unknown``: no valid token.
    """

    def __init__(self, access: Access) -> None:
        self.access = access
        self.dropped: Counter[str] = Counter()
        share = min(1.0, _most_files() / _FILES)
        # Far more than a batch or two, so that none is dropped before its first bytes were looked at.
        self._unauthenticated = _Pool(round(256 * share), 2.0)
        # Those that have shown a token, and send their next request or rest.
        self._idle = _Pool(round(128 * share), 10.0)
        # Longer than the longest order takes; beyond it a client does not read.
        self._busy = _Pool(round(128 * share), 40.0)
        # WebSockets that are being closed: uvicorn waits for ever for a client that does not read the rest.
        self._closing = _Pool(round(64 * share), 10.0)
        self._open = _Pool(_FILES, math.inf)
        self._pools = (self._unauthenticated, self._idle, self._busy, self._closing, self._open)
        self._logged: Counter[str] = Counter()
        self._log_due_s = 0.0

    def protocols(self) -> tuple[type[H11Protocol], type[WebSocketsSansIOProtocol]]:
        """Return the protocols for uvicorn, HTTP and WebSocket, whose connections are kept here."""
        own = {"pools": self}
        return type("Http", (HttpConnection,), own), type("WebSocket", (WebSocketConnection,), own)

    def place(self, connection: "AnyConnection", *, in_request: bool) -> None:
        """Put a connection into the pool for its state; drop the oldest of a full pool. One that is there stays."""
        pool = self._unauthenticated if not connection.is_known else self._busy if in_request else self._idle
        if connection not in pool.since_s:
            self._put(connection, pool)

    def _put(self, connection: "AnyConnection", pool: _Pool) -> None:
        self.remove(connection)
        if len(pool.since_s) >= pool.most:
            self._drop(pool.oldest(), "crowded")
        pool.since_s[connection] = time.monotonic()

    def opened(self, connection: "WebSocketConnection") -> None:
        """Take a WebSocket whose handshake is answered out of its pool: it has no limit of time until it is closed."""
        self._put(connection, self._open)

    def remove(self, connection: "AnyConnection") -> None:
        """Forget a connection that has ended or changes its pool."""
        for pool in self._pools:
            pool.since_s.pop(connection, None)

    async def sweep(self) -> None:
        """Drop connections that are overdue, and log how many were dropped, until cancelled."""
        asyncio.get_running_loop().set_exception_handler(self._on_exception)
        while True:
            await asyncio.sleep(_SWEEP_S)
            now_s = time.monotonic()
            for ending in [one for one in self._open.since_s if one.transport.is_closing()]:
                self._put(ending, self._closing)
            for pool in self._pools:
                for connection in pool.overdue(now_s):
                    self._drop(connection, "late")
            if self.dropped != self._logged and now_s >= self._log_due_s:
                logs.warning("connections dropped", **self.dropped - self._logged)
                self._logged, self._log_due_s = self.dropped.copy(), now_s + _LOG_PERIOD_S

    def _drop(self, connection: "AnyConnection", cause: str) -> None:
        self.remove(connection)
        self.dropped[cause] += 1
        connection.transport.abort()  # at once, whatever is unsent

    def _on_exception(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Count a connection that could not be accepted, for want of descriptors; asyncio tries again in a second."""
        if isinstance(context.get("exception"), OSError) and "socket" in context:
            self.dropped["not_accepted"] += 1
        else:
            loop.default_exception_handler(context)


class HttpConnection(H11Protocol):
    """A connection of uvicorn that informs the pools when it waits for a request, and when one is being answered."""

    pools: ConnectionPools
    is_known = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self.pools.place(self, in_request=False)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.pools.remove(self)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Handle received events; a complete request moves the connection to the busy pool."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            if self.cycle is not before:
                self.is_known = self.pools.access.client(self.headers) is not None
            self.pools.place(self, in_request=not self.cycle.more_body)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to a WebSocket, which waits for the end of its handshake."""
        self.pools.remove(self)
        super().handle_websocket_upgrade(event)
        handshake = cast(WebSocketConnection, self.transport.get_protocol())
        if (client := self.pools.access.client(self.headers)) is not None:
            handshake.know(self.pools.access.rates(client).frames)
        self.pools.place(handshake, in_request=True)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self.pools.place(self, in_request=False)
        super().on_response_complete()


class WebSocketConnection(WebSocketsSansIOProtocol):
    """A WebSocket of uvicorn that informs the pools when its handshake is answered, and limits its input.

    uvicorn never answers some handshakes.
    """

    pools: ConnectionPools
    is_known = False
    is_answered = False
    _frames: tuple[Rate, ...] = ()

    def know(self, of_token: Rate) -> None:
        """Count the frames of a client with a token from here on: its own, and those of all with the same token."""
        self.is_known = True
        self._frames = (Rate(FRAMES_PER_S, 2 * FRAMES_PER_S), of_token)
        self._bytes = Rate(BYTES_PER_S, 2 * BYTES_PER_S)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin with a small send buffer in the kernel: what waits there grows old, and no newer status can pass it."""
        super().connection_made(transport)
        with contextlib.suppress(OSError):  # it has gone already
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.pools.remove(self)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Handle received bytes in small pieces, while they are within the rates."""
        if self._frames and not self._bytes.take(len(data)):
            self._close_flood(f"more than {BYTES_PER_S:g} bytes a second")
        for start in range(0, len(data), _PIECE_BYTES):
            if self.close_sent or self.transport.is_closing():
                return
            super().data_received(data[start : start + _PIECE_BYTES])

    def handle_events(self) -> None:
        """Handle frames of all kinds, unless there were too many."""
        if len(self.frames) > _MOST_FRAGMENTS:
            self._close_flood(f"a message in more than {_MOST_FRAGMENTS} fragments")
        elif all(rate.take(len(self.conn.events)) for rate in self._frames):
            super().handle_events()
        else:
            self._close_flood(f"more than {FRAMES_PER_S:g} frames a second")

    def _close_flood(self, why: str) -> None:
        self.pools.dropped["flood"] += 1
        self.stop_keepalive()
        self.conn.fail(CloseCode.POLICY_VIOLATION, f"{why}; pings count too")
        self.transport.write(b"".join(self.conn.data_to_send()))
        self.close_sent = True
        self.queue.put_nowait({"type": "websocket.disconnect", "code": CloseCode.POLICY_VIOLATION, "reason": why})
        self.transport.close()

    def shutdown(self) -> None:
        """Close as the server ends. What is being closed already is aborted: uvicorn raises on a second close."""
        if self.transport.is_closing():
            self.transport.abort()
        else:
            super().shutdown()

    async def send(self, message: Any) -> None:
        """Send what the application says; after its first answer nothing is waited for. Raises ClientDisconnected."""
        if self.close_sent:  # the client has answered no ping; to uvicorn it is an error to send to it now
            raise ClientDisconnected
        await super().send(message)
        if not self.is_answered and (self.handshake_complete or self.close_sent):
            self.is_answered = self.handshake_complete = True  # of a refusal too, which uvicorn takes for no answer
            self.pools.opened(self)


AnyConnection = HttpConnection | WebSocketConnection
