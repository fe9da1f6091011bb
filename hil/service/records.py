"""The recordings of a service: one that starts and ends on orders, and one for live viewers."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.core.outputs import Existing
from hil.record import Recording, RecordingReport
from hil.scenario.tables import ServiceTable
from hil.service import logs


class Records:
    """A sink of rows and events; its recording starts and ends on orders. Only the thread of the ticks uses it.

    ``live`` serves viewers, or is None.

    Attributes:
        trouble: why the recording cannot be written, or why it was ended before it was to end; None if it is well.
    """

    def __init__(self, live: Recording | None) -> None:
        self._live = live
        self._recording: Recording | None = None
        self._ended: list[Recording] = []  # that are not finished yet
        self._dropped = self._lost = 0  # by those that are
        self._deaths_told = {live: 0} if live is not None else {}
        self.trouble: str | None = None

    @property
    def path(self) -> Path | None:
        """The file being written, of several the newest; None without a recording."""
        return None if self._recording is None else self._recording.part

    @property
    def rows_dropped(self) -> int:
        """Number of rows for which recorders have had no room since the service began."""
        return self._dropped + sum(recording.rows_dropped for recording in self._open())

    @property
    def rows_lost(self) -> int:
        """Number of rows that recorders could not write since the service began."""
        return self._lost + sum(recording.rows_lost for recording in self._open())

    def _open(self) -> list[Recording]:
        return self._ended if self._recording is None else [*self._ended, self._recording]

    def begin(self, recording: Recording) -> None:
        """Record from the next row on."""
        self._recording = recording
        self._deaths_told[recording] = 0
        self.trouble = None
        for ended in [one for one in self._ended if one.report is not None]:
            self._ended.remove(ended)
            self._dropped += ended.rows_dropped
            self._lost += ended.rows_lost

    def watch(self, t_s: float) -> str | None:
        """Return why the recording cannot be written at present, and report when that begins and ends."""
        self._tell_of_deaths(t_s)
        if self._recording is None:
            return None
        if (trouble := self._recording.failing) != self.trouble:
            self.trouble = trouble
            path, lost = self._recording.path, self._recording.rows_lost
            if trouble is None:
                self._tell(t_s, "warning", "recording is written again", path=path, rows_lost=lost)
            else:
                self._tell(t_s, "error", "recording cannot be written", path=path, rows_lost=lost, why=trouble)
        return trouble

    def _tell_of_deaths(self, t_s: float) -> None:
        """Report each recorder process that has ended; another takes its place, and goes on in the next file."""
        for recording, told in self._deaths_told.items():
            for why in recording.troubles[told:]:
                self._deaths_told[recording] += 1
                self._tell(t_s, "warning", "recorder ended", path=recording.path, why=why)

    def end(self) -> Recording | None:
        """Stop recording; return the recording for ``finished``, or None."""
        recording, self._recording = self._recording, None
        if recording is not None:
            del self._deaths_told[recording]
            self._ended.append(recording)
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

    def note(self, t_s: float, level: str, text: str, event: str = "note", **fields: object) -> None:
        """Write an event to the recording, the viewers and the service's log.

        In the log it is ``event``, a constant, with ``fields``, or with the text where there are none.
        """
        for recording in (self._recording, self._live):
            if recording is not None:
                recording.event(t_s, level, text)
        logs.log(level, event, **(fields or {"text": text}), t_s=round(t_s, 3))

    def _tell(self, t_s: float, level: str, event: str, **fields: object) -> None:
        self.note(t_s, level, f"{event}: {fields['why']}" if "why" in fields else event, event, **fields)


def recording_of(
    about: Mapping[str, str],
    signals: Sequence[str],
    path: Path | None,
    table: ServiceTable,
    live_port: int | None = None,
    existing: Existing = "refuse",
) -> Recording:
    """Start a recording of a service, to a file or only for live viewers; takes longer than a tick.

    ``about`` are the recording's properties, which describe the parts of the service. ``table`` says what the folder of
    the file may hold. ``existing`` says what to do when the file exists; a changed name is logged.

    Raises BadInputError and DeviceError as ``Recording``.
    """
    recording = Recording(
        path,
        properties=about,
        blocking=False,
        live_port=live_port,
        signals=signals,
        rotation=table.rotation,
        keeping=table.keeping,
        existing=existing,
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
