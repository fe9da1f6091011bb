"""Recordings without a recorder process, by the recorder's own writer, for a process that does hundreds of runs."""

import array
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Self

import numpy as np
import rerun as rr

from hil.core.outputs import Existing, claim
from hil.core.signals import SIGNAL_NAMES
from hil.record import RecordingReport
from hil.record.stream import Stream


class RecordingHere:
    """A ``RunRecording`` that is written in this process when the run is over; for lockstep without deadlines.

    A recorder process takes half a second and more to start, mostly to import rerun. The file is the same.
    """

    def __init__(
        self,
        path: Path,
        *,
        properties: Mapping[str, str],
        blocking: bool,
        live_port: None = None,
        signals: Sequence[str] = SIGNAL_NAMES,
        existing: Existing = "refuse",
        wait: bool = False,
    ) -> None:
        assert blocking, "in real time nothing waits for it"
        self.rows_dropped = 0
        self.path: Path = claim("recording", path, existing)
        self._rows = array.array("d")
        self._width = len(signals)
        self._stream = Stream(
            rr.FileSink(self.path),
            recording_id=str(uuid.uuid4()),
            signals=signals,
            properties=properties,
            live=False,
            path=self.path,
        )

    def put(self, row: bytes) -> None:
        """Take one row in the order of the signals."""
        self._rows.frombytes(row)

    def event(self, t_s: float, level: str, text: str) -> None:
        """Add a line to the event log."""
        self._stream.event(t_s, level, text)

    def finish(self, summary: Mapping[str, object], *, keep_live: bool = False) -> RecordingReport:
        """Write the rows and the summary."""
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, self._width)
        if len(rows):
            self._stream.rows(rows)
        self._stream.finish(summary, {"rows_written": len(rows), "rows_dropped": 0})
        self._stream.close()
        return RecordingReport(self.path, len(rows), len(rows), 0, 0, 0, None, (self.path,))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release nothing; a recording that was not finished is of no use."""
