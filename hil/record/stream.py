"""Recordings and live views in rerun's format: rows, events and properties become columns of a stream.

A stream has one sink: a file, or a server that live viewers pull from. (A file and a pushing sink in one stream stall
each other when no viewer listens.) This module and ``drawings`` alone write with rerun.
"""

import json
import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import rerun as rr

from hil.record.blueprint import blueprint
from hil.record.decimate import Decimator
from hil.record.drawings import RowTimes, Scene, Times, Trails, indexes, seconds_index
from hil.record.lanes import LIMITS_PATH, Lane, Limit, lanes, limit_values, limits
from hil.record.layout import ALARM_COLOUR, Colour, Series, layout
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
from hil.record.viewer import HOST

DRAWN_PERIOD_S = 0.005
_DRAWN_AT_ONCE = 2000
_LIMIT_PERIOD_S = 0.1
_LIMIT_WIDTH_PX = 1.0
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}
_FLUSH_TIMEOUT_S = 10.0
LIVE_PERIOD_S = 0.01
_QUEUE_LENGTH = 500
_MEMORY_LIMIT = "256MiB"
_CLOSE_TIMEOUT_S = 2.0


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
    """

    def __init__(
        self,
        sink: rr.FileSink | rr.GrpcServerSink,
        *,
        recording_id: str,
        signals: Sequence[str],
        properties: Mapping[str, str],
        live: bool,
        part: Mapping[str, object] | None = None,
    ) -> None:
        self._column = {name: i for i, name in enumerate(signals)}
        self._layout = layout(signals)
        self._entities = [
            (entity.path, [self._column[series.signal] for series in entity.series]) for entity in self._layout
        ]
        self._properties = dict(properties)
        values = scenario_values(properties)
        shape = RobotShape.of(values)
        self._lanes = lanes(self._column, values)
        self._lane_states: dict[str, str] = {}  # the newest, by the lane's path
        self._limits = limits(values, self._layout)
        self._limit_decimator = Decimator(_LIMIT_PERIOD_S)
        self._drawn_decimator = Decimator(DRAWN_PERIOD_S)
        self._times = RowTimes(self._column)
        self._drawn_times = RowTimes(self._column)
        self._undrawn: list[Rows] = []
        self._rerun = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        views = blueprint(self._layout, limits=self._limits, shape=shape, live=live)
        self._rerun.set_sinks(sink, default_blueprint=views)
        self._drawings: list[Trails | Scene] = [Trails(self._rerun, self._column)]
        if shape is not None:
            torque_constant_n_m_a = values.get("firmware.torque_constant_n_m_a")
            self._drawings.append(Scene(self._rerun, self._column, shape, torque_constant_n_m_a))
        if part is not None:
            self._rerun.send_property(PART_PROPERTY, rr.AnyValues(json=json.dumps(part)))
        self._describe(live=live)
        self.flush()

    def rows(self, rows: Rows) -> None:
        """Write rows of shape (n, signals), unchanged, to the one entity from which they are read back.

        The views get them later, about ``_DRAWN_AT_ONCE`` rows at once: few large pieces need less disk, and each piece
        takes 2.8 kB in a reader's index.
        """
        self._rerun.send_columns(SIGNALS_PATH, indexes(self._times(rows)), rr.Scalars.columns(scalars=rows))
        self._undrawn.append(rows)
        if sum(map(len, self._undrawn)) >= _DRAWN_AT_ONCE:
            self._draw_rest()

    def draw(self, rows: Rows) -> None:
        """Write what the views show of rows of shape (n, signals): each signal at most once per ``DRAWN_PERIOD_S``."""
        times = self._drawn_times(rows)
        for lane in self._lanes:
            self._state_changes(lane, rows, times)
        drawn = self._drawn_decimator.keep(times[:, 0])
        if len(drawn):
            index, values = indexes(times[drawn]), rows[drawn]
            for path, columns in self._entities:
                self._rerun.send_columns(path, index, rr.Scalars.columns(scalars=values[:, columns]))
        self._draw_limits(rows, times)
        for drawing in self._drawings:
            drawing.rows(rows, times)

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        line = rr.TextLog.columns(text=[text], level=[_LEVELS.get(level, "INFO")])
        self._rerun.send_columns("/events", [seconds_index(np.array([t_s]))], line)

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the run's summary, also to the page, unless it is None; then the recorder's counts."""
        self._draw_rest()
        if summary is not None:
            self._rerun.send_property(SUMMARY_PROPERTY, rr.AnyValues(json=json.dumps(summary)))
            self._page(summary)
        # A reader takes a file without these for one that was cut off.
        self._rerun.send_property(RECORDER_PROPERTY, rr.AnyValues(json=json.dumps(recorder)))

    def flush(self) -> None:
        """Hand everything to the operating system. Raises RuntimeError when that fails (a full disk)."""
        # Without a limit, rerun 0.41 now and then waits for ever for a file whose writer has failed.
        self._rerun.flush(timeout_sec=_FLUSH_TIMEOUT_S)

    def close(self) -> None:
        """Flush, and close the sink: a file gets its footer. Raises RuntimeError when the flush fails."""
        self.flush()
        self._rerun.disconnect()

    def _describe(self, *, live: bool) -> None:
        drawn = {entity.path: [series.signal for series in entity.series] for entity in self._layout}
        # This tells a reader where each signal is: live viewers get only what is drawn.
        held = drawn if live else {SIGNALS_PATH: list(self._column)}
        self._rerun.send_property(SIGNALS_PROPERTY, rr.AnyValues(json=json.dumps(held)))
        if self._properties:
            self._rerun.send_property(RUN_PROPERTY, rr.AnyValues(drop_untyped_nones=True, **self._properties))
        if "scenario_name" in self._properties:
            self._rerun.send_recording_name(self._properties["scenario_name"])
        for entity in self._layout:
            self._line_style(entity.path, entity.series, [one.colour for one in entity.series], entity.width_px)
        for path, lines in self._limits.items():
            self._line_style(LIMITS_PATH + path, lines, [ALARM_COLOUR] * len(lines), _LIMIT_WIDTH_PX)
        for lane in self._lanes:
            # As an array: rerun would take a list of three or four numbers for one colour.
            colours = np.array(lane.colours, dtype=np.uint32)
            states = rr.StateConfiguration(values=list(lane.names.values()), colors=colours)
            self._rerun.log(lane.path, states, static=True)
        for drawing in self._drawings:
            drawing.describe()
        self._page(None)

    def _line_style(
        self, path: str, lines: Sequence[Series | Limit], colours: Sequence[Colour], width_px: float
    ) -> None:
        labels, widths = [line.label for line in lines], [width_px] * len(lines)
        self._rerun.log(path, rr.SeriesLines(names=labels, colors=colours, widths=widths), static=True)

    def _page(self, summary: Mapping[str, object] | None) -> None:
        """Log the page: the run's properties and, at the end, its figures."""
        text = rr.TextDocument(page(self._properties, summary), media_type=rr.MediaType.MARKDOWN)
        self._rerun.log("/run", text, static=True)

    def _draw_rest(self) -> None:
        """Draw the rows that were written and not drawn yet."""
        if self._undrawn:
            rows = np.concatenate(self._undrawn)
            self._undrawn.clear()
            self.draw(rows)

    def _state_changes(self, lane: Lane, rows: Rows, times: Times) -> None:
        codes = lane.codes(rows)
        for i in np.flatnonzero(np.append(True, codes[1:] != codes[:-1])):
            if not np.isfinite(codes[i]):
                continue
            name = lane.names.get(int(codes[i]), f"UNKNOWN {codes[i]:g}")
            if name != self._lane_states.get(lane.path):
                self._lane_states[lane.path] = name
                self._rerun.send_columns(lane.path, indexes(times[i : i + 1]), rr.StateChange.columns(state=[name]))

    def _draw_limits(self, rows: Rows, times: Times) -> None:
        # No further than the run has come: a live view follows the newest point.
        kept = self._limit_decimator.keep(times[:, 0])
        t_s = times[kept, 0]
        if not len(t_s):
            return
        for path, lines in self._limits.items():
            drawn = limit_values(lines, self._column, rows[kept], t_s)
            if np.isfinite(drawn).any():
                self._rerun.send_columns(LIMITS_PATH + path, [seconds_index(t_s)], rr.Scalars.columns(scalars=drawn))


class LiveServer:
    """A gRPC server on 127.0.0.1 with the run's rows at 100 Hz, in a thread of its own.

    Viewers pull the data. The server's memory and the queue to the thread are bounded and drop the oldest data first,
    so the recorder never waits for a viewer. Raises OSError for a port that is in use.
    """

    def __init__(self, port: int, *, recording_id: str, signals: Sequence[str], properties: Mapping[str, str]) -> None:
        rr.set_strict_mode(True)
        _check_port(port)
        sink = rr.GrpcServerSink(HOST, port, server_memory_limit=_MEMORY_LIMIT)
        self._stream = Stream(sink, recording_id=recording_id, signals=signals, properties=properties, live=True)
        self._t_column = list(signals).index("loop.t_s")
        self._decimator = Decimator(LIVE_PERIOD_S)
        self._queue: deque[Callable[[], None]] = deque(maxlen=_QUEUE_LENGTH)
        self._wake = threading.Event()
        self._closing = False
        self.error: str | None = None
        self._thread = threading.Thread(target=self._run, name="live", daemon=True)
        self._thread.start()

    def rows(self, rows: Rows) -> None:
        """Queue rows of shape (n, signals); one per 10 ms of scenario time is served."""
        kept = rows[self._decimator.keep(rows[:, self._t_column])]
        if len(kept):
            self._put(lambda: self._stream.draw(kept))

    def event(self, t_s: float, level: str, text: str) -> None:
        """Queue a line of the event log."""
        self._put(lambda: self._stream.event(t_s, level, text))

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Queue the run's summary; all is served until ``close``."""
        self._put(lambda: self._stream.finish(summary, recorder))

    def close(self) -> None:
        """Stop serving; gives up on what could not be handed over within two seconds."""
        self._closing = True
        self._wake.set()
        self._thread.join(_CLOSE_TIMEOUT_S)

    def _put(self, write: Callable[[], None]) -> None:
        self._queue.append(write)
        self._wake.set()

    def _run(self) -> None:
        try:
            while not self._closing or self._queue:
                self._wake.wait()
                self._wake.clear()
                while self._queue:
                    self._queue.popleft()()
            self._stream.close()
        except RuntimeError as error:
            self.error = str(error)


def _check_port(port: int) -> None:
    """Raise OSError for a port in use: rerun binds it later, in a thread, and reports that only in its log."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((HOST, port))
