"""Opening the rerun viewer: on a recording, or on a run under way. It listens on this machine only."""

import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

from hil.core.errors import BadInputError, DeviceError
from hil.record.files import check_is_recording

HOST = "127.0.0.1"
_START_TIMEOUT_S = 60.0


def view(path: Path, *, web: bool, say: Callable[[str], None] = print) -> None:
    """Show a recording until the viewer is closed, or, in a browser, until Ctrl-C.

    Raises:
        BadInputError: the file is no recording, or there is no display for the native viewer.
        DeviceError: the viewer was not found, or ended with an error.
    """
    check_is_recording(path)
    if web:
        _serve_web(path, say)
    elif has_display():
        _run(subprocess.Popen(viewer_command("--port", "auto", str(path)), env=viewer_environment()), path)
    else:
        raise BadInputError(f"no display to show {path} on; use 'hil view {path} --web' and a browser")


def live_address(port: int) -> str:
    """Return the address at which a run serves live viewers on this machine."""
    return f"rerun+http://{HOST}:{port}/proxy"


def web_address(port: int, source: str) -> str:
    """Return where a browser finds rerun's page, served on this port, with what the source serves."""
    return f"http://{HOST}:{port}/?url={quote(source, safe='')}"


def live_hint(port: int) -> str:
    """Return a sentence that says how to look at a run under way."""
    return f"live view: run 'hil live --port {port}' on this machine; with --web in a browser"


def show_live(port: int) -> bool:
    """Open a native viewer on a run under way; False when there is no display or no viewer to open.

    The viewer outlives the run, with what it has received.
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
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def viewer_executable() -> Path:
    """Return the viewer that came with rerun-sdk, or else a ``rerun`` on the path.

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
    """Return the command of a viewer that listens on this machine alone. Raises DeviceError when there is none."""
    return [str(viewer_executable()), "--bind", HOST, *options]


def viewer_environment() -> dict[str, str]:
    """Return the environment of a viewer: ours, and its log keeps to errors."""
    return {**os.environ, "RUST_LOG": "error"}


def free_port() -> int:
    """Return a port of this machine that nothing listens on at the moment."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


def wait_until_listening(process: "subprocess.Popen[bytes]", port: int) -> None:
    """Return once something listens on the port; raises DeviceError when the process ends or is too slow."""
    deadline = time.monotonic() + _START_TIMEOUT_S
    while time.monotonic() < deadline:
        with socket.socket() as probe:
            if probe.connect_ex((HOST, port)) == 0:
                return
        if process.poll() is not None:
            raise DeviceError(f"the rerun viewer did not start: exit status {process.returncode}")
        time.sleep(0.05)
    raise DeviceError(f"the rerun viewer does not listen on port {port} after {_START_TIMEOUT_S:g} s")


def _serve_web(path: Path, say: Callable[[str], None]) -> None:
    data_port, page_port = free_port(), free_port()
    ports = ["--port", str(data_port), "--web-viewer-port", str(page_port)]
    process = subprocess.Popen(viewer_command("--serve-web", *ports, str(path)), env=viewer_environment())
    try:
        wait_until_listening(process, page_port)
        say(f"showing {path} at {web_address(page_port, live_address(data_port))} until Ctrl-C")
        _run(process, path)
    except KeyboardInterrupt:
        pass  # the way to end it
    finally:
        process.terminate()
        process.wait()


def _run(process: "subprocess.Popen[bytes]", path: Path) -> None:
    status = process.wait()
    if status != 0:
        raise DeviceError(f"the rerun viewer ended with exit status {status}; try 'hil view {path} --web'")
