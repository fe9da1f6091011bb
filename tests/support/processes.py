"""The commands as a user types them, in this process where their words and files matter, or as processes."""

import contextlib
import gc
import json
import logging
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import pytest

HIL = [sys.executable, "-m", "hil.cli.main"]
ROOT = Path(__file__).parents[2]
HIL_FILE = str(ROOT / "hil" / "cli" / "main.py")
READY_S = 60.0


def signal_handlers() -> dict[int, Any]:
    """Return what handles the signals that end a process."""
    numbers = [getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP", "SIGINT")]  # Windows has no SIGHUP
    return {number: signal.getsignal(number) for number in numbers if number is not None}


def set_signal_handlers(handlers: Mapping[int, Any]) -> None:
    """Let these handle signals, as ``signal_handlers`` returned them."""
    for number, handler in handlers.items():
        signal.signal(number, handler)


class Device(NamedTuple):
    """A ``hil device`` process that is ready, with what its line said."""

    process: subprocess.Popen[str]
    link: str
    truth: str


def hil(*arguments: str | Path, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in this process, which saves the start of an interpreter and all imports.

    Exit code and output are what the command's own process would give: standard output and standard error are files,
    standard input is empty. A test of the process itself calls ``hil_process``.
    """
    from hil.cli.main import main

    words = [HIL_FILE, *map(str, arguments)]
    threshold, handlers = gc.get_threshold(), signal_handlers()
    os.umask(umask := os.umask(0o077))
    root = logging.getLogger()
    logged = root.handlers[:], root.level  # a service sets them
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setattr(sys, "argv", words)
        for name, value in environment().items():
            patch.setenv(name, value)
        if cwd is not None:
            patch.chdir(cwd)
        patch.setattr(sys, "stdin", stack.enter_context(Path(os.devnull).open(encoding="utf-8")))
        output, errors = (stack.enter_context(_captured(name, patch)) for name in ("stdout", "stderr"))
        try:
            main()
            code: object = 0
        except SystemExit as end:
            code = end.code
        finally:
            os.umask(umask)  # a service sets it
            gc.unfreeze()
            gc.set_threshold(*threshold)
            set_signal_handlers(handlers)
            root.handlers[:], level = logged
            root.setLevel(level)
    assert code is None or isinstance(code, int), code
    return subprocess.CompletedProcess(words, code or 0, "".join(output), "".join(errors))


@contextlib.contextmanager
def _captured(name: str, patch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """Put a file in the place of an output stream and of its descriptor, and give what was written, at the end."""
    number = {"stdout": 1, "stderr": 2}[name]
    text: list[str] = []
    kept = os.dup(number)
    with tempfile.TemporaryFile("w+", encoding="utf-8") as file:
        os.dup2(file.fileno(), number)
        stream = os.fdopen(number, "w", encoding="utf-8", closefd=False)
        try:
            with patch.context() as streams:
                streams.setattr(sys, name, stream)
                yield text
        finally:
            stream.flush()
            os.dup2(kept, number)
            os.close(kept)
            file.seek(0)
            text.append(file.read())


def hil_process(
    *arguments: str | Path, cwd: Path | None = None, timeout: float = 120.0
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end in a process of its own."""
    return subprocess.run(
        [*HIL, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        cwd=cwd,
        timeout=timeout,
        env=environment(),
        stdin=subprocess.DEVNULL,
    )


def environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "COLUMNS": "120", "NO_COLOR": "1"}


def run_json(
    *arguments: str | Path, cwd: Path | None = None, by: Callable[..., subprocess.CompletedProcess[str]] = hil
) -> dict[str, Any]:
    """Run ``hil run ... --json`` and return its one object; stdout must hold nothing else."""
    done = by("run", *arguments, "--json", cwd=cwd)
    assert done.returncode in (0, 1), done.stderr
    assert done.stdout.count("\n") == 1
    answer = json.loads(done.stdout)
    assert isinstance(answer, dict)
    return answer


@contextlib.contextmanager
def device(*arguments: str) -> Iterator[Device]:
    """Start ``hil device`` and wait for the line that says that it is ready."""
    process = subprocess.Popen(
        [*HIL, "device", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    )
    assert process.stdout is not None
    try:
        ready, _, _ = select.select([process.stdout], [], [], READY_S)
        line = process.stdout.readline() if ready else ""
        assert line.startswith("ready "), line or (process.stderr and process.stderr.read())
        told = dict(part.split("=", 1) for part in line.split()[1:])
        kind, _, port = told["link"].partition(":")
        if kind == "serial":
            _terminals.append(os.open(port.partition("?")[0], os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        yield Device(process, told["link"], told["truth"])
    finally:
        process.terminate()
        process.communicate(timeout=30)


_terminals: list[int] = []


def release_terminals() -> None:
    """Close the terminals of the robots of a test that has ended.

    Until then the number of a killed robot is not given to the robot of another test at the same time. The first
    robot's host waits for it to come back, and holds the lock on that number.
    """
    while _terminals:
        os.close(_terminals.pop())


def is_running(pid: int) -> bool:
    """Tell whether the process is there; one that only waits for its parent to take note has ended."""
    shown = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return shown.stdout.strip()[:1] not in ("", "Z")


def wait_for(condition: Any, limit_s: float = 30.0) -> Any:
    """Return the first true value of the condition; fail when there is none in time (longer on a busy machine)."""
    begin_s = time.monotonic()
    while not (value := condition()):
        assert time.monotonic() - begin_s < limit_s * busy(), "waited in vain"
        time.sleep(0.005)
    return value


def busy() -> float:
    """Return how many times slower than alone a process of this machine may be now."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0  # Windows has none
    return max(1.0, load / (os.cpu_count() or 1))


def network_of_its_own() -> list[str]:
    """Return the words before a command that give it a network namespace with a loopback interface and multicast."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip("needs unshare and ip: apt install util-linux iproute2")
    # A user namespace where root is not given: its owner may set up its own network.
    rights = [] if os.geteuid() == 0 else ["--map-root-user"]
    if subprocess.run(["unshare", *rights, "-n", "true"], capture_output=True, check=False).returncode:
        pytest.skip("needs a network namespace: run as root, or allow unprivileged user namespaces")
    up = 'ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo && exec "$@"'
    return ["unshare", *rights, "-n", "sh", "-c", up, "sh"]


@contextlib.contextmanager
def own_state(folder: Path) -> Iterator[None]:
    """Keep tokens, locks and audit logs in ``folder``, apart from the user's and from other tests'."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        yield
