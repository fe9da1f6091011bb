"""``hil live``: a viewer that shows the run under way, and the next one when that begins.

A run serves its rows on a port of this machine while it lasts (``hil.record.live``). Neither rerun's viewer nor its
page reconnects by itself: it is told here, each time that the port answers anew.
"""

import contextlib
import json
import socket
import subprocess
import threading
import time
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from hil.core.errors import BadInputError, DeviceError
from hil.record.view import (
    HOST,
    free_port,
    has_display,
    live_address,
    viewer_command,
    viewer_environment,
    wait_until_listening,
    web_address,
)

_LOOK_S = 0.25
_PAGE = Path(__file__).with_name("live_page.html")


def live(port: int, *, web: bool, say: Callable[[str], None]) -> None:
    """Show the run that is served on a port, and each one after it, until the viewer is closed or Ctrl-C.

    Raises:
        BadInputError: there is no display for the native viewer.
        DeviceError: the viewer was not found, did not start, or ended with an error.
    """
    with contextlib.suppress(KeyboardInterrupt):  # the way to end it
        if web:
            _live_in_browser(port, say)
        elif has_display():
            _live_in_window(port, say)
        else:
            raise BadInputError("no display to open the viewer on; use 'hil live --web' and a browser")


def follow(port: int, *, found: Callable[[], None], going_on: Callable[[], bool]) -> None:
    """Call ``found`` whenever something begins to listen on the port, for as long as ``going_on``."""
    listened = False
    while going_on():
        listens = _listens(port)
        if listens and not listened:
            found()
        listened = listens
        time.sleep(_LOOK_S)


class Window:
    """A native viewer, listening on ``port``, that is told what to show."""

    def __init__(self, port: int) -> None:
        from rerun.experimental import ViewerClient

        self._client = ViewerClient.connect(live_address(port))

    def show(self, run_port: int) -> None:
        """Show the run on this port, in place of the one that was there before. Raises DeviceError."""
        address = live_address(run_port)
        # A run that the viewer has from the same address would be shown again instead of the new one.
        with contextlib.suppress(RuntimeError, ConnectionError):
            self._client.close(address)
        try:
            self._client.open(address)
        except (RuntimeError, ConnectionError) as error:
            raise DeviceError(f"the rerun viewer does not open {address}: {error}") from error


def _live_in_window(port: int, say: Callable[[str], None]) -> None:
    viewer_port = free_port()
    command = viewer_command("--hide-welcome-screen", "--port", str(viewer_port))
    viewer = subprocess.Popen(command, env=viewer_environment())
    try:
        wait_until_listening(viewer, viewer_port)
        window = Window(viewer_port)
        say(_waiting(port))
        follow(port, found=lambda: window.show(port), going_on=lambda: viewer.poll() is None)
        if viewer.returncode != 0:
            raise DeviceError(f"the rerun viewer ended with exit status {viewer.returncode}; try 'hil live --web'")
    finally:
        viewer.terminate()
        viewer.wait()


def _live_in_browser(port: int, say: Callable[[str], None]) -> None:
    data_port, viewer_port = free_port(), free_port()
    ports = ["--port", str(data_port), "--web-viewer-port", str(viewer_port)]
    viewer = subprocess.Popen(viewer_command("--serve-web", *ports), env=viewer_environment())
    try:
        wait_until_listening(viewer, viewer_port)
        with _Page(port, web_address(viewer_port, live_address(port))) as page:
            say(f"{_waiting(port)}; open {page.address} until Ctrl-C")
            follow(port, found=page.next_run, going_on=lambda: viewer.poll() is None)
        raise DeviceError(f"the rerun viewer ended with exit status {viewer.returncode}")
    finally:
        viewer.terminate()
        viewer.wait()


class _Page:
    """Serves the page that holds rerun's and loads it anew for each run; a context manager."""

    def __init__(self, port: int, viewer_address: str) -> None:
        self._runs = 0
        self._told = {"address": viewer_address, "note": _waiting(port)}
        page = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.partition("?")[0]
                if path == "/":
                    self._answer("text/html; charset=utf-8", _PAGE.read_bytes())
                elif path == "/run":
                    self._answer("application/json", json.dumps({"number": page._runs, **page._told}).encode())
                else:
                    self.send_error(HTTPStatus.NOT_FOUND)

            def _answer(self, kind: str, content: bytes) -> None:
                self.send_response(HTTPStatus.OK)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(content)))
                self.end_headers()
                self.wfile.write(content)

            def log_message(self, *_: object) -> None:
                """Say nothing of requests."""

        self._server = ThreadingHTTPServer((HOST, 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        return f"http://{HOST}:{self._server.server_port}/"

    def next_run(self) -> None:
        """Have the page load the viewer anew."""
        self._runs += 1

    def __enter__(self) -> "_Page":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _waiting(port: int) -> str:
    return (
        f"shows each run and service on port {port} of this machine, such as "
        f"'hil run SCENARIO --live --live-port {port}' or 'hil serve CONFIG --live --live-port {port}'"
    )


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0
