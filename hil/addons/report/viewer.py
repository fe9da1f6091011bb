"""Rerun's viewer: opened on a recording (``hil view``), or on the current run and each later one (``hil live``).

A run serves its rows on a port of this machine while it lasts (``hil.record.stream``). A viewer does not reconnect by
itself: ``hil live`` reconnects it each time a program begins to listen on the port.
"""

import contextlib
import importlib.metadata
import importlib.util
import os
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection, HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

from hil.core.errors import BadInputError, DeviceError
from hil.core.findings import Finding, note, ok, problem
from hil.core.printable import command
from hil.core.subprocesses import LifeLine
from hil.record.files import check_is_recording

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
_COPY_BYTES = 1 << 16
_PAGE_TIMEOUT_S = 30.0
_START_TIMEOUT_S = 60.0
_LOOK_S = 0.25


def view(path: Path, *, web: bool, say: Callable[[str], None] = print) -> None:
    """Show a recording until the viewer is closed, or, in a browser, until Ctrl-C.

    Raises:
        BadInputError: the file is not a recording, or there is no display for the native viewer.
        DeviceError: the viewer was not found, did not start, or ended with an error.
    """
    check_is_recording(path)
    if not web and not has_display():
        raise BadInputError(f"no display to show {path} on; use {_on_the_web(path)} and a browser")
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C is the normal end
        if web:
            with _web_viewer(str(path)) as (viewer, data_port, page_port):
                say(f"showing {path} at {_web_address(page_port, live_address(data_port))} until Ctrl-C")
                viewer.wait()
        else:
            port = free_port()
            with _listening_viewer(port, "--port", str(port), str(path)) as viewer:
                Window(port).point_at_violation(is_open=lambda: viewer.poll() is None)
                viewer.wait()
        _check_ended(viewer, "" if web else f"; try {_on_the_web(path)}")


def live(port: int, *, web: bool, say: Callable[[str], None]) -> None:
    """Show the run that is served on a port, and each later one, until the viewer is closed or Ctrl-C.

    Raises:
        BadInputError: there is no display for the native viewer.
        DeviceError: the viewer was not found, did not start, or ended with an error.
    """
    if not web and not has_display():
        raise BadInputError("no display to open the viewer on; use 'hil live --web' and a browser")
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C is the normal end
        (_live_in_browser if web else _live_in_window)(port, say)


def on_each_run(port: int, *, found: Callable[[], None], is_watching: Callable[[], bool]) -> None:
    """Call ``found`` each time a program begins to listen on the port, until ``is_watching`` returns False."""
    listened = False
    while is_watching():
        listens = _listens(port)
        if listens and not listened:
            found()
        listened = listens
        time.sleep(_LOOK_S)


def live_address(port: int) -> str:
    """Return the address at which a run serves live viewers on this machine."""
    return f"rerun+http://{HOST}:{port}/proxy"


def show_live(port: int) -> bool:
    """Open a native viewer on the current run; False when there is no display or no viewer. Registered as ``window``.

    The viewer stays open after the run, with the data that it received.
    """
    if not has_display():
        return False
    try:
        command = viewer_command("--port", "auto", live_address(port))
    except DeviceError:
        return False
    subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=viewer_environment(),
        start_new_session=sys.platform != "win32",
    )
    return True


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform in ("win32", "darwin") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _on_the_web(path: Path) -> str:
    return command("hil", "view", path, "--web")


def viewer_executable() -> Path:
    """Return the path of the viewer that came with rerun-sdk, or else of a ``rerun`` on the search path.

    Raises DeviceError when there is neither.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    package = importlib.util.find_spec("rerun_cli")
    for directory in (package.submodule_search_locations or []) if package else []:
        bundled = Path(directory) / name
        if bundled.is_file():
            return bundled
    found = shutil.which("rerun")
    if found is None:
        raise DeviceError("the rerun viewer was not found: install it with 'pip install rerun-sdk==0.41.*'")
    return Path(found)


def viewer_command(*options: str) -> list[str]:
    """Return the command of a viewer that listens on this machine only. Raises DeviceError when there is no viewer."""
    return [str(viewer_executable()), "--bind", HOST, *options]


def viewer_environment() -> dict[str, str]:
    """Return the environment of a viewer: this process's, with a log of errors only, and without calls elsewhere.

    rerun counts its use unless it runs in continuous integration (``CI`` is set). At each start it looks for a newer
    version by HTTPS; a proxy that does not exist prevents that.
    """
    nowhere = dict.fromkeys(("HTTPS_PROXY", "https_proxy"), f"http://{HOST}:9")
    return {**os.environ, "RUST_LOG": "error", "CI": "1", **nowhere}


def free_port() -> int:
    """Return a port of this machine that nothing listens on at the moment."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def wait_until_listening(process: "subprocess.Popen[bytes]", port: int) -> None:
    """Return once something listens on the port; raises DeviceError when the process ends or is too slow."""
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        if _listens(port):
            return
        if process.poll() is not None:
            raise DeviceError(f"the rerun viewer did not start: exit status {process.returncode}")
        time.sleep(0.05)
    raise DeviceError(f"the rerun viewer does not listen on port {port} after {_START_TIMEOUT_S:g} s")


class Window:
    """Controls a native viewer that listens on ``port``."""

    def __init__(self, port: int) -> None:
        from rerun.experimental import ViewerClient

        self._client = ViewerClient.connect(live_address(port))

    def show(self, run_port: int) -> None:
        """Show the run on this port in place of the last one. Raises DeviceError when the viewer does not."""
        address = live_address(run_port)
        # Otherwise the viewer would show the old run from the same address, not the new one.
        with contextlib.suppress(RuntimeError, ConnectionError):
            self._client.close(address)
        try:
            self._client.open(address)
        except (RuntimeError, ConnectionError) as error:
            raise DeviceError(f"the rerun viewer does not open {address}: {error}") from error

    def point_at_violation(self, *, is_open: Callable[[], bool]) -> None:
        """Put the time cursor on the first violation, if the recording that the viewer opens has one.

        A layout cannot say where the cursor is; ours selects the range of time of the violation. Returns once the
        recording is loaded, or the viewer is no longer open.
        """
        while is_open():
            with contextlib.suppress(RuntimeError, ConnectionError):  # not ready, or gone
                state = self._client.get_state()
                if state.recordings and not state.loading:
                    shown = self._client.get_blueprint().blueprint
                    selected = shown.get("/time_panel", {}).get("TimePanelBlueprint", {}).get("time_selection")
                    if selected is not None:
                        self._client.set_time("t", duration=selected["min"] / 1e9, play_state="paused")
                    return
            time.sleep(_LOOK_S)


def _check_ended(viewer: "subprocess.Popen[bytes]", remedy: str) -> None:
    """Raise DeviceError when a viewer that has ended did so with an error."""
    if viewer.returncode != 0:
        raise DeviceError(f"the rerun viewer ended with exit status {viewer.returncode}{remedy}")


@contextlib.contextmanager
def _listening_viewer(port: int, *options: str) -> Iterator["subprocess.Popen[bytes]"]:
    """Start a viewer, yield it once it listens on the port, and end it; it ends too when this process is killed."""
    viewer = LifeLine().start_program(viewer_command(*options), env=viewer_environment())
    try:
        wait_until_listening(viewer, port)
        yield viewer
    finally:
        viewer.terminate()
        viewer.wait()


@contextlib.contextmanager
def _guarded(page_port: int) -> Iterator[int]:
    """Serve rerun's page, which listens on ``page_port``, with ``NOTHING_ELSEWHERE``; yields the port to open."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                with contextlib.closing(HTTPConnection(HOST, page_port, timeout=_PAGE_TIMEOUT_S)) as connection:
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

        def log_message(self, *_: object) -> None:
            """Log no requests."""

    with ThreadingHTTPServer((HOST, 0), Handler) as server:
        threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
        try:
            yield server.server_port
        finally:
            server.shutdown()


@contextlib.contextmanager
def _web_viewer(*sources: str) -> Iterator[tuple["subprocess.Popen[bytes]", int, int]]:
    """Serve rerun's web page; yields the process, the port of the data and the port of the page."""
    data_port, page_port = free_port(), free_port()
    ports = ("--port", str(data_port), "--web-viewer-port", str(page_port))
    with _listening_viewer(page_port, "--serve-web", *ports, *sources) as viewer, _guarded(page_port) as guarded_port:
        yield viewer, data_port, guarded_port


def _web_address(port: int, source: str) -> str:
    """Return the URL of rerun's page, served on ``port``, that shows the data at ``source``."""
    return f"http://{HOST}:{port}/?url={quote(source, safe='')}"


def _live_in_window(port: int, say: Callable[[str], None]) -> None:
    viewer_port = free_port()
    with _listening_viewer(viewer_port, "--hide-welcome-screen", "--port", str(viewer_port)) as viewer:
        window = Window(viewer_port)
        say(_waiting(port))
        on_each_run(port, found=lambda: window.show(port), is_watching=lambda: viewer.poll() is None)
        _check_ended(viewer, "; try 'hil live --web'")


def _live_in_browser(port: int, say: Callable[[str], None]) -> None:
    with _web_viewer() as (viewer, _, page_port):
        address = _web_address(page_port, live_address(port))
        say(f"{_waiting(port)}; open {address} and reload it for each run, until Ctrl-C")
        viewer.wait()
        raise DeviceError(f"the rerun viewer ended with exit status {viewer.returncode}")


def _waiting(port: int) -> str:
    return (
        f"shows each run and service on port {port} of this machine, such as "
        f"'hil run SCENARIO --live --live-port {port}' or 'hil serve CONFIG --live --live-port {port}'"
    )


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0


_VERSION_TIMEOUT_S = 10.0


def check_viewer() -> Iterator[Finding]:
    """Yield the viewer's version compared with the SDK's, and whether there is a display.

    A check of ``hil doctor``, registered as ``viewer``.
    """
    yield _viewer_version()
    if not has_display():
        yield note("display", "none, so that no window can be opened", "use hil view RUN.rrd --web and a browser")


def _viewer_version() -> Finding:
    try:
        sdk = importlib.metadata.version("rerun-sdk")
    except importlib.metadata.PackageNotFoundError:
        return note("viewer", "rerun-sdk is not installed", "pip install rerun-sdk, or record with --record run.mcap")
    remedy = f"pip install --force-reinstall rerun-sdk=={sdk}"
    try:
        executable = viewer_executable()
        output = subprocess.run(
            [str(executable), "--version"],
            capture_output=True,
            text=True,
            check=True,
            timeout=_VERSION_TIMEOUT_S,
            env=viewer_environment(),
        ).stdout
    except (DeviceError, OSError, subprocess.SubprocessError) as error:
        return problem("viewer", f"rerun's viewer does not run: {error}", remedy)
    found = re.search(r"\d+\.\d+\.\d+", output)
    version = found.group() if found else output.strip()
    if version == sdk:
        return ok("viewer", f"rerun {version}, as the SDK")
    sentence = f"{executable} is rerun {version}, the SDK that records is {sdk}: it may not read the recordings"
    return problem("viewer", sentence, remedy)
