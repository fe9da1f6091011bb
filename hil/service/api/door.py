"""The connections of the API: how many there may be, for how long each may keep the server waiting, and who goes first.

A connection is in one of three rooms. Each has a limit of connections, beyond which the oldest is dropped, and of time.
So clients that open connections and send nothing, or half a header, take room from each other, and never from a client
whose requests have the token. A WebSocket is in a room until its handshake is answered; those that are accepted are
limited by ``server.Gate``. While one is closed, a fourth room gives it 10 s to send what is unsent.
"""

import asyncio
import contextlib
import math
import socket
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, cast

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from hil.service import logs
from hil.service.api.access import Headers

BATCH = 64
"""Connections accepted in one turn of the event loop; a new one is read two turns later, while it is still young."""

_FILES = 704  # the rooms, 64 WebSockets, and what the process itself has open
_SWEEP_S = 0.25
_UNSENT_BYTES = 64 * 1024  # for each WebSocket, in the kernel's send buffer
_SAY_S = 10.0


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


class _Room:
    """Connections by the time at which they came in, oldest first."""

    def __init__(self, most: int, limit_s: float) -> None:
        self.most = most
        self.limit_s = limit_s
        self.since_s: dict[Guest, float] = {}

    def oldest(self) -> "Guest":
        return next(iter(self.since_s))

    def overdue(self, now_s: float) -> list["Guest"]:
        return [one for one, since_s in self.since_s.items() if now_s - since_s > self.limit_s]


class Door:
    """Holds the connections of one server, in rooms that this process's limit of file descriptors has space for.

    ``is_known`` returns whether a request's headers have a valid token.

    Attributes:
        dropped: number of connections by cause: ``late``, ``crowded``, ``not_accepted``, and ``unknown``: no token.
    """

    def __init__(self, is_known: Callable[[Headers], bool]) -> None:
        self.is_known = is_known
        self.dropped: Counter[str] = Counter()
        share = min(1.0, _most_files() / _FILES)
        # Far more than a batch or two, so that none is dropped before its first bytes were looked at.
        self._strangers = _Room(round(256 * share), 2.0)
        # Those that have shown a token, and send their next request or rest.
        self._guests = _Room(round(128 * share), 10.0)
        # Longer than the longest order takes; beyond it a client does not read.
        self._served = _Room(round(128 * share), 40.0)
        # WebSockets that are being closed: uvicorn waits for ever for a client that does not read what is unsent.
        self._closing = _Room(round(64 * share), 10.0)
        self._let_in = _Room(_FILES, math.inf)
        self._rooms = (self._strangers, self._guests, self._served, self._closing, self._let_in)
        self._said: Counter[str] = Counter()
        self._say_s = 0.0

    def protocols(self) -> tuple[type[H11Protocol], type[WebSocketsSansIOProtocol]]:
        """Return the protocols for uvicorn, HTTP and WebSocket, whose connections go through this door."""
        own = {"door": self}
        return type("Connection", (Connection,), own), type("Handshake", (Handshake,), own)

    def enter(self, connection: "Guest", *, is_served: bool) -> None:
        """Put a connection into the room for its state; drop the oldest of a full room. One that is there stays."""
        room = self._strangers if not connection.is_known else self._served if is_served else self._guests
        if connection not in room.since_s:
            self._put(connection, room)

    def _put(self, connection: "Guest", room: _Room) -> None:
        self.leave(connection)
        if len(room.since_s) >= room.most:
            self._drop(room.oldest(), "crowded")
        room.since_s[connection] = time.monotonic()

    def let_in(self, connection: "Handshake") -> None:
        """Take a WebSocket whose handshake is answered out of its room: it has no limit of time until it is closed."""
        self._put(connection, self._let_in)

    def leave(self, connection: "Guest") -> None:
        """Forget a connection that has ended or changes its room."""
        for room in self._rooms:
            room.since_s.pop(connection, None)

    async def sweep(self) -> None:
        """Drop connections that are overdue, and log how many were dropped, until cancelled."""
        asyncio.get_running_loop().set_exception_handler(self._on_exception)
        while True:
            await asyncio.sleep(_SWEEP_S)
            now_s = time.monotonic()
            for ending in [one for one in self._let_in.since_s if one.transport.is_closing()]:
                self._put(ending, self._closing)
            for room in self._rooms:
                for connection in room.overdue(now_s):
                    self._drop(connection, "late")
            if self.dropped != self._said and now_s >= self._say_s:
                logs.warning("connections dropped", **self.dropped - self._said)
                self._said, self._say_s = self.dropped.copy(), now_s + _SAY_S

    def _drop(self, connection: "Guest", cause: str) -> None:
        self.leave(connection)
        self.dropped[cause] += 1
        connection.transport.abort()  # at once, whatever is unsent

    def _on_exception(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Count a connection that could not be accepted, for want of descriptors; asyncio tries again in a second."""
        if isinstance(context.get("exception"), OSError) and "socket" in context:
            self.dropped["not_accepted"] += 1
        else:
            loop.default_exception_handler(context)


class Connection(H11Protocol):
    """A connection of uvicorn that tells the door when it waits for a request, and when one is being answered."""

    door: Door
    is_known = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to wait for the first request."""
        super().connection_made(transport)
        self.door.enter(self, is_served=False)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.door.leave(self)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        """Handle what has arrived; a request that is whole is no longer waited for."""
        before = self.cycle
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            if self.cycle is not before:
                self.is_known = self.door.is_known(self.headers)
            self.door.enter(self, is_served=not self.cycle.more_body)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection over to a WebSocket, which waits for the end of its handshake."""
        self.door.leave(self)
        super().handle_websocket_upgrade(event)
        handshake = cast(Handshake, self.transport.get_protocol())
        handshake.is_known = self.door.is_known(self.headers)
        self.door.enter(handshake, is_served=True)

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        self.door.enter(self, is_served=False)
        super().on_response_complete()


class Handshake(WebSocketsSansIOProtocol):
    """A WebSocket of uvicorn that tells the door when its handshake is answered; uvicorn answers some of them never."""

    door: Door
    is_known = False
    is_answered = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin with a small send buffer in the kernel: what waits there grows old, and no newer status can pass it."""
        super().connection_made(transport)
        with contextlib.suppress(OSError):  # it has gone already
            transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNSENT_BYTES)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self.door.leave(self)
        super().connection_lost(exc)

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
            self.door.let_in(self)


Guest = Connection | Handshake
