"""Starts Python processes of this project, ends them in order, and reads the memory that a process uses."""

import mmap
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType
from typing import Any


def module_command(module: str, *arguments: str) -> list[str]:
    """Return the command line that runs one of our modules with the current interpreter."""
    # -P: a user's file in the working directory must not shadow a module.
    return [sys.executable, "-P", "-m", module, *arguments]


def one_thread_a_process() -> None:
    """Keep NumPy from starting a thread for each processor when it is imported, unless the user sets their number.

    The threads take 0.04 s to start on two processors, and nothing of ours has work for them.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def child_environment() -> dict[str, str]:
    """Return environment variables with which a child process finds our packages."""
    root = str(Path(__file__).resolve().parents[2])
    return (
        {"OPENBLAS_NUM_THREADS": "1"}
        | os.environ
        | {"PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH")]))}
    )


def away_from_terminal() -> dict[str, Any]:
    """Return the options of Popen that keep Ctrl-C from reaching the child: the parent ends it itself."""
    if sys.platform == "win32":
        return {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    return {"start_new_session": True}


def start_children_as_ordinary() -> None:
    """Make processes that this thread starts run without its real-time priority, if it has one.

    A child that imports its libraries with the loop's priority delays ticks by tens of milliseconds.
    """
    if sys.platform == "linux":
        policy = os.sched_getscheduler(0)
        if policy in (os.SCHED_FIFO, os.SCHED_RR):
            os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, os.sched_getparam(0))


class LifeLine:
    """A pipe that has the operating system send SIGIO to a child, which ends it, when this process ends in any way.

    Unlike a thread of the child that waits for the end of a pipe, it also ends a child whose interpreter is held up in
    C. A child of ours is given ``token`` for ``hold_on``; another program is started by ``start_program``. On Windows
    it does nothing.
    """

    def __init__(self) -> None:
        self._options: dict[str, Any] = {}
        self.token = ""
        self._ends: tuple[int, ...] = ()
        if sys.platform != "win32":
            self._ends = child_end, _ = os.pipe()
            self.token = str(child_end)
            self._options = {"pass_fds": (child_end,)}

    def start(self, command: Sequence[str], **options: Any) -> "subprocess.Popen[bytes]":
        """Start the child, with options of Popen. Raises OSError, and then it is closed."""
        try:
            return subprocess.Popen(command, **options, **self._options)
        except BaseException:
            self.close()
            raise

    def start_program(self, command: Sequence[str], **options: Any) -> "subprocess.Popen[bytes]":
        """Start an executable that knows nothing of this pipe, with options of Popen.

        The child begins as Python, calls ``hold_on``, and only then becomes the program, by exec. So there is no moment
        in which this process can be killed and leave the program running. Raises OSError, and then this is closed.
        """
        if self._ends:
            command = [sys.executable, "-P", __file__, self.token, *command]
        return self.start(command, **options)

    def close(self) -> None:
        """Let go of the child, which ends if it still holds on. May be called twice."""
        ends, self._ends = self._ends, ()
        for end in ends:
            os.close(end)


def hold_on(token: str) -> None:
    """End this process when the one that made the ``LifeLine`` has ended."""
    if sys.platform != "win32" and token:
        import fcntl
        import select

        end = int(token)
        fcntl.fcntl(end, fcntl.F_SETOWN, os.getpid())
        # SIGIO, which ends a process that does not handle it. Nothing is ever written, so the end is the only event.
        fcntl.fcntl(end, fcntl.F_SETFL, fcntl.fcntl(end, fcntl.F_GETFL) | os.O_ASYNC)
        if select.select([end], [], [], 0)[0]:  # the other process ended before
            os._exit(1)


def wait_for_end(descriptor: int) -> None:
    """Wait until a pipe ends, for example because the process at its other end has ended; for a thread of its own.

    It does not use a buffered reader: that holds a lock while it waits, which is fatal when the interpreter ends.
    """
    while os.read(descriptor, 4096):
        pass


def on_signals(handler: Callable[[int, FrameType | None], None], *names: str) -> None:
    """Handle these signals; one that is ignored, as SIGHUP under nohup, stays ignored.

    SIGHUP comes when a terminal's window is closed. It is handled once, because kernel and shell both send it. From
    then on output to that terminal is dropped: to write there is an error.
    """

    def hung_up(number: int, frame: FrameType | None) -> None:
        signal.signal(number, signal.SIG_IGN)
        for descriptor in (1, 2):
            try:
                os.write(descriptor, b"")
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)
        handler(number, frame)

    for name in names:
        number = getattr(signal, name, None)  # Windows has no SIGHUP
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, hung_up if name == "SIGHUP" else handler)


_PROCESSES = Path("/proc")
_BYTES_A_MB = 1e6
DEFAULT_LIMIT_MB = 2000.0
MEMORY_IS_KNOWN = (_PROCESSES / "self" / "statm").exists()
"""Whether the system reports the memory of a process; only Linux does."""


def resident_bytes(process: int | str = "self") -> int:
    """Return the resident memory of a process [bytes], given its process id; 0 if it does not exist (any more)."""
    try:
        sizes = (_PROCESSES / str(process) / "statm").read_text(encoding="ascii")  # in pages; second: resident
    except OSError:
        return 0
    return int(sizes.split()[1]) * mmap.PAGESIZE


def excess(process: int, limit_mb: float) -> str | None:
    """Return an error message if a process uses more memory than its limit, else None."""
    used_mb = resident_bytes(process) / _BYTES_A_MB
    if used_mb <= limit_mb:
        return None
    from hil.core.errors import apart  # not above: as a program this file has no packages

    return f"it took {apart(used_mb, limit_mb)} MB of memory, more than the limit of {limit_mb:g} MB"


if sys.platform != "win32" and __name__ == "__main__":  # for start_program
    hold_on(sys.argv[1])
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # Python ignores it, and a program would inherit that
    os.execv(sys.argv[2], sys.argv[2:])
