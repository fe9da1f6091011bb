"""A process of its own that writes down what a run gives it: rows through a ring, lines through a pipe.

Nothing that it does can delay a tick. When the run dies, it finishes its file by itself; when it dies, the run goes on
and is told what is missing. ``hil.telemetry.ring_child`` is the other side.
"""

import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from typing import Any

from hil.child import away_from_terminal, module_command
from hil.errors import BadInputError, DeviceError
from hil.telemetry.channel import LineReader, LineWriter, Patience
from hil.telemetry.memory import SharedBlock
from hil.telemetry.ring import RingWriter, ring_bytes

_PATIENCE_WAITS = 60_000  # of 0.5 ms, without any progress of the other process: about 30 s
_EXIT_TIMEOUT_S = 10.0


class RingProcess:
    """Starts ``python -m module``, gives it rows and lines, and takes its report.

    The constructor returns when the process is ready. ``config`` is its own, as JSON has it; ``name`` is how messages
    call it, ``remedy`` what they advise. With ``blocking`` a put waits for room in the ring, as lockstep may; else it
    drops the row and counts.

    Raises BadInputError when the process refuses the config, DeviceError when it does not start.
    """

    def __init__(
        self,
        module: str,
        config: Mapping[str, object],
        *,
        width: int,
        capacity: int,
        blocking: bool,
        environment: Mapping[str, str],
        name: str,
        remedy: str,
    ) -> None:
        self._name = name
        self._waits = blocking
        size = ring_bytes(capacity, width)
        self._block = SharedBlock.create(size)
        self._ring = RingWriter(self._block, capacity, width)
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._process = _start(module, self._block, self._stderr, environment)
        self._lines = LineWriter(_descriptor(self._process.stdin))
        self._replies = LineReader(_descriptor(self._process.stdout))
        shared = {"block": self._block.token, "block_bytes": size, "parent_pid": os.getpid()}
        self._lines.send({**config, **shared}, always=True)
        reply = self._reply()
        if "ready" not in reply:
            trouble = self._trouble()
            self.close()
            if "refused" in reply:
                raise BadInputError(str(reply["refused"]))
            raise DeviceError(f"{name} did not start: {trouble}; {remedy}")

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def rows_taken(self) -> int:
        """Rows that found room in the ring."""
        return self._ring.head

    @property
    def rows_saved(self) -> int:
        """Rows that are safe in the file by now."""
        return self._ring.saved

    @property
    def rows_dropped(self) -> int:
        """Rows that found the ring full and were given up."""
        return self._ring.dropped

    @property
    def lines_lost(self) -> int:
        """Lines that could not be passed on."""
        return self._lines.lost

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row. Raises struct.error when its width is another."""
        if not self._ring.try_put(row) and not (self._waits and self._put_later(row)):
            self._ring.count_dropped()

    def send(self, record: Mapping[str, object]) -> None:
        """Pass a line on. Never waits."""
        self._lines.send(record)

    def finish(self, record: Mapping[str, object]) -> dict[str, Any]:
        """Have the rest written, and return the report: ``rows_written`` and ``error`` among it.

        Never raises for a process that died: the report then says so.
        """
        self._lines.send(record, always=True)
        reply = self._reply()
        if not reply:
            return {"error": f"{self._name} ended before the run: {self._trouble()}"}
        return reply

    def close(self) -> None:
        """End the process, if need be without a report, and free everything. Closing twice is allowed."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()
        try:
            self._process.wait(_EXIT_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._ring.close()
        self._block.close()
        self._stderr.close()

    def _put_later(self, row: tuple[float, ...]) -> bool:
        """Wait for room; False, now and for good, when the process has ended or makes no progress."""
        patience = Patience(_PATIENCE_WAITS)
        while self._process.poll() is None and patience.wait(self._ring.tail):
            if self._ring.try_put(row):
                return True
        self._waits = False
        return False

    def _reply(self) -> dict[str, Any]:
        """Return the next reply; empty when the process ended without one, or makes no progress."""
        replies: list[dict[str, Any]] = []
        reader = threading.Thread(target=lambda: replies.append(self._replies.read() or {}), daemon=True)
        reader.start()
        patience = Patience(_PATIENCE_WAITS)
        while reader.is_alive():
            progress = (self._lines.flush(), self._ring.tail)
            if not patience.wait(progress):
                self._process.kill()
            reader.join(0.005)
        return replies[0]

    def _trouble(self) -> str:
        """Say how the process ended: its last words, or else its exit status."""
        status = self._process.wait()
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace").strip().splitlines()
        return words[-1] if words else f"exit status {status}"


def _start(module: str, block: SharedBlock, stderr: Any, environment: Mapping[str, str]) -> "subprocess.Popen[bytes]":
    options = away_from_terminal()
    if sys.platform != "win32":
        options["pass_fds"] = block.pass_fds
    return subprocess.Popen(
        module_command(module),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        bufsize=0,
        env=dict(environment),
        **options,
    )


def _descriptor(pipe: Any) -> int:
    return int(pipe.fileno())
