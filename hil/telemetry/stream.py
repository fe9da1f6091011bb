"""One rerun stream: rows, events and properties become columns of a recording.

The only module that writes with rerun. A stream has one sink: a file, or a server that live viewers pull
from. (A file and a pushing sink in one stream stall each other when no viewer listens.)
"""

import json
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.telemetry.blueprint import blueprint
from hil.telemetry.decimate import Decimator
from hil.telemetry.layout import (
    ESTIMATE_COLOUR,
    REFERENCE_COLOUR,
    TRUTH_COLOUR,
    X_COLOUR,
    Y_COLOUR,
    Colour,
    layout,
)
from hil.telemetry.names import (
    APPLICATION,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PATH,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
    state_names,
)
from hil.telemetry.ring import Rows

DRAWN_PERIOD_S = 0.005
_DRAWN_AT_ONCE = 500
TRAIL_PERIOD_S = 0.04
_TRAILS: tuple[tuple[str, str, Colour, float], ...] = (
    # path, group of signals, colour, line width [px]; drawn in this order, the reference widest and lowest
    ("/xy/reference", "reference", REFERENCE_COLOUR, 6.0),
    ("/xy/pose", "pose", ESTIMATE_COLOUR, 3.5),
    ("/xy/truth", "truth", TRUTH_COLOUR, 1.5),
)
# The robot's symbol in the body frame, its nose forward; not to scale with a particular robot.
_BODY_M = np.array([(-0.1, -0.08), (0.04, -0.08), (0.17, 0.0), (0.04, 0.08), (-0.1, 0.08), (-0.1, -0.08)])
_LONGEST_CELL = 80
_STATE_COLOURS = {
    "BOOT": 0x8D99AEFF,
    "IDLE": 0x6C8EBFFF,
    "ARMED": 0xF4A23AFF,
    "ACTIVE": 0x3FB27FFF,
    "STOPPING": 0xE0C341FF,
    "FAULT": 0xEB5757FF,
    "ESTOP": 0xB5179EFF,
}
_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}


_FLUSH_TIMEOUT_S = 10.0


class Stream:
    """A rerun stream into one sink. Raises RuntimeError (from rerun) when the sink cannot be opened.

    Args:
        sink: ``rr.FileSink`` or ``rr.GrpcServerSink``.
        recording_id: the same for the file and the live stream of a run: viewers merge them.
        signals: names of the columns of every row.
        properties: what the run was, as texts by name.
        live: chooses the views' time window, and that only what is drawn is served.
        part: which file of the run it is (see ``hil.telemetry.names``); None for a run in one file.
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
        self._entities = [
            (entity.path, [self._column[series.signal] for series in entity.series]) for entity in layout(signals)
        ]
        self._states = state_names()
        self._state_seen: str | None = None
        self._drawn_decimator = Decimator(DRAWN_PERIOD_S)
        self._trail_decimator = Decimator(TRAIL_PERIOD_S)
        self._trail_end: dict[str, npt.NDArray[np.float64]] = {}
        self._times = _Times(self._column)
        self._drawn_times = _Times(self._column)
        self._undrawn: list[Rows] = []
        self._properties = dict(properties)
        self._rerun = rr.RecordingStream(APPLICATION, recording_id=recording_id)
        self._rerun.set_sinks(sink, default_blueprint=blueprint(live=live))
        if part is not None:
            self._rerun.send_property(PART_PROPERTY, rr.AnyValues(json=json.dumps(part)))
        self._describe(signals, live=live)
        self.flush()

    def rows(self, rows: Rows) -> None:
        """Write rows of shape (n, signals) as they are, all in one entity: this is what is read back.

        What is drawn of them follows some hundred rows later: few large pieces take less of the disk.
        """
        indexes = _indexes(self._times(rows))
        self._rerun.send_columns(SIGNALS_PATH, indexes=indexes, columns=rr.Scalars.columns(scalars=rows))
        self._undrawn.append(rows)
        if sum(map(len, self._undrawn)) >= _DRAWN_AT_ONCE:
            self._draw_rest()

    def draw(self, rows: Rows) -> None:
        """Write what is drawn of rows of shape (n, signals), at no more than one each ``DRAWN_PERIOD_S``."""
        times = self._drawn_times(rows)
        self._state_changes(rows, times)
        drawn = self._drawn_decimator.keep(times[:, 0])
        indexes = _indexes(times[drawn])
        for path, columns in self._entities:
            values = rows[drawn][:, columns]
            self._rerun.send_columns(path, indexes=indexes, columns=rr.Scalars.columns(scalars=values))
        keep = self._trail_decimator.keep(times[:, 0])
        if len(keep):
            self._trails(rows[keep], times[keep])

    def event(self, t_s: float, level: str, text: str) -> None:
        """Write a line of the event log at scenario time ``t_s``."""
        self._rerun.send_columns(
            "/events",
            indexes=[rr.TimeColumn("t", duration=_nanoseconds(np.array([t_s])))],
            columns=rr.TextLog.columns(text=[text], level=[_LEVELS.get(level, "INFO")]),
        )

    def finish(self, summary: Mapping[str, object] | None, recorder: Mapping[str, int]) -> None:
        """Write the recorder's counts and, when there is one, the run's summary, also into the page."""
        self._draw_rest()
        self._rerun.send_property(RECORDER_PROPERTY, rr.AnyValues(json=json.dumps(recorder)))
        if summary is not None:
            self._rerun.send_property(SUMMARY_PROPERTY, rr.AnyValues(json=json.dumps(summary)))
            self._page(summary)

    def flush(self) -> None:
        """Hand everything to the operating system. Raises RuntimeError when that fails (a full disk)."""
        # Without a limit, rerun 0.41 now and then waits for ever for a file whose writer has failed.
        self._rerun.flush(timeout_sec=_FLUSH_TIMEOUT_S)

    def close(self) -> None:
        """Flush, and close the sink: a file gets its footer. Raises RuntimeError when the flush fails."""
        self.flush()
        self._rerun.disconnect()

    def _describe(self, signals: Sequence[str], *, live: bool) -> None:
        entities = layout(signals)
        drawn = {entity.path: [series.signal for series in entity.series] for entity in entities}
        # Where a reader finds every signal: viewers get no more than what is drawn.
        held = drawn if live else {SIGNALS_PATH: list(signals)}
        self._rerun.send_property(SIGNALS_PROPERTY, rr.AnyValues(json=json.dumps(held)))
        if self._properties:
            texts = rr.AnyValues(drop_untyped_nones=True, **self._properties)
            self._rerun.send_property(RUN_PROPERTY, texts)
        if "scenario_name" in self._properties:
            self._rerun.send_recording_name(self._properties["scenario_name"])
        for entity in entities:
            style = rr.SeriesLines(
                names=[series.label for series in entity.series],
                colors=[series.colour for series in entity.series],
                widths=[entity.width_px] * len(entity.series),
            )
            self._rerun.log(entity.path, style, static=True)
        self._rerun.log("/robot/state", _state_style(self._states), static=True)
        # A 2D view counts y downwards; the world's y points up. The data stay as they are.
        self._rerun.log("/xy", rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
        for order, (path, _, colour, width_px) in enumerate(_TRAILS):
            # A negative radius is in pixels, whatever the zoom.
            trail = rr.LineStrips2D.from_fields(colors=[colour], radii=[-width_px / 2], draw_order=30.0 + order)
            self._rerun.log(path, trail, static=True)
        body = rr.LineStrips2D.from_fields(colors=[TRUTH_COLOUR], radii=[-1.5], draw_order=40.0)
        self._rerun.log("/xy/robot", body, static=True)
        axes = rr.LineStrips2D(
            [[(0.0, 0.0), (0.5, 0.0)], [(0.0, 0.0), (0.0, 0.5)]],
            colors=[X_COLOUR, Y_COLOUR],
            labels=["x: 0.5 m", "y: 0.5 m"],
            radii=-0.75,
            draw_order=20.0,
        )
        self._rerun.log("/xy/axes", axes, static=True)
        self._page(None)

    def _page(self, summary: Mapping[str, object] | None) -> None:
        """Log the page that says what the run was and, in the end, what came of it."""
        text = _table("run", self._properties)
        if summary is not None:
            text = _table("figure", summary) + "\n" + text
        page = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._rerun.log("/run", page, static=True)

    def _draw_rest(self) -> None:
        """Draw the rows that were written and not drawn yet."""
        if self._undrawn:
            rows = np.concatenate(self._undrawn)
            self._undrawn.clear()
            self.draw(rows)

    def _state_changes(self, rows: Rows, times: npt.NDArray[np.float64]) -> None:
        codes = rows[:, self._column["robot.state"]]
        for i in np.flatnonzero(np.append(True, codes[1:] != codes[:-1])):
            if not np.isfinite(codes[i]):
                continue
            name = self._states.get(int(codes[i]), f"UNKNOWN {codes[i]:g}")
            if name != self._state_seen:
                self._state_seen = name
                self._rerun.send_columns(
                    "/robot/state",
                    indexes=_indexes(times[i : i + 1]),
                    columns=rr.StateChange.columns(state=[name]),
                )

    def _trails(self, rows: Rows, times: npt.NDArray[np.float64]) -> None:
        for path, group, _, _ in _TRAILS:
            points = rows[:, [self._column[f"{group}.x_m"], self._column[f"{group}.y_m"]]]
            ends = np.vstack([self._trail_end.get(path, points[0]), points])
            self._trail_end[path] = points[-1]
            segments = np.stack([ends[:-1], ends[1:]], axis=1)
            seen = np.isfinite(segments).all(axis=(1, 2))
            if seen.any():
                self._rerun.send_columns(
                    path,
                    indexes=_indexes(times[seen]),
                    columns=rr.LineStrips2D.columns(strips=list(segments[seen])),
                )
        poses = rows[:, [self._column[f"truth.{name}"] for name in ("x_m", "y_m", "heading_rad")]]
        seen = np.isfinite(poses).all(axis=1)
        if seen.any():
            bodies = rr.LineStrips2D.columns(strips=list(_outlines(poses[seen])))
            self._rerun.send_columns("/xy/robot", indexes=_indexes(times[seen]), columns=bodies)


class _Times:
    """Scenario time and tick of rows; where one is not finite, the last one that was, in an earlier call too."""

    def __init__(self, column: Mapping[str, int]) -> None:
        self._columns = [column["loop.t_s"], column["loop.tick"]]
        self._last = np.zeros(2)

    def __call__(self, rows: Rows) -> Rows:
        times = np.vstack([self._last, rows[:, self._columns]])
        finite = np.isfinite(times)
        newest = np.maximum.accumulate(np.where(finite, np.arange(len(times))[:, None], 0), axis=0)
        times = np.take_along_axis(times, newest, axis=0)
        self._last = times[-1]
        return times[1:]


def _outlines(poses: Rows) -> Rows:
    """Outline of the robot's symbol at poses (n, 3) in the world frame, shape (n, 6, 2)."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    rotation = np.stack([np.stack([cosine, -sine], axis=1), np.stack([sine, cosine], axis=1)], axis=1)
    return np.asarray(poses[:, None, :2] + np.einsum("nij,kj->nki", rotation, _BODY_M))


def _nanoseconds(t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.timedelta64]:
    return np.rint(t_s * 1e9).astype("timedelta64[ns]")


def _indexes(times: npt.NDArray[np.float64]) -> list[rr.TimeColumn]:
    return [
        rr.TimeColumn("t", duration=_nanoseconds(times[:, 0])),
        rr.TimeColumn("tick", sequence=np.rint(times[:, 1]).astype(np.int64)),
    ]


def _state_style(states: Mapping[int, str]) -> rr.StateConfiguration:
    names = list(states.values())
    return rr.StateConfiguration(values=names, colors=[_STATE_COLOURS.get(name, 0xB0B0B0FF) for name in names])


def _table(title: str, values: Mapping[str, object]) -> str:
    """Return a Markdown table of the values that fit a line."""
    cells = {name: _cell(value) for name, value in values.items() if value is not None}
    rows = [f"| {name} | {cell} |" for name, cell in cells.items() if len(cell) <= _LONGEST_CELL]
    return "\n".join([f"| {title} | |", "|---|---|", *rows, ""])


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_cell(one)}" for name, one in value.items())
    return str(value)
