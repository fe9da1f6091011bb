"""The recordings of a service: one that starts and ends on orders, and one for live viewers."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from hil.addons.service import logs
from hil.core.errors import BadInputError
from hil.record.files import make_folder, rotation
from hil.record.recording import Recording, RecordingReport
from hil.scenario.tables import ServiceTable

_LONGEST_NAME = 200  # bytes; a file's name may have 255, and that of a later part is longer
# All of ASCII that a shell leaves alone, and the letters of all scripts.
_PLAIN_NAME = re.compile(r"[^\x00-/:-@\[-^`{-\x7f][^\x00-*/:-<>?\[-^`{-\x7f]*")


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
        self._reported_deaths = {live: 0} if live is not None else {}
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
        self._reported_deaths[recording] = 0
        self.trouble = None
        for ended in [one for one in self._ended if one.report is not None]:
            self._ended.remove(ended)
            self._dropped += ended.rows_dropped
            self._lost += ended.rows_lost

    def watch(self, t_s: float) -> str | None:
        """Return why the recording cannot be written at present, and report when that begins and ends."""
        self._report_deaths(t_s)
        if self._recording is None:
            return None
        if (trouble := self._recording.failing) != self.trouble:
            self.trouble = trouble
            path, lost = self._recording.path, self._recording.rows_lost
            if trouble is None:
                self._report(t_s, "warning", "recording is written again", path=path, rows_lost=lost)
            else:
                self._report(t_s, "error", "recording cannot be written", path=path, rows_lost=lost, why=trouble)
        return trouble

    def _report_deaths(self, t_s: float) -> None:
        """Report each recorder process that has ended; another takes its place, and goes on in the next file."""
        for recording, reported in self._reported_deaths.items():
            for why in recording.troubles[reported:]:
                self._reported_deaths[recording] += 1
                self._report(t_s, "warning", "recorder ended", path=recording.path, why=why)

    def end(self) -> Recording | None:
        """Stop recording; return the recording for ``finished``, or None."""
        recording, self._recording = self._recording, None
        if recording is not None:
            del self._reported_deaths[recording]
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

    def _report(self, t_s: float, level: str, event: str, **fields: object) -> None:
        self.note(t_s, level, f"{event}: {fields['why']}" if "why" in fields else event, event, **fields)


def recording_of(
    about: Mapping[str, str],
    signals: Sequence[str],
    path: Path | None,
    table: ServiceTable,
    live_port: int | None = None,
) -> Recording:
    """Start a recording of a service, to a file or only for live viewers; takes longer than a tick.

    ``about`` are the recording's properties, which describe the parts of the service. ``table`` says what the folder of
    the file may hold. A file that exists stays: the next free name is taken, and logged.

    Raises BadInputError and DeviceError as ``Recording``.
    """
    recording = Recording(
        path,
        properties=about,
        blocking=False,
        live_port=live_port,
        signals=signals,
        rotation=rotation(table.rotate),
        quota_bytes=round(table.recordings_gb * 1e9) or None,
        existing="number",
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


def named_in(folder: Path, name: str) -> Path:
    """Return the path of a recording ``name`` in a service's folder, which is made if missing.

    Clients choose the name, and scripts of whoever looks after the folder meet it: one that a shell or a command takes
    for more than a file's name is refused.

    Raises BadInputError for a name that is not plain or too long, and when the folder cannot be made.
    """
    is_plain = _PLAIN_NAME.fullmatch(name) is not None and name.isprintable()  # no space is, but the one of ASCII
    if not is_plain or len(name.encode()) > _LONGEST_NAME:
        raise BadInputError(
            f"recording {name[:_LONGEST_NAME]!r}: expected a file's name of at most {_LONGEST_NAME} bytes that begins "
            "with a letter, a digit or _ and has only these and . , - + = @ in it; this service records to "
            f"{folder} (service.recordings)"
        )
    make_folder(folder, "set service.recordings")
    return folder / name
