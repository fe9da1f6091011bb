"""The run's side of a recording: starts the recorder process, sends it rows and events, and receives its report."""

import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from hil.core.errors import HilError
from hil.core.outputs import Existing, claim, release
from hil.core.signals import SIGNAL_NAMES
from hil.record import viewing
from hil.record.files import Rotation, check_output_path, numbered_path
from hil.record.ring import Kept
from hil.record.ring_process import RingProcess
from hil.record.started_process import WITH_RERUN, StartedProcess, rerun_environment


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """How many rows and events of a run were recorded, and what went wrong.

    Attributes:
        path: the file, or None if there was only a live view.
        rows_put: rows that the run passed to ``put``; rows_written: those that are safe in the files.
        rows_dropped: rows that were discarded because the ring was full.
        rows_lost: rows that entered the ring but are not known to be in a file: the recorder ended, or could not write.
        events_lost: events that are not known to be in a file.
        error: why a row, an event or the summary is missing; None if nothing is.
        parts: the existing files, in order; several if the recording was rotated, or continued in a new file after an
            error.
        restarts: how often the recorder process died and was started again.
        troubles: all problems during the run, also those that lost nothing.
    """

    path: Path | None
    rows_put: int
    rows_written: int
    rows_dropped: int
    rows_lost: int
    events_lost: int
    error: str | None
    parts: tuple[Path, ...] = ()
    restarts: int = 0
    troubles: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether everything that the run put was recorded."""
        return self.error is None and not (self.rows_dropped or self.rows_lost or self.events_lost)


class RunRecording(AbstractContextManager["RunRecording"], Protocol):
    """The part of ``Recording`` that a run uses."""

    @property
    def path(self) -> Path | None:
        """The file, or None if there is only a live view."""

    @property
    def rows_dropped(self) -> int:
        """Rows that were discarded so far because the recorder was too slow."""

    def put(self, row: bytes) -> None:
        """Take one row in the order of the signals."""

    def event(self, t_s: float, level: str, text: str) -> None:
        """Add a line to the event log."""

    def finish(self, summary: Mapping[str, object], *, keep_live: bool = False) -> RecordingReport:
        """Write the remaining rows and the summary, and return the report."""


def _start_recorder(suffix: str | None, *, live: bool) -> StartedProcess:
    arguments = []
    if live or suffix == ".rrd":
        arguments = [WITH_RERUN, *(place for name, place in viewing.places().items() if name == "drawing")]
    return StartedProcess("hil.record.recorder", rerun_environment(), *arguments)


@contextmanager
def early_recorder(suffix: str | None, *, live: bool = False) -> Iterator[Callable[..., "Recording"]]:
    """Start the recorder process now, so that it imports its libraries while the run gets ready.

    Yields a callable that makes the Recording. ``suffix`` is the file's, None for live viewers alone. A process that no
    Recording uses ends with the context. Raises OSError if it cannot start.
    """
    with _start_recorder(suffix, live=live) as started:
        yield partial(Recording, started=started)


class Recording(RingProcess):
    """A sink that records in a separate process; a context manager.

    The recorder is ready after half a second, or sooner if it was ``started`` before. If the run dies, the recorder
    finishes the file on its own. If the recorder dies, the run goes on: a new recorder continues in the next file
    (``RUN-2.rrd``), beginning with the rows that were not safe yet. See RECORDING.md.

    Raises BadInputError for a path or port that cannot be used, DeviceError when the recorder did not start.

    Args:
        path: the ``.rrd`` or ``.mcap`` file, or None if there is only a live view.
        properties: facts about the run, as texts by name (see ``hil.runtime.provenance``).
        live_port: serve live viewers on this port of 127.0.0.1.
        capacity: rows that the ring holds.
        signals: the names of a row's values, with ``loop.t_s``, ``loop.tick`` and the signals that are drawn.
        rotation: when the recording continues in the next file.
        quota_bytes: what the recordings in the folder of the file may take; None for no limit.
        existing: what to do if the file exists; attribute ``path`` has the name that was chosen.
        started: a recorder process that is already running (see ``early_recorder``); by default one is started now.
        blocking, wait: as of ``RingProcess``.
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
        rotation: Rotation = Rotation(),  # noqa: B008 -- immutable
        quota_bytes: int | None = None,
        existing: Existing = "refuse",
        started: StartedProcess | None = None,
        wait: bool = True,
    ) -> None:
        if live_port is not None:
            viewing.check_live(live_port)
        if path is not None:
            check_output_path("recording", path, existing)
            path = claim("recording", path, existing)
        self.path = path
        self._existing = existing
        self._live_port = live_port
        self._result: RecordingReport | None = None
        config = {
            "path": None if path is None else str(path.absolute()),
            "live_port": live_port,
            "properties": dict(properties),
            "signals": list(signals),
            "recording_id": str(uuid.uuid4()),
            "zero_unix_ns": time.time_ns(),
            "rotate": list(rotation),
            "quota_bytes": quota_bytes,
            "viewer": viewing.places(),
        }
        try:
            super().__init__(
                started or _start_recorder(None if path is None else path.suffix, live=live_port is not None),
                config,
                width=len(signals),
                capacity=capacity,
                blocking=blocking,
                wait=wait,
            )
        except BaseException:
            self._release()
            raise

    def wait_ready(self) -> None:
        """Wait until the recorder is ready. Raises as the constructor; no file is left then."""
        try:
            super().wait_ready()
        except HilError:
            self._release()
            raise

    def _release(self) -> None:
        if self.path is not None:
            release(self.path, self._existing)

    @property
    def part(self) -> Path | None:
        """The file that is written now, ``path`` or a later part of it; only until ``finish``."""
        return None if self.path is None else numbered_path(self.path, max(1, self.ring.file_number))

    @property
    def report(self) -> RecordingReport | None:
        """What ``finish`` has returned; None before."""
        return self._result

    @property
    def rows_dropped(self) -> int:
        return self.ring.dropped if self._result is None else self._result.rows_dropped

    @property
    def rows_lost(self) -> int:
        """Rows that were put and are in no file, as far as that is known by now."""
        return self.ring.tail - self.ring.saved if self._result is None else self._result.rows_lost

    def event(self, t_s: float, level: str, text: str) -> None:
        """Add a line to the event log; ``level`` is debug, info, warning or error. Never waits."""
        self.send({"event": [t_s, level, text]})

    def finish(self, summary: Mapping[str, object], *, keep_live: bool = False) -> RecordingReport:
        """Write the rows that are still in the ring, then the summary; close the file and return the report.

        If the recorder process died, the report says so. With ``keep_live`` live viewers are still served after that,
        until ``close``. Raises only as ``wait_ready``.
        """
        if self._result is None:
            keep_live = keep_live and self._live_port is not None
            self._result = self._make_report(self.end(summary, keep_live=keep_live))
            if not keep_live:
                self.close()
        return self._result

    def _make_report(self, reply: Mapping[str, Any]) -> RecordingReport:
        kept = {} if self.path is None else self.ring.files()
        paths = {} if self.path is None else {number: numbered_path(self.path, number) for number in kept}
        gone = [number for number, path in paths.items() if not path.exists()]
        rows_gone, events_gone = sum(kept[number].rows for number in gone), sum(kept[number].lines for number in gone)
        written = self.ring.saved - rows_gone
        lost = 0 if self.path is None else self.ring.head - self.ring.saved + rows_gone
        events_lost = self.lines_lost + events_gone
        troubles = [f"the recorder ended: {trouble}" for trouble in self.troubles]
        if reply.get("trouble"):
            troubles.append(reply["trouble"])
        if rows_gone or events_gone:
            names = ", ".join(paths[number].name for number in gone)
            troubles.append(f"{names}: removed or moved away, with {rows_gone} rows and {events_gone} events")
        missing = lost or self.ring.dropped or events_lost
        why = "; ".join(dict.fromkeys(troubles)) if missing else None
        return RecordingReport(
            path=self.path,
            rows_put=self.ring.head + self.ring.dropped,
            rows_written=written,
            rows_dropped=self.ring.dropped,
            rows_lost=lost,
            events_lost=events_lost,
            error=reply.get("error") or reply.get("live_error") or why or None,
            parts=tuple(path for number, path in paths.items() if number not in gone),
            restarts=self.restarts,
            troubles=(*troubles, *self._left_alone(kept)),
        )

    def _left_alone(self, kept: Mapping[int, Kept]) -> Iterator[str]:
        """Name the files of other runs that are where a file of this run would have been written."""
        if self.path is not None and len(kept) < max(kept, default=0):
            others = [numbered_path(self.path, number).name for number in range(1, max(kept)) if number not in kept]
            yield f"it did not go on in {', '.join(others)}: there was such a file before, which was left alone"
