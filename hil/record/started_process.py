"""A child process that runs one of our modules, started before its task is known; its environment; a timeout."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from typing import Self

from hil.core.json_lines import LineReader, LineWriter
from hil.core.subprocesses import away_from_terminal, child_environment, module_command
from hil.record.ring import SharedBlock

_WAIT_S = 0.0005

WITH_RERUN = "rerun"
"""Argument of the recorder process: import rerun, and the places that follow, at once, before the config comes."""


def rerun_environment() -> dict[str, str]:
    """Return environment variables with which a child finds our packages, without the user's settings for rerun.

    A setting such as RERUN=0 would leave a recording empty.
    """
    kept = {name: value for name, value in child_environment().items() if not name.startswith("RERUN")}
    return kept | {"RUST_LOG": "error"}


class _WithoutPandas:
    @staticmethod
    def find_spec(name: str, _path: object = None, _target: object = None) -> None:
        if name == "pandas":
            raise ModuleNotFoundError(name=name)


def refuse_pandas() -> None:
    """Make every import of pandas fail in this process, which saves 0.2 s. Call it only in our own child processes.

    pyarrow imports pandas, where it is installed, only to check whether its arguments are pandas tables.
    """
    sys.meta_path.insert(0, _WithoutPandas)


class StallTimeout:
    """Ends a wait for another process that makes no progress.

    It counts waits and not seconds: while this program is suspended, the other process must not count as stalled.
    """

    def __init__(self, waits: int) -> None:
        self._waits = self._left = waits
        self._progress: object = None

    def wait(self, progress: object) -> bool:
        """Wait a little; False when ``progress`` has stayed the same for all the waits."""
        if progress != self._progress:
            self._progress = progress
            self._left = self._waits
        self._left -= 1
        time.sleep(_WAIT_S)
        return self._left > 0


class StartedProcess:
    """``python -m module`` with its pipes and the block that it shares; a context manager that leaves nothing behind.

    It is started before its task is known, because importing its libraries takes as long as everything else before a
    run's first tick. It then waits for the config of a ``RingProcess``. Without one it ends with the context.
    ``arguments`` are those that the module needs before. ``block`` is the shared memory of the process that it
    replaces; by default a new one, not allocated yet. Raises OSError when the process cannot be started.

    ``lines`` and ``replies`` are written to and read from it; ``started_s`` is its start on the monotonic clock.
    """

    def __init__(
        self, module: str, environment: Mapping[str, str], *arguments: str, block: SharedBlock | None = None
    ) -> None:
        self._module = module
        self._environment = dict(environment)
        self._arguments = arguments
        self.block = SharedBlock.reserve() if block is None else block
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 -- closed with the process
        options = away_from_terminal()
        if sys.platform != "win32":
            options["pass_fds"] = self.block.pass_fds
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            module_command(module, *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            bufsize=0,
            env=self._environment,
            **options,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.started_s = time.monotonic()
        self.lines = LineWriter(self.process.stdin.fileno())
        self.replies = LineReader(self.process.stdout.fileno())

    def again(self) -> "StartedProcess":
        """Start a process that replaces this one, with the same block. Raises OSError when that fails."""
        return StartedProcess(self._module, self._environment, *self._arguments, block=self.block)

    def end_lines(self) -> None:
        """Close the pipe of lines; the process ends when it reads the end."""
        if self.process.stdin is not None:
            self.process.stdin.close()

    def trouble(self) -> str:
        """Wait for the process to end and return how it ended: the last line of its stderr, or else its exit status."""
        status = self.process.wait()
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace").strip().splitlines()
        return words[-1] if words else f"exit status {status}"

    def close(self) -> None:
        """End the process if it has not ended, and free all but the block. Closing twice is allowed."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout, self._stderr):
            if pipe is not None:
                pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self.block.close()
