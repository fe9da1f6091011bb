"""The recordings of a service: one that starts and ends on orders, and one for live viewers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.core.outputs import Existing
from hil.record import Recording, RecordingReport
from hil.service import logs


class Records:
    """A sink of rows and events; its recording starts and ends on orders. Only the thread of the ticks uses it.

    ``live`` serves viewers, or is None.
    """

    def __init__(self, live: Recording | None) -> None:
        self._live = live
        self._recording: Recording | None = None
        self._dropped = 0

    @property
    def path(self) -> Path | None:
        """The file being written, or None."""
        return None if self._recording is None else self._recording.path

    @property
    def rows_dropped(self) -> int:
        """Number of rows that recordings have dropped since the service began."""
        return self._dropped + (0 if self._recording is None else self._recording.ring.dropped)

    def begin(self, recording: Recording) -> None:
        """Record from the next row on."""
        self._recording = recording

    def end(self) -> Recording | None:
        """Stop recording; return the recording for ``finished``, or None."""
        recording, self._recording = self._recording, None
        if recording is not None:
            self._dropped += recording.ring.dropped
        return recording

    def finish(self) -> None:
        """End and finish the recording, if there is one; takes longer than a tick."""
        if (recording := self.end()) is not None:
            finished(recording)

    def put(self, row: bytes) -> None:
        """Write one row, in the order of the signals."""
        for recording in (self._recording, self._live):
            if recording is not None:
                recording.put(row)

    def note(self, t_s: float, level: str, text: str) -> None:
        """Write an event to the recording, the viewers and the service's log."""
        for recording in (self._recording, self._live):
            if recording is not None:
                recording.event(t_s, level, text)
        logs.log(level, text, t_s=round(t_s, 3))


def recording_of(
    about: Mapping[str, str],
    signals: Sequence[str],
    path: Path | None,
    live_port: int | None = None,
    existing: Existing = "refuse",
) -> Recording:
    """Start a recording of a service, to a file or only for live viewers; takes longer than a tick.

    ``about`` are the recording's properties, which describe the parts of the service. ``existing`` says what to do when
    the file exists; a changed name is logged. Raises BadInputError and DeviceError as ``Recording``.
    """
    recording = Recording(
        path, properties=about, blocking=False, live_port=live_port, signals=signals, existing=existing
    )
    if recording.path != path:
        logs.warning(
            "a recording of this name exists already; another name was chosen", asked=path, path=recording.path
        )
    return recording


def finished(recording: Recording) -> RecordingReport:
    """Finish a recording and log the outcome; takes longer than a tick."""
    report = recording.finish({})
    rows = {"rows": report.rows_written, "dropped": report.rows_dropped, "lost": report.rows_lost}
    if report.complete:
        logs.info("recording finished", path=report.path, **rows)
    else:
        logs.error("recording is not complete", path=report.path, **rows, why=report.error)
    return report
