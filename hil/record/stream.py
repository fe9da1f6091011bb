"""Recordings in rerun's format: rows, events and properties become columns of a stream.

A stream has one sink: a file, or a server that live viewers pull from. (A file and a pushing sink in one stream stall
each other when no viewer listens.)
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.core.printable import printable
from hil.record.checks import WORDS, Contained, Words, WrittenBytes, event_check, numbered, row_crcs
from hil.record.properties import (
    APPLICATION,
    EVENTS_PATH,
    JOURNAL,
    JOURNAL_PATH,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PATH,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
)
from hil.record.ring import Rows
from hil.record.viewing import MakeDrawing

_DRAWN_AT_ONCE = 2000
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR", JOURNAL: JOURNAL}
_FLUSH_TIMEOUT_S = 10.0

Times = npt.NDArray[np.float64]
"""Scenario time [s] and tick of each row, shape (n, 2)."""


def seconds_index(t_s: npt.NDArray[np.float64]) -> rr.TimeColumn:
    """Return rerun's timeline ``t`` [s since the first ACTIVE tick], for times of shape (n,)."""
    return rr.TimeColumn("t", duration=nanoseconds(t_s).astype("timedelta64[ns]"))


def nanoseconds(t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return times as rerun stores them."""
    return np.rint(t_s * 1e9).astype(np.int64)


def whole_times(times: Times) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return time [ns] and tick of each row as rerun stores them."""
    return nanoseconds(times[:, 0]), np.rint(times[:, 1]).astype(np.int64)


def indexes(times: Times) -> list[rr.TimeColumn]:
    """Return both timelines: ``t``, and the number of the tick."""
    return [seconds_index(times[:, 0]), rr.TimeColumn("tick", sequence=whole_times(times)[1])]


class RowTimes:
    """Returns time and tick of each row; a value that is not finite becomes the last finite one of any call."""

    def __init__(self, column: Mapping[str, int]) -> None:
        self._columns = [column["loop.t_s"], column["loop.tick"]]
        self._last = np.zeros(2)

    def __call__(self, rows: Rows) -> Times:
        """Return the times of rows of shape (n, signals)."""
        times = np.vstack([self._last, rows[:, self._columns]])
        finite = np.isfinite(times)
        newest = np.maximum.accumulate(np.where(finite, np.arange(len(times))[:, None], 0), axis=0)
        times = np.take_along_axis(times, newest, axis=0)
        self._last = times[-1]
        return times[1:]


class Stream:
    """A rerun stream into one sink. Raises RuntimeError (from rerun) when the sink cannot be opened.

    Args:
        recording_id: the same for the file and the live stream of a run: viewers merge them.
        signals: names of the columns of every row. properties: facts about the run, as texts by name.
        make_drawing: makes what viewers show (see ``hil.record.viewing``); None for rows, events and properties alone.
        live: for live viewers, which get the drawing and no rows.
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
        make_drawing: MakeDrawing | None,
        live: bool = False,
        part: Mapping[str, Any] | None = None,
        path: Path | None = None,
    ) -> None:
        self._times = RowTimes({name: i for i, name in enumerate(signals)})
        self._undrawn: list[Rows] = []
        self._contained = Contained(part or {})
        self._rerun = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        self._drawing = None if make_drawing is None else make_drawing(self._rerun, signals, properties, live)
        views = None if self._drawing is None else self._drawing.blueprint
        self._rerun.set_sinks(sink, default_blueprint=views)
        self._written = None if path is None else WrittenBytes(path)
        if part is not None:
            self._property(PART_PROPERTY, {"json": json.dumps(part)})
        held = {} if live else {SIGNALS_PATH: list(signals)}
        self._property(SIGNALS_PROPERTY, {"json": json.dumps(held)})
        if properties:
            self._property(RUN_PROPERTY, properties)
        if "scenario_name" in properties:
            self._rerun.send_recording_name(properties["scenario_name"])
        if self._drawing is not None:
            self._drawing.describe()
        self.flush()

    def rows(self, rows: Rows, first: int | None = None) -> None:
        """Write rows of shape (n, signals), unchanged, to the one entity from which they are read back.

        ``first`` is the number of the first of them in the run; None if it follows the last one.
        The views get them later, about ``_DRAWN_AT_ONCE`` rows at once: few large pieces need less disk, and each piece
        takes 2.8 kB in a reader's index.
        """
        first = self._contained.add_rows(len(rows), first)
        times = self._times(rows)
        words = numbered(np.arange(first, first + len(rows)), row_crcs(*whole_times(times), rows))
        columns = [*rr.Scalars.columns(scalars=rows), *_words(words)]
        self._rerun.send_columns(SIGNALS_PATH, indexes(times), columns)
        if self._drawing is not None:
            self._undrawn.append(rows)
            if sum(map(len, self._undrawn)) >= _DRAWN_AT_ONCE:
                self._draw_rest()

    def draw(self, rows: Rows) -> None:
        """Write what the views show of rows of shape (n, signals)."""
        if self._drawing is not None and len(rows):
            self._drawing.rows(rows)

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        level, text = _LEVELS.get(level, "INFO"), printable(text)
        number, t_ns = self._contained.add_event(), int(nanoseconds(np.array([t_s]))[0])
        checks = _words(np.array([event_check(number, t_ns, level, text)], np.uint64))
        index = [seconds_index(np.array([t_s]))]
        entity = JOURNAL_PATH if level == JOURNAL else EVENTS_PATH
        self._rerun.send_columns(entity, index, [*rr.TextLog.columns(text=[text], level=[level]), *checks])
        if self._drawing is not None and level != JOURNAL:
            self._drawing.event(t_s, level, text)

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the run's summary, unless it is None; then the recorder's counts."""
        self._draw_rest()
        if summary is not None:
            self._property(SUMMARY_PROPERTY, {"json": json.dumps(summary)})
        if self._drawing is not None:
            self._drawing.finish(summary, recorder.get("next_part"))
        # A reader takes a file without these for one that was cut off.
        end = self._contained.end()
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

    def _property(self, name: str, texts: Mapping[str, str]) -> None:
        self._rerun.send_property(name, rr.AnyValues(drop_untyped_nones=True, **self._contained.checked(name, texts)))

    def _draw_rest(self) -> None:
        if self._undrawn:
            rows = np.concatenate(self._undrawn)
            self._undrawn.clear()
            self.draw(rows)


def _words(words: Words) -> rr.ComponentColumnList:
    return rr.AnyValues.columns(drop_untyped_nones=True, **{WORDS: words})
