"""The commands as real processes."""

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

HIL = [sys.executable, "-m", "hil.cli.main"]
ROOT = Path(__file__).parents[1]
READY_S = 60.0


class Device(NamedTuple):
    """A ``hil device`` process that is ready, with what its line said."""

    process: subprocess.Popen[str]
    link: str
    truth: str


def hil(*arguments: str | Path, cwd: Path | None = None, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
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


def run_json(*arguments: str | Path, cwd: Path | None = None) -> dict[str, Any]:
    """Run ``hil run ... --json`` and return its one object; stdout must hold nothing else."""
    done = hil("run", *arguments, "--json", cwd=cwd)
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
        yield Device(process, told["link"], told["truth"])
    finally:
        process.terminate()
        process.communicate(timeout=30)


def is_running(pid: int) -> bool:
    """Tell whether the process is there; one that only waits for its parent to take note has ended."""
    shown = subprocess.run(["ps", "-o", "stat=", "-p", str(pid)], capture_output=True, text=True, check=False)
    return shown.stdout.strip()[:1] not in ("", "Z")


def wait_for(condition: Any, limit_s: float = 30.0) -> Any:
    """Return the first true value of the condition; fail when there is none in time."""
    deadline = time.monotonic() + limit_s
    while not (value := condition()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.005)
    return value
