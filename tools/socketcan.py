"""Run a command where real SocketCAN is: ``python -m tools.socketcan [--limit-s N] COMMAND...``

The command finds the interfaces vcan0 (classic CAN) and vcan1 (CAN FD) up, and may make and break interfaces as it
likes: they are its own. Where this machine's kernel has vcan, they are in a network namespace. Elsewhere they are in
a guest: Debian's user-mode Linux, an ordinary process, which needs no right of root's. The guest's root is this
machine's file system, read-only; it may write to /run and /dev/shm, which are in its memory. Its output is streamed,
its exit code returned. It ends with the command, the time limit or this process, whichever is first.
"""

import argparse
import contextlib
import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Self

from firmware_protocol.built import BuildError
from tools.build.compiler import compile_shared, compiler
from tools.socketcan_inside import EXIT_CODE, JOB

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 600.0
_KERNEL = "linux.uml"
_PACKAGES = {
    _KERNEL: "user-mode-linux",
    "insmod": "kmod",
    "ip": "iproute2",
    "mount": "mount",
    "bash": "bash",
    "taskset": "util-linux",
}
_XSTATE = Path(__file__).with_name("socketcan_xstate.c")
_MEMORY_MB = 1024
_PROBE_S = 20.0
# Runs the rest as a process group, which is killed when stdin ends: when we close it, or die. Nothing of the guest may
# stay behind, and a kernel that is killed alone leaves its helpers. The folder, $0, goes last. Real time must pass
# inside, so it has precedence if root runs it.
_DEADMAN = """
{ echo -15 >/proc/self/autogroup; renice -n -15 $$; } >/dev/null 2>&1
set -m; "$@" </dev/null & exec >&- 2>&-
read -r _; kill -KILL %1; wait; rm -rf "$0"
"""


def missing() -> str | None:
    """Return what this machine lacks to run anything here, in one sentence; None when nothing is missing."""
    if _namespace() is not None:
        return None
    if not sys.platform.startswith("linux"):
        return "SocketCAN needs Linux; run this there"
    lacking = [package for tool, package in _PACKAGES.items() if _which(tool) is None]
    if lacking:
        return (
            "this machine's kernel has no vcan that we may make, and there is no guest that has; on Debian: "
            f"apt-get install {' '.join(lacking)}"
        )
    if _has_amx():
        try:
            compiler()
        except BuildError as error:
            return f"on a processor with AMX the guest needs a C compiler: {error}"
    return None


def _has_amx() -> bool:
    return "amx_tile" in Path("/proc/cpuinfo").read_text()


class Inside:
    """A command that runs inside; a context manager that kills whatever is left of it.

    It runs in ``directory``, and ``environment`` is added to this process's. ``output`` is what the command writes, as
    it comes; stdin is empty.
    Raises OSError when nothing can be started, and BuildError; ask ``missing`` first.
    """

    def __init__(
        self, command: Sequence[str], environment: Mapping[str, str], limit_s: float = LIMIT_S, *, directory: Path
    ) -> None:
        with contextlib.ExitStack() as resources:
            folder = tempfile.TemporaryDirectory(prefix="hil_socketcan_", ignore_cleanup_errors=True)
            self._folder = Path(resources.enter_context(folder))
            namespace = _namespace()
            own = {"TMPDIR": "/run/tmp", "HOME": "/run/home", "XDG_STATE_HOME": "/run/home/.local/state"}
            if namespace:  # a server in there would remove the tokens of servers out here: their ports refuse it
                own = {"XDG_STATE_HOME": str(self._folder / "state")}
            variables = os.environ | {"PATH": _path()} | own | dict(environment)
            job = {"command": list(command), "directory": str(directory), "environment": variables}
            (self._folder / JOB).write_text(json.dumps(job))
            inside = [sys.executable, "-P", str(ROOT / "tools" / "socketcan_inside.py"), str(self._folder)]
            started = [*namespace, *inside] if namespace else self._guest(inside)
            self._process = subprocess.Popen(
                ["bash", "-c", _DEADMAN, str(self._folder), *started],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                env=os.environ | {"TMPDIR": _memory_folder(), "PATH": _path()},
            )
            resources.callback(self._kill)
            assert self._process.stdout is not None
            self.output: IO[bytes] = self._process.stdout
            resources.callback(self.output.close)
            self.limit_s = limit_s
            self.is_out_of_time = False
            self._timer = threading.Timer(limit_s, self._out_of_time)
            self._timer.daemon = True
            self._timer.start()
            resources.callback(self._timer.cancel)
            self._resources = resources.pop_all()

    def _guest(self, init: list[str]) -> list[str]:
        """Return the command line of the kernel. What init is comes from a script: the kernel splits at spaces."""
        script = self._folder / "init"
        words = " ".join("'" + word.replace("'", "'\\''") + "'" for word in [*init, "--boot"])
        script.write_text(f"#!/bin/sh\nexec {words}\n")
        script.chmod(0o755)
        root = ["root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro"]
        # Its terminals lead nowhere, its first serial line to our pipe; it makes its control socket in our folder.
        lines = ["con=null", "ssl0=null,fd:1", f"uml_dir={self._folder}"]
        # Each system call changes from one process of the guest to another: 15 us on one processor, 40 between two.
        processors = sorted(os.sched_getaffinity(0))
        one = ["taskset", "--cpu-list", str(processors[os.getpid() % len(processors)])]
        return [*one, *self._preloaded(), _KERNEL, f"mem={_MEMORY_MB}M", "quiet", *root, *lines, f"init={script}"]

    def _preloaded(self) -> list[str]:
        """Return the prefix of the kernel's command, if ``socketcan_xstate.c`` is needed; that is compiled for it."""
        if not _has_amx():
            return []
        library = self._folder / "xstate.so"
        compile_shared([_XSTATE], library)
        return ["env", f"LD_PRELOAD={library}"]

    def exit_code(self) -> int | None:
        """Return the command's exit code when ``output`` has ended; None when it did not come to its end."""
        try:
            return int((self._folder / EXIT_CODE).read_text())
        except (FileNotFoundError, ValueError):
            return None

    def _out_of_time(self) -> None:
        self.is_out_of_time = True
        self._kill()

    def _kill(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def close(self) -> None:
        """Kill what still runs, and remove the temporary folder. Closing twice is allowed."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@functools.cache
def _namespace() -> list[str] | None:
    """Return the command that runs another in namespaces of its own, or None when there it can make no vcan."""
    if not sys.platform.startswith("linux") or _which("unshare") is None or _which("ip") is None:
        return None
    rights = [] if os.geteuid() == 0 else ["--map-root-user"]
    # The namespace of processes ends with its first one, and everything in it too.
    command = ["unshare", *rights, "--net", "--pid", "--fork", "--kill-child", "--mount-proc"]
    try:
        probe = subprocess.run(
            [*command, "ip", "link", "add", "vcan0", "type", "vcan"],
            capture_output=True,
            timeout=_PROBE_S,
            check=False,
            env=os.environ | {"PATH": _path()},
        )
    except subprocess.TimeoutExpired:  # it may hang where modules are loaded; the guest has its own
        return None
    return command if probe.returncode == 0 else None


def _which(tool: str) -> str | None:
    return shutil.which(tool, path=_path())


def _path() -> str:
    """Return PATH with the folders of the system's tools, which a plain user's often lacks."""
    return os.pathsep.join([os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"])


def _memory_folder() -> str:
    """Return where the guest's memory may be a file: it must be executable there, and have room."""
    shared = Path("/dev/shm")
    with contextlib.suppress(OSError):
        about = os.statvfs(shared)
        if about.f_bavail * about.f_frsize >= _MEMORY_MB * 2**20 and not about.f_flag & os.ST_NOEXEC:
            return str(shared)
    return tempfile.gettempdir()


def main() -> int:
    """Run the command of the command line and return its exit code; 2 when it cannot be run, 124 out of time."""
    parser = argparse.ArgumentParser(description="Run a command where real SocketCAN is: vcan0, and vcan1 for CAN FD.")
    parser.add_argument("--limit-s", type=float, default=LIMIT_S, help="then it is killed (%(default)s)")
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND...")
    arguments = parser.parse_args()
    if not arguments.command:
        parser.error("which command?")
    if (sentence := missing()) is not None:
        print(f"socketcan: {sentence}", file=sys.stderr)
        return 2
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with Inside(arguments.command, {}, arguments.limit_s, directory=Path.cwd()) as inside:
            has_said = False
            while chunk := inside.output.read1(65536):  # type: ignore[attr-defined]
                has_said = True
                sys.stdout.buffer.write(chunk)
                sys.stdout.buffer.flush()
            code = inside.exit_code()
            out_of_time = inside.is_out_of_time
    except KeyboardInterrupt:
        print("socketcan: interrupted", file=sys.stderr)
        return 130
    if code is not None:
        return code
    if out_of_time:
        print(f"socketcan: killed after {arguments.limit_s:g} s; --limit-s sets how long it may take", file=sys.stderr)
        return 124
    why = "what it said is above" if has_said else "it said nothing"
    print(f"socketcan: the guest ended before its command; {why}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
