"""Python processes of ours: how they are started, and the memory that a process has taken."""

import mmap
import os
import subprocess
import sys
from pathlib import Path
from typing import Any


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs one of our modules in the interpreter that runs now."""
    # -P: a file of the user's in the working directory must not shadow a module.
    return [sys.executable, "-P", "-m", module, *arguments]


def child_environment() -> dict[str, str]:
    """Return the environment in which the child finds our packages."""
    root = str(Path(__file__).resolve().parents[2])
    return os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}


def away_from_terminal() -> dict[str, Any]:
    """Return the options of Popen that keep Ctrl-C in our terminal from the child: we end it, in our order."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def start_children_as_ordinary() -> None:
    """Have processes that this thread starts begin without a real-time priority that it may have inherited.

    One that imports its libraries with the loop's own priority makes ticks late by tens of milliseconds.
    """
    if sys.platform == "linux":
        policy = os.sched_getscheduler(0)
        if policy in (os.SCHED_FIFO, os.SCHED_RR):
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))


def wait_for_end(descriptor: int) -> None:
    """Return when a pipe has ended, as when whoever held its other end is gone; for a thread that does nothing else.

    It takes no buffered reader: one's lock, held by this thread, would be fatal when the interpreter ends.
    """
    while os.read(descriptor, 4096):
        pass


_PROCESSES = Path("/proc")
_BYTES_A_MB = 1e6
DEFAULT_LIMIT_MB = 2000.0
MEMORY_IS_KNOWN = (_PROCESSES / "self" / "statm").exists()
"""Whether the system tells how much memory a process has: Linux does."""


def resident_bytes(process: int | str = "self") -> int:
    """Return the resident memory of a process, given by its number; 0 when there is none of this number (any more)."""
    try:
        sizes = (_PROCESSES / str(process) / "statm").read_text(encoding="ascii")  # in pages; the second is resident
    except OSError:
        return 0
    return int(sizes.split()[1]) * mmap.PAGESIZE


def excess(process: int, limit_mb: float) -> str | None:
    """Return a sentence about a process that has taken more memory than its limit; None while it has not."""
    taken_mb = resident_bytes(process) / _BYTES_A_MB
    return (
        None if taken_mb <= limit_mb else f"it took {taken_mb:.0f} MB of memory, more than the limit of {limit_mb:g} MB"
    )
