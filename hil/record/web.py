"""Web pages on this machine: rerun's viewer without its calls to other machines, and the page of ``hil live --web``."""

import contextlib
import itertools
import json
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

HOST = "127.0.0.1"
NOTHING_ELSEWHERE = "; ".join(
    (
        "default-src 'self'",
        "script-src 'self' blob: 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'",
        "style-src 'self' 'unsafe-inline'",
        "img-src 'self' blob: data:",
        "worker-src 'self' blob:",
        f"connect-src 'self' http://{HOST}:*",
    )
)
"""Content-Security-Policy of rerun's page: the browser asks no other machine, whatever the page wants.

Without it the page counts its use, looks for a newer version and for examples, and loads a font.
"""
_PAGE = Path(__file__).with_name("live_page.html")
_COPY_BYTES = 1 << 16
_TIMEOUT_S = 30.0


@contextlib.contextmanager
def guarded(page_port: int) -> Iterator[int]:
    """Serve rerun's page, which listens on ``page_port``, with ``NOTHING_ELSEWHERE``; yields the port to open."""

    class Handler(_Quiet):
        def do_GET(self) -> None:
            try:
                with contextlib.closing(HTTPConnection(HOST, page_port, timeout=_TIMEOUT_S)) as connection:
                    connection.request("GET", self.path)
                    answer = connection.getresponse()
                    self.send_response(answer.status)
                    for name in ("Content-Type", "Content-Length"):
                        if (value := answer.headers[name]) is not None:
                            self.send_header(name, value)
                    self.send_header("Content-Security-Policy", NOTHING_ELSEWHERE)
                    self.end_headers()
                    while piece := answer.read(_COPY_BYTES):
                        self.wfile.write(piece)
            except (OSError, HTTPException):
                self.close_connection = True  # the browser has gone, or the viewer has ended

    with _serving(Handler) as port:
        yield port


@contextlib.contextmanager
def live_page(viewer_address: str, note: str) -> Iterator[tuple[str, Callable[[], None]]]:
    """Serve a page that embeds rerun's viewer; yields its URL, and a function that makes it reload the viewer.

    ``note`` is shown until the first reload.
    """
    runs = itertools.count(1)
    state = {"number": 0, "address": viewer_address, "note": note}

    class Handler(_Quiet):
        def do_GET(self) -> None:
            answers = {
                "/": ("text/html; charset=utf-8", _PAGE.read_bytes()),
                "/run": ("application/json", json.dumps(state).encode()),
            }
            if (answer := answers.get(self.path.partition("?")[0])) is None:
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            kind, content = answer
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

    with _serving(Handler) as port:
        yield f"http://{HOST}:{port}/", lambda: state.update(number=next(runs))


class _Quiet(BaseHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Log no requests."""


@contextlib.contextmanager
def _serving(handler: type[BaseHTTPRequestHandler]) -> Iterator[int]:
    """Serve in a thread on a free port, which it yields."""
    with ThreadingHTTPServer((HOST, 0), handler) as server:
        threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
