"""Who is let in: a client on this machine, that asked for this machine, and that has the token.

The server listens on the loopback address only, which a web page reaches too: through a name of its own that it points
at 127.0.0.1 (DNS rebinding), which the Host header gives away, or blindly, which the token prevents. There is no CORS.
"""

import json
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LONGEST_BODY_BYTES = 64 * 1024


class Gate:
    """An ASGI application in front of another one: requests without the token or with a foreign Host stop here.

    A body of more than 64 KiB is refused too, before it is read.
    """

    def __init__(self, app: App, *, token: str, hosts: frozenset[bytes]) -> None:
        self._app = app
        self._authorization = f"Bearer {token}".encode()
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request or a handshake that is refused; pass on any other."""
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
            headers.append((b"connection", b"close"))  # with the body unread
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
    # That it is a number, the server has checked.
    length = int(next((value for name, value in headers if name == b"content-length"), b"0"))
    if length > LONGEST_BODY_BYTES:
        return 413, f"a body of {length} bytes is too long; expected at most {LONGEST_BODY_BYTES}"
    return None
