"""The run's side of a recording: starts the recorder process, gives it rows, and takes its report."""

import os
import subprocess
import sys
import tempfile
import threading
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from hil.child import away_from_terminal, module_command
from hil.errors import BadInputError, DeviceError
from hil.signals import SIGNAL_NAMES
from hil.telemetry.channel import LineReader, LineWriter, Patience
from hil.telemetry.environment import rerun_environment
from hil.telemetry.files import check_recording_path
from hil.telemetry.memory import SharedBlock
from hil.telemetry.ring import RingWriter, ring_bytes

_PATIENCE_WAITS = 60_000  # of 0.5 ms, without any progress of the recorder: about 30 s
_EXIT_TIMEOUT_S = 10.0


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """What became of the rows of a run.

    Attributes:
        path: the file, or None for a live view alone.
        rows_put: rows that the run gave.
        rows_written: rows that are safe in the file.
        rows_dropped: rows that found the ring full and were given up.
        rows_lost: rows that were taken, but are not known to be in the file: the recorder ended, or could
            not write.
        events_lost: events that could not be passed on.
        error: what went wrong with the recorder, or None.
    """

    path: Path | None
    rows_put: int
    rows_written: int
    rows_dropped: int
    rows_lost: int
    events_lost: int
    error: str | None

    @property
    def complete(self) -> bool:
        """Whether everything that the run gave was recorded."""
        return self.error is None and not (self.rows_dropped or self.rows_lost or self.events_lost)


class Recording:
    """A sink that records in a process of its own; a context manager.

    The constructor returns when the recorder is ready, about a second later. When the run dies, the recorder
    finishes the file by itself; when the recorder dies, the run goes on and the report says what is missing.

    Args:
        path: the ``.rrd`` file, or None for a live view alone. properties: what the run is, as texts by name
        (see ``hil.telemetry.provenance``). blocking: in lockstep, ``put`` waits for room in the ring; in real
        time it drops the row and counts. live_port: serve live viewers on this port of 127.0.0.1. capacity:
        rows that the ring holds. signals: the names of a row's values; ``loop.t_s``, ``loop.tick`` and what
        is drawn must be among them.

    Raises:
        BadInputError: the path cannot be written, or the port not be used.
        DeviceError: the recorder process did not start.
    """

    def __init__(
        self,
        path: Path | None,
        *,
        properties: Mapping[str, str],
        blocking: bool,
        live_port: int | None = None,
        capacity: int = 16384,
        signals: Sequence[str] = SIGNAL_NAMES,
    ) -> None:
        if path is not None:
            check_recording_path(path)
        self._path = path
        self._live_port = live_port
        self._waits = blocking
        self._report: RecordingReport | None = None
        self._block = SharedBlock.create(ring_bytes(capacity, len(signals)))
        self._ring = RingWriter(self._block, capacity, len(signals))
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 -- closed in close()
        self._process = _start(self._block, self._stderr)
        self._lines = LineWriter(_pipe(self._process.stdin))
        self._replies = LineReader(_pipe(self._process.stdout))
        self._lines.send(
            {
                "path": None if path is None else str(path.absolute()),
                "live_port": live_port,
                "properties": dict(properties),
                "signals": list(signals),
                "recording_id": str(uuid.uuid4()),
                "block": self._block.token,
                "block_bytes": ring_bytes(capacity, len(signals)),
                "parent_pid": os.getpid(),
            },
            always=True,
        )
        reply = self._reply()
        if "ready" not in reply:
            trouble = self._trouble()
            self.close()
            if "refused" in reply:
                raise BadInputError(str(reply["refused"]))
            raise DeviceError(f"the recorder did not start: {trouble}; run without a recording to go on")

    @property
    def path(self) -> Path | None:
        """The file, or None for a live view alone."""
        return self._path

    @property
    def pid(self) -> int:
        """Process id of the recorder."""
        return self._process.pid

    @property
    def rows_saved(self) -> int:
        """Rows that are safe in the file by now."""
        return self._ring.saved

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row in the order of the signals. Raises struct.error when its length is another."""
        if not self._ring.try_put(row) and not (self._waits and self._put_later(row)):
            self._ring.count_dropped()

    def event(self, t_s: float, level: str, text: str) -> None:
        """Add a line to the event log; ``level`` is debug, info, warning or error. Never waits."""
        self._lines.send({"event": [t_s, level, text]})

    def finish(self, summary: Mapping[str, object], *, keep_live: bool = False) -> RecordingReport:
        """Write the rest and the summary, and return the report; never raises for a recorder that died.

        With ``keep_live`` the file is finished, but live viewers are served until ``close``.
        """
        if self._report is None:
            keep_live = keep_live and self._live_port is not None
            self._lines.send({"finish": dict(summary), "keep_live": keep_live}, always=True)
            reply = self._reply()
            self._report = self._make_report(reply)
            if not keep_live:
                self.close()
        return self._report

    def close(self) -> None:
        """End the recorder, if need be without a summary, and free everything. Closing twice is allowed."""
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _put_later(self, row: tuple[float, ...]) -> bool:
        """Wait for room; False, now and for good, when the recorder has ended or makes no progress."""
        patience = Patience(_PATIENCE_WAITS)
        while self._process.poll() is None and patience.wait(self._ring.tail):
            if self._ring.try_put(row):
                return True
        self._waits = False
        return False

    def _reply(self) -> dict[str, Any]:
        """Return the recorder's next reply; empty when it ended without one, or makes no progress."""
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

    def _make_report(self, reply: Mapping[str, Any]) -> RecordingReport:
        written = int(reply["rows_written"]) if "rows_written" in reply else self._ring.saved
        error = reply.get("error") or reply.get("live_error")
        if not reply:
            error = f"the recorder ended before the run: {self._trouble()}"
        dropped = self._ring.dropped
        return RecordingReport(
            path=self._path,
            rows_put=self._ring.head + dropped,
            rows_written=written,
            rows_dropped=dropped,
            rows_lost=0 if self._path is None else self._ring.head - written,
            events_lost=self._lines.lost,
            error=error,
        )

    def _trouble(self) -> str:
        """Say how the recorder ended: its last words, or else its exit status."""
        status = self._process.wait()
        self._stderr.seek(0)
        words = self._stderr.read().decode(errors="replace").strip().splitlines()
        return words[-1] if words else f"exit status {status}"


def _start(block: SharedBlock, stderr: Any) -> "subprocess.Popen[bytes]":
    options = away_from_terminal()
    if sys.platform != "win32":
        options["pass_fds"] = block.pass_fds
    return subprocess.Popen(
        module_command("hil.telemetry.recorder"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=stderr,
        bufsize=0,
        env=rerun_environment(),
        **options,
    )


def _pipe(pipe: Any) -> int:
    return int(pipe.fileno())
