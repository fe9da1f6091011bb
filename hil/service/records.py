"""Where a service's rows and events go: to a recording while there is one, and to live viewers all the time."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hil.core.outputs import Existing
from hil.record import Recording, RecordingReport
from hil.runtime.provenance import properties
from hil.scenario import Scenario
from hil.service import logs


class Records:
    """A sink, and a ``Note``, whose recording comes and goes; for one thread, that of the ticks.

    ``live`` serves viewers, None for none. ``dropped`` counts the rows that recordings which have ended dropped.
    """

    def __init__(self, live: Recording | None) -> None:
        self._live = live
        self._recording: Recording | None = None
        self._dropped = 0

    @property
    def path(self) -> Path | None:
        """The file that is being written, None while there is none."""
        return None if self._recording is None else self._recording.path

    @property
    def rows_dropped(self) -> int:
        """Rows that recordings dropped since the service began."""
        return self._dropped + (0 if self._recording is None else self._recording.rows_dropped)

    def begin(self, recording: Recording) -> None:
        """Record from the next row on."""
        self._recording = recording

    def end(self) -> Recording | None:
        """Record no more; return the recording, which has to be finished."""
        recording, self._recording = self._recording, None
        if recording is not None:
            self._dropped += recording.rows_dropped
        return recording

    def put(self, row: tuple[float, ...]) -> None:
        """Take one row in the order of the signals."""
        if self._recording is not None:
            self._recording.put(row)
        if self._live is not None:
            self._live.put(row)

    def note(self, t_s: float, level: str, text: str) -> None:
        """Take a line of the event log, which goes into the service's own log too."""
        for recording in (self._recording, self._live):
            if recording is not None:
                recording.event(t_s, level, text)
        say: Mapping[str, Callable[..., None]] = {"warning": logs.warning, "error": logs.error}
        say.get(level, logs.info)(text, t_s=round(t_s, 3))


def recording_of(
    scenario: Scenario,
    signals: Sequence[str],
    path: Path | None,
    live_port: int | None = None,
    existing: Existing = "refuse",
    *,
    made_of: Mapping[str, str],
) -> Recording:
    """Start a recording of a service: to a file, or for live viewers alone; takes longer than a tick.

    ``made_of`` are the ``ingredients`` of the service's parts, for files may have changed since these were made.
    ``existing`` says what is done where the file is there already; that another name was taken is logged. Raises
    BadInputError and DeviceError as ``Recording``.
    """
    recording = Recording(
        path,
        properties=properties(scenario, made_of),
        blocking=False,
        live_port=live_port,
        signals=signals,
        existing=existing,
    )
    if recording.path != path:
        logs.warning(
            "a recording of this name is there already; another name was taken", asked=path, path=recording.path
        )
    return recording


def finished(recording: Recording, summary: Mapping[str, Any]) -> RecordingReport:
    """Finish a recording and log what became of it; takes longer than a tick."""
    report = recording.finish(summary)
    say = logs.info if report.complete else logs.error
    say(
        "recording finished" if report.complete else "recording is not complete",
        path=report.path,
        rows=report.rows_written,
        dropped=report.rows_dropped,
        lost=report.rows_lost,
        **({} if report.error is None else {"why": report.error}),
    )
    return report
