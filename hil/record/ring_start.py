"""The start of a process behind ``hil.record.ring_process``, which may come before it is known what it shall do.

To start Python and import a library such as rerun takes as long as all else before a run's first tick: the process does
that beside whatever the run has to do meanwhile, and then waits for its config.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from typing import Any, Self

from hil.core.json_lines import LineReader, LineWriter
from hil.core.subprocesses import away_from_terminal, module_command
from hil.record.memory import SharedBlock


class Started:
    """``python -m module`` with its pipes and the block that it shares; a context manager that leaves nothing behind.

    Give it to one ``RingProcess``, which tells it what to do and ends it. One that was given to none does nothing, and
    is ended with the context.

    Args:
        arguments: what the module needs to know before its config, to prepare for it.
        block: what it shares with the process before it, when it takes its place; by default one without bytes yet.

    Raises OSError when the process cannot be started.

    Attributes:
        lines, replies: what is written to the process and read from it.
        started_s: when that was, on the monotonic clock.
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
        self.process = subprocess.Popen(
            module_command(module, *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            bufsize=0,
            env=self._environment,
            **options,
        )
        self.started_s = time.monotonic()
        self.lines = LineWriter(_descriptor(self.process.stdin))
        self.replies = LineReader(_descriptor(self.process.stdout))

    def again(self) -> "Started":
        """Start another in its place, with the same block. Raises OSError when that fails."""
        return Started(self._module, self._environment, *self._arguments, block=self.block)

    def end_lines(self) -> None:
        """Let the process see the end of its lines, at which it ends too."""
        if self.process.stdin is not None:
            self.process.stdin.close()

    def trouble(self) -> str:
        """Wait for its end, and say how it ended: its last words, or else its exit status."""
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


def _descriptor(pipe: Any) -> int:
    return int(pipe.fileno())
