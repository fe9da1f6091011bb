"""Recordings and live views in rerun's format: rows, events and properties become columns of a stream.

A stream has one sink: a file, or a server that live viewers pull from. (A file and a pushing sink in one stream stall
each other when no viewer listens.) This module and the drawings that it calls write with rerun.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hil.core.printable import printable
from hil.record.blueprint import blueprint, first_blueprint
from hil.record.checks import WORDS, Words, WrittenBytes, event_check, numbered, row_crcs, with_check
from hil.record.claims import ClaimWatch, claims
from hil.record.course import Course, moments, windows
from hil.record.curves import Curves
from hil.record.drawings import RowTimes, Scene, Trails, indexes, nanoseconds, seconds_index, whole_times
from hil.record.layout import layout
from hil.record.limits import limits
from hil.record.properties import (
    APPLICATION,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PATH,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
    page,
    scenario_values,
)
from hil.record.ring import Rows
from hil.record.robot_model import RobotShape
from hil.record.shadow_curves import ShadowCurves
from hil.record.states import States
from hil.record.verdict import running, verdict
from hil.record.views import LOG, VERDICT

_DRAWN_AT_ONCE = 2000
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}
_FLUSH_TIMEOUT_S = 10.0
_SETTLED_S = 5.0


class Stream:
    """A rerun stream into one sink. Raises RuntimeError (from rerun) when the sink cannot be opened.

    Args:
        sink: ``rr.FileSink`` or ``rr.GrpcServerSink``.
        recording_id: the same for the file and the live stream of a run: viewers merge them.
        signals: names of the columns of every row.
        properties: facts about the run, as texts by name. Its ``scenario`` gives the robot's size, the limits and the
            faults; what is missing there is not drawn.
        live: for live viewers, which get only the signals that are drawn, and views of the last seconds.
        part: which file of the run it is (see ``hil.record.properties``); None for a run in one file.
        path: the file of the sink, so that its end can tell its bytes' CRC-32; None for a sink without a file.
    """

    def __init__(
        self,
        sink: rr.FileSink | rr.GrpcServerSink,
        *,
        recording_id: str,
        signals: Sequence[str],
        properties: Mapping[str, str],
        live: bool,
        part: Mapping[str, Any] | None = None,
        path: Path | None = None,
    ) -> None:
        self._column = {name: i for i, name in enumerate(signals)}
        self._layout = layout(signals)
        self._properties = dict(properties)
        self._live = live
        values = scenario_values(properties)
        self._shape = RobotShape.of(values)
        claimed = claims(values)
        self._watches = [ClaimWatch(claim, self._column, values) for claim in claimed]
        self._times = RowTimes(self._column)
        self._drawn_times = RowTimes(self._column)
        self._undrawn: list[Rows] = []
        self._span_s: tuple[float, float] | None = None  # of the rows that were drawn
        self._troubles: list[str] = []
        self._rerun = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        self._states = States(self._rerun, self._column, values, claimed, live=live)
        self._curves = Curves(self._rerun, self._layout, self._column, limits(values, claimed, self._layout), live=live)
        self._shadows = ShadowCurves(self._rerun, self._layout, self._column)
        views = first_blueprint(self._layout, limits=self._curves.limits, shape=self._shape, live=live)
        self._rerun.set_sinks(sink, default_blueprint=views)
        self._drawings: list[Trails | Scene | ShadowCurves] = [Trails(self._rerun, self._column), self._shadows]
        if self._shape is not None:
            torque_constant_n_m_a = values.get("firmware.torque_constant_n_m_a")
            self._drawings.append(Scene(self._rerun, self._column, self._shape, torque_constant_n_m_a))
        about = part or {}
        self._next_row, self._next_event = (int(about.get(name, 0)) for name in ("first_row", "first_event"))
        self._holds: list[str] = []
        self._written = None if path is None else WrittenBytes(path)
        if part is not None:
            self._property(PART_PROPERTY, {"json": json.dumps(part)})
        self._describe()
        self.flush()

    def rows(self, rows: Rows, first: int | None = None) -> None:
        """Write rows of shape (n, signals), unchanged, to the one entity from which they are read back.

        ``first`` is the number of the first of them in the run; None if it follows the last one.
        The views get them later, about ``_DRAWN_AT_ONCE`` rows at once: few large pieces need less disk, and each piece
        takes 2.8 kB in a reader's index.
        """
        first = self._next_row if first is None else first
        self._next_row = first + len(rows)
        times = self._times(rows)
        words = numbered(np.arange(first, self._next_row), row_crcs(*whole_times(times), rows))
        columns = [*rr.Scalars.columns(scalars=rows), *_words(words)]
        self._rerun.send_columns(SIGNALS_PATH, indexes(times), columns)
        self._undrawn.append(rows)
        if sum(map(len, self._undrawn)) >= _DRAWN_AT_ONCE:
            self._draw_rest()

    def draw(self, rows: Rows) -> None:
        """Write what the views show of rows of shape (n, signals): signals, states, bounds, trails and the robot."""
        if not len(rows):
            return
        times = self._drawn_times(rows)
        self._span_s = (times[0, 0] if self._span_s is None else self._span_s[0], times[-1, 0])
        checked = [(watch.claim, watch(rows)) for watch in self._watches]
        self._states.rows(rows, times, checked)
        drawn = len(self._curves.drawn)
        self._curves.rows(rows, times, checked)
        for drawing in self._drawings:
            drawing.rows(rows, times)
        if self._live and len(self._curves.drawn) != drawn:
            # Live viewers get only what is drawn, and show no plot that would be empty. A new layout takes back what
            # the user has changed in it, so it comes at the beginning alone.
            self._say_where({entity.path: [one.signal for one in entity.series] for entity in self._curves.drawn})
            if self._span_s[1] - self._span_s[0] < _SETTLED_S:
                self._rerun.send_blueprint(self._views(None))

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        index = [seconds_index(np.array([t_s]))]
        level, text = _LEVELS.get(level, "INFO"), printable(text)
        word = event_check(self._next_event, int(nanoseconds(np.array([t_s]))[0]), level, text)
        self._next_event += 1
        checks = _words(np.array([word], np.uint64))
        self._rerun.send_columns("/events", index, [*rr.TextLog.columns(text=[text], level=[level]), *checks])
        timed = rr.TextLog.columns(text=[f"{t_s:.3f} s  {text}"], level=[level])
        self._rerun.send_columns(LOG, index, timed)
        if level == "ERROR":
            self._troubles.append(text)
            self._tell(running(self._properties, self._troubles))

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the run's summary, also to the page, unless it is None; then the recorder's counts.

        The layout becomes that of a review: by now it is known what the run has, and where to look.
        """
        self._draw_rest()
        begin_s, end_s = self._span_s or (0.0, 0.0)
        violations = [watch.violation_s for watch in self._watches if watch.violation_s is not None]
        first = min(violations, default=None)
        failed_s = None if first is None else first[0]
        self._states.finish(summary, end_s, failed_s)
        next_part, troubles = recorder.get("next_part"), self._troubles
        said = verdict(
            self._properties, summary, end_s=end_s, failed_s=failed_s, next_part=next_part, troubles=troubles
        )
        self._tell(said)
        if summary is not None:
            self._property(SUMMARY_PROPERTY, {"json": json.dumps(summary)})
            self._page(summary)
        if self._span_s is not None:
            happened = moments(self._watches, self._states.begun, summary, end_s)
            found = windows(begin_s, end_s, summary, happened)
            violated, lines = tuple(self._curves.violated), said.count("\n- ") + 1
            course = Course(begin_s, end_s, violated, first, found, self._states.count, lines)
            self._rerun.send_blueprint(self._views(course))
        # A reader takes a file without these for one that was cut off.
        end: dict[str, object] = {"rows_until": self._next_row, "events_until": self._next_event, "holds": self._holds}
        if self._written is not None:
            self.flush()
            end |= {"bytes": self._written.count, "crc32": self._written.crc32}
        self._property(RECORDER_PROPERTY, {"json": json.dumps({**end, **recorder})})

    def flush(self) -> None:
        """Hand everything to the operating system. Raises RuntimeError when that fails (a full disk)."""
        # Without a limit, rerun 0.41 now and then waits for ever for a file whose writer has failed.
        self._rerun.flush(timeout_sec=_FLUSH_TIMEOUT_S)
        if self._written is not None:
            self._written.read()

    def close(self) -> None:
        """Flush, and close the sink: a file gets its footer. Raises RuntimeError when the flush fails."""
        self.flush()
        self._rerun.disconnect()
        if self._written is not None:
            self._written.close()

    def _views(self, course: Course | None) -> rrb.Blueprint:
        shadows = {law: self._shadows.rms(law) for law in self._shadows.laws}
        is_live = self._live and course is None
        limited = self._curves.limits
        entities = self._curves.drawn
        return blueprint(entities, limits=limited, shape=self._shape, live=is_live, shadows=shadows, course=course)

    def _describe(self) -> None:
        # This tells a reader where each signal is.
        self._say_where({} if self._live else {SIGNALS_PATH: list(self._column)})
        if self._properties:
            self._property(RUN_PROPERTY, self._properties)
        if "scenario_name" in self._properties:
            self._rerun.send_recording_name(self._properties["scenario_name"])
        for drawing in self._drawings:
            drawing.describe()
        self._page(None)
        self._tell(running(self._properties, ()))

    def _say_where(self, held: Mapping[str, Sequence[str]]) -> None:
        self._property(SIGNALS_PROPERTY, {"json": json.dumps(held)})

    def _property(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a property with its check value."""
        self._rerun.send_property(name, rr.AnyValues(drop_untyped_nones=True, **with_check(name, texts)))
        if name not in self._holds:
            self._holds.append(name)

    def _tell(self, text: str) -> None:
        """Show a text as the verdict."""
        self._rerun.log(VERDICT, rr.TextDocument(printable(text), media_type=rr.MediaType.MARKDOWN), static=True)

    def _page(self, summary: Mapping[str, object] | None) -> None:
        """Log the page: the run's properties and, at the end, its figures."""
        text = rr.TextDocument(printable(page(self._properties, summary)), media_type=rr.MediaType.MARKDOWN)
        self._rerun.log("/run", text, static=True)

    def _draw_rest(self) -> None:
        """Draw the rows that were written and not drawn yet."""
        if self._undrawn:
            rows = np.concatenate(self._undrawn)
            self._undrawn.clear()
            self.draw(rows)


def _words(words: Words) -> rr.ComponentColumnList:
    return rr.AnyValues.columns(drop_untyped_nones=True, **{WORDS: words})
