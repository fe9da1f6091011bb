"""Runs a program that must not outlive us: ``ChildProcess`` starts this module, which starts the program.

The first line on stdin is ``{"command": [...]}``. When stdin ends, because its owner closed it or died, the program is
killed. Its stderr is ours, and so is its exit code. The folder of its files, the argument, is removed in the end.
"""

import json
import os
import shutil
import subprocess
import sys
import threading


def main() -> int:
    """Start the program, wait for its end, and return its exit code."""
    command = json.loads(sys.stdin.buffer.readline())["command"]
    try:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    except OSError as error:
        print(f"{command[0]} cannot be started: {error}", file=sys.stderr)
        return 1
    threading.Thread(target=_kill_at_end_of_stdin, args=(process,), daemon=True).start()
    status = process.wait()
    shutil.rmtree(sys.argv[1], ignore_errors=True)
    if status < 0:
        print(f"{command[0]} was ended by signal {-status}", file=sys.stderr)
    return status if status >= 0 else 1


def _kill_at_end_of_stdin(process: "subprocess.Popen[bytes]") -> None:
    # Not by sys.stdin, whose lock this thread would hold when the interpreter ends.
    while os.read(sys.stdin.fileno(), 4096):
        pass
    process.kill()


if __name__ == "__main__":
    sys.exit(main())
