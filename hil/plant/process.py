"""A child process that may crash or hang: starts, watches and ends it; and the child's own side (``Parent``)."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO, Any, NoReturn, cast

from hil.core.errors import DeviceError
from hil.core.subprocesses import away_from_terminal, child_environment, excess, module_command
from hil.plant import shim
from hil.plant.child_output import ChildOutput

THERE_S = 60.0  # that Python and our own modules may take to be there
_LAST_WORDS = 200  # characters of its last line in a sentence
_END_S = 1.0
_POLL_S = 0.002
_ROUNDS = 20
_LONGEST_ROUNDS_S = 2.0


class Watch:
    """Calls ``expire(limit_s)`` when one request has been pending for ``limit_s``, and again after each ``limit_s``.

    It also calls ``look`` several times in that time, at least every tenth of a second.

    ``pending`` returns a token of the request that waits for its reply, a different one for each request, or None.
    The watch counts its rounds in place of time, so that a suspended program is not taken for one that hangs.
    It may be late by a twentieth of the first ``limit_s``, and by 0.1 s at most.
    """

    def __init__(
        self, pending: Callable[[], object], expire: Callable[[float], None], limit_s: float, look: Callable[[], None]
    ) -> None:
        self.limit_s, self._look, self._pending, self._expire = limit_s, look, pending, expire
        self._round_s = min(limit_s, _LONGEST_ROUNDS_S) / _ROUNDS
        self._stopped = threading.Event()
        threading.Thread(target=self._run, name="plant watch", daemon=True).start()

    def _run(self) -> None:
        rounds, before = 0, None
        while not self._stopped.wait(self._round_s):
            self._look()
            token = self._pending()
            rounds = rounds + 1 if token is not None and token == before else 0
            before = token
            limit_s = self.limit_s
            if rounds * self._round_s >= limit_s:
                rounds = 0
                self._expire(limit_s)

    def stop(self) -> None:
        self._stopped.set()


class ChildProcess:
    """Runs one of our modules in a child process, connected by pipes to its stdin and stdout (there: ``Parent``).

    The pipes carry lines of JSON at first; the owner decides what follows. What the child prints goes to ``output``.
    Ctrl-C in the terminal does not reach it. When this process ends, the child ends too, and removes the folder
    ``scratch``. Processes that it started end with it, on Linux also when it is killed. ``inherited`` are descriptors
    that it has under the same numbers; POSIX only. Raises DeviceError when no process can be started.
    """

    def __init__(
        self, module: str, scratch: Path, inherited: Sequence[int] = (), output: ChildOutput | None = None
    ) -> None:
        try:
            self._process = subprocess.Popen(
                module_command(module, str(scratch)),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                env=child_environment(),
                pass_fds=inherited,
                **away_from_terminal(),
            )
        except OSError as error:
            raise DeviceError(f"no process can be started for the plant ({error}); end others first") from error
        self.pid = self._process.pid
        self._stdin, self._stdout = cast(IO[bytes], self._process.stdin), cast(IO[bytes], self._process.stdout)
        self._why_ended: str | None = None  # by us
        self._output = ChildOutput() if output is None else output
        self._reader = threading.Thread(target=self._read_output, name="plant output", daemon=True)
        self._reader.start()

    @property
    def pipes(self) -> dict[str, int]:
        """The ends of its pipes, as ``remote_pipes`` takes them."""
        return pipes(self._stdout.fileno(), self._stdin.fileno())

    def send(self, record: Mapping[str, object]) -> None:
        """Send a line. Only an answer shows that it arrived."""
        with contextlib.suppress(OSError):
            self._stdin.write(json.dumps(record).encode() + b"\n")

    def receive(self) -> dict[str, Any] | None:
        """Wait for a line; None when the process has ended instead, or was ended because it is none of ours."""
        return self._record(self._stdout.readline())

    def receive_all(self) -> Iterator[dict[str, Any]]:
        """Yield every further line until the process has ended."""
        with open(self._stdout.fileno(), "rb", closefd=False) as lines:  # with a buffer: there are many
            while (record := self._record(lines.readline())) is not None:
                yield record

    def _record(self, line: bytes) -> dict[str, Any] | None:
        if not line.endswith(b"\n"):
            return None
        with contextlib.suppress(ValueError):
            if isinstance(record := json.loads(line), dict):
                return record
        self.refuse_bytes(line)
        return None

    def refuse_bytes(self, received: bytes) -> None:
        """Kill the process, because these bytes came through its pipe, and our module sends no such bytes."""
        words = received.partition(b"\n")[0][:_LAST_WORDS].decode(errors="replace")
        self._end_because(f"it wrote into the pipe of its process: {words!r}")

    def kill(self) -> None:
        """Kill the process and every process that it started, without waiting."""
        if self._process.returncode is not None:
            return  # its number may be another's by now
        with contextlib.suppress(OSError):  # it has ended already
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGKILL)

    def give_up(self, waited_s: float) -> None:
        """Kill the process, because it has not answered for ``waited_s`` [s]."""
        if self._is_left_behind():
            return
        self._end_because(f"it gave no answer within {waited_s:g} s and was ended")

    def limit_memory(self, limit_mb: float, setting: str = "") -> None:
        """Kill the process if it uses more memory than the limit. No effect if the system does not report memory.

        ``setting`` names the option that sets the limit, for the message. If the process has ended on its own, its
        child processes are killed: they hold the pipes open, so nobody else would notice its end.
        """
        if self._is_left_behind():
            return
        if self._process.returncode is None and (words := excess(self.pid, limit_mb)) is not None:
            self._end_because(f"{words}{setting and f' ({setting})'}, and was ended")

    def _is_left_behind(self) -> bool:
        """Return whether the process has ended on its own, and kill its child processes."""
        if sys.platform != "linux" or self._why_ended is not None or not self._has_ended():
            return False  # elsewhere it would lose its number by being asked
        self.kill()
        return True

    def _end_because(self, why: str) -> None:
        self._why_ended = self._why_ended or why
        self.kill()

    def wait(self) -> int:
        """Wait for its end, kill it if it goes on, and return Popen's status."""
        return self._end(_END_S)

    def ending(self) -> str:
        """Wait for its end as ``wait`` does; return the reason in words, with the last line that it printed."""
        status = self.wait()
        return f"{self._why_ended or f'its process {_how(status)}'}{self.last_words()}"

    def last_words(self) -> str:
        """Return the last line that it printed until its end, as the end of a sentence; empty without one."""
        self._reader.join(_END_S)
        words = self._output.last()
        return f"; its last words: {words[-_LAST_WORDS:]!r}" if words else ""

    def close(self, patience_s: float) -> None:
        """Let the process end on its own; kill it after ``patience_s``. Closing twice is allowed."""
        self._stdin.close()
        self._end(patience_s)
        self._stdout.close()
        self._reader.join(_END_S)

    def _end(self, patience_s: float) -> int:
        deadline_s = time.monotonic() + patience_s
        while not self._has_ended() and time.monotonic() < deadline_s:
            time.sleep(_POLL_S)
        self.kill()  # what has ended may have left others behind
        return self._process.wait()

    def _has_ended(self) -> bool:
        """Return whether it has ended; on Linux its number stays taken until ``Popen.wait``, for ``kill``."""
        if sys.platform == "linux" and self._process.returncode is None:
            with contextlib.suppress(ChildProcessError):  # another thread has just waited for it
                return os.waitid(os.P_PID, self.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None
        return self._process.poll() is not None

    def _read_output(self) -> None:
        """Read its output at once, so that the child never waits for a reader."""
        with cast(IO[bytes], self._process.stderr) as stderr:
            while printed := stderr.read(65536):
                # A NUL is the child's question whether this process still runs (``Parent``).
                self._output.feed(printed.replace(b"\0", b""))


def pipes(read_end: int, write_end: int) -> dict[str, int]:
    """Return two of Python's descriptors as ``remote_pipes`` takes them."""
    ends = {"read_end": read_end, "write_end": write_end}
    if sys.platform == "win32":
        import msvcrt

        return {name: msvcrt.get_osfhandle(end) for name, end in ends.items()}
    return ends


def _how(status: int) -> str:
    if status < 0:
        number = -status
        # Of the real-time signals Python names only the first and the last.
        name = next((known.name for known in signal.Signals if known == number), f"signal {number}")
        return f"was ended by {name} ({signal.strsignal(number)})"
    code = f"{status:#010X}" if status > 0xFFFF else status  # on Windows, an exception's code
    return f"exited with code {code}"


_CHECK_S = 1.0


class Parent:
    """The parent of this process, which is a ``ChildProcess``; made once, before any FMU is loaded.

    ``requests`` and ``replies`` are the descriptors of its pipes. An FMU reads nothing from stdin, and its output goes
    to stderr, line by line. When the parent has ended, this process removes ``scratch`` and ends, even in a hung FMU.
    """

    def __init__(self) -> None:
        self.scratch = Path(sys.argv[1])
        self.requests, self.replies = os.dup(0), os.dup(1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)
        shim.load()[1].remote_flush_lines()
        sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # an FMU of Python code prints there
        threading.Thread(target=self._end_with_it, args=(os.dup(2),), name="parent", daemon=True).start()
        self.send(here=True)

    def receive(self) -> dict[str, Any]:
        """Return the next record of the parent; end this process when there will be none."""
        with open(self.requests, "rb", buffering=0, closefd=False) as lines:
            line = lines.readline()
        if not line.endswith(b"\n"):
            self.end()
        record: dict[str, Any] = json.loads(line)
        return record

    def send(self, **record: object) -> None:
        """Send a record; end this process when nobody reads it."""
        line = json.dumps(record).encode() + b"\n"
        try:
            while line:
                line = line[os.write(self.replies, line) :]
        except OSError:
            self.end()

    def end(self) -> NoReturn:
        """End without the FMU's own exit handlers, which may hang; leave no file behind."""
        shutil.rmtree(self.scratch, ignore_errors=True)
        os._exit(0)

    def _end_with_it(self, stderr: int) -> None:
        """End when nobody reads this process's stderr any more."""
        while True:
            time.sleep(_CHECK_S)
            try:
                os.write(stderr, b"\0")
            except OSError:
                self.end()
