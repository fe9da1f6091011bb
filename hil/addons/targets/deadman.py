"""A process that runs a program, and kills it when its own owner ends. ``ChildProcess`` starts this module.

The first line on stdin is ``{"command": [...], "inherited": [...]}``; the program inherits these descriptors. It is
killed when stdin ends (the owner closed it or died), at SIGTERM or SIGINT, and on Linux also when this process is
killed. Then the folder of its files, the argument, is removed. stderr and exit code are passed on.
"""

import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable

from hil.core.subprocesses import wait_for_end

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> int:
    """Start the program, wait for its end, and return its exit code."""
    request = json.loads(sys.stdin.buffer.readline())
    command, inherited = request["command"], request["inherited"]
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=inherited,
            preexec_fn=_dying_with_us(),
        )
    except OSError as error:
        print(f"{command[0]} cannot be started: {error}", file=sys.stderr)
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: process.kill())
    for descriptor in inherited:
        os.close(descriptor)  # so that its other side notices when the program ends

    def kill_at_end_of_stdin() -> None:
        wait_for_end(sys.stdin.fileno())
        process.kill()

    threading.Thread(target=kill_at_end_of_stdin, daemon=True).start()
    status = process.wait()
    shutil.rmtree(sys.argv[1], ignore_errors=True)
    if status < 0:
        print(f"{command[0]} was ended by signal {-status}", file=sys.stderr)
    return status if status >= 0 else 1


def _dying_with_us() -> Callable[[], None] | None:
    """Return a function for the new process: it requests SIGKILL when the thread that started the process ends."""
    if sys.platform != "linux":
        return None
    prctl = ctypes.CDLL(
        None, use_errno=True
    ).prctl  # looked up here, as little as possible may run between fork and exec
    ours = os.getpid()

    def request_kill() -> None:
        if prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0 or os.getppid() != ours:
            os._exit(1)  # we have ended meanwhile

    return request_kill


if __name__ == "__main__":
    sys.exit(main())
