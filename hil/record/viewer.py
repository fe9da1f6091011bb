"""Rerun's viewer: opened on a recording (``hil view``), or on the current run and each later one (``hil live``).

A run serves its rows on a port of this machine while it lasts (``hil.record.stream``). Neither rerun's viewer nor its
web page reconnects by itself: ``hil live`` reconnects it each time a program begins to listen on the port.
"""

import contextlib
import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import quote

from hil.core.errors import BadInputError, DeviceError
from hil.core.printable import command
from hil.core.subprocesses import LifeLine
from hil.record.files import check_is_recording
from hil.record.web import HOST, guarded, live_page

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


def live_hint(port: int) -> str:
    """Return a sentence that tells the user how to watch the current run."""
    return f"live view: run 'hil live --port {port}' on this machine; with --web in a browser"


def show_live(port: int) -> bool:
    """Open a native viewer on the current run; False when there is no display or no viewer to open.

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

    rerun counts its use unless it runs in continuous integration, which it takes from ``CI``, and looks for a newer
    version by HTTPS at each start, which a proxy that does not exist prevents.
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
    viewer = None
    try:
        with _signals_held():
            viewer = LifeLine().start_program(viewer_command(*options), env=viewer_environment())
        wait_until_listening(viewer, port)
        yield viewer
    finally:
        if viewer is not None:
            viewer.terminate()
            viewer.wait()


@contextlib.contextmanager
def _signals_held() -> Iterator[None]:
    """Handle SIGINT, SIGTERM and SIGHUP after the block: none can part a process that starts from who ends it."""
    caught: list[int] = []
    held = {}
    if threading.current_thread() is threading.main_thread():
        for number in filter(None, (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP"))):
            if callable(handler := signal.getsignal(number)):
                held[number] = handler
                signal.signal(number, lambda number, _frame: caught.append(number))
    try:
        yield
    finally:
        for number, handler in held.items():
            signal.signal(number, handler)
    for number in caught:
        held[signal.Signals(number)](number, None)


@contextlib.contextmanager
def _web_viewer(*sources: str) -> Iterator[tuple["subprocess.Popen[bytes]", int, int]]:
    """Serve rerun's web page; yields the process, the port of the data and the port of the page."""
    data_port, page_port = free_port(), free_port()
    ports = ("--port", str(data_port), "--web-viewer-port", str(page_port))
    with _listening_viewer(page_port, "--serve-web", *ports, *sources) as viewer, guarded(page_port) as guarded_port:
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
    with (
        _web_viewer() as (viewer, _, page_port),
        live_page(_web_address(page_port, live_address(port)), _waiting(port)) as (address, next_run),
    ):
        say(f"{_waiting(port)}; open {address} until Ctrl-C")
        on_each_run(port, found=next_run, is_watching=lambda: viewer.poll() is None)
        raise DeviceError(f"the rerun viewer ended with exit status {viewer.returncode}")


def _waiting(port: int) -> str:
    return (
        f"shows each run and service on port {port} of this machine, such as "
        f"'hil run SCENARIO --live --live-port {port}' or 'hil serve CONFIG --live --live-port {port}'"
    )


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex((HOST, port)) == 0
