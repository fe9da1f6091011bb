"""What rerun's viewer shows of a run: its layout, states, curves, trails, the robot, the verdict and the run's page.

A signal is drawn from its first value on: a signal without any value has no entity, so no plot and no legend shows it.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from hil.addons.report.blueprint import LOG, VERDICT, blueprint, first_blueprint
from hil.addons.report.claim_watch import (
    LIMITS_PATH,
    VIOLATIONS_PATH,
    Checked,
    Claim,
    ClaimWatch,
    Limit,
    claims,
    limits,
)
from hil.addons.report.decimate import Decimator
from hil.addons.report.entities import Entity, layout
from hil.addons.report.lanes import States
from hil.addons.report.review_windows import Course, moments, windows
from hil.addons.report.scene import Gaps, Scene, Trails
from hil.addons.report.urdf import RobotShape
from hil.addons.report.verdict_text import page, running, verdict
from hil.core.printable import printable
from hil.pages.plots import ALARM_COLOUR
from hil.record.properties import scenario_values
from hil.record.ring import Rows
from hil.record.stream import RowTimes, Times, indexes, seconds_index

_SETTLED_S = 5.0
DRAWN_PERIOD_S = 0.005
_LIMIT_PERIOD_S = 0.1
_LIMIT_WIDTH_PX = 2.0
_MARK_PERIOD_S = 0.05
_MARK_SIZE_PX = 5.0
_BEFORE_GAP_S = 1e-6


class Curves:
    """Draws signals at most once per ``DRAWN_PERIOD_S``, bounds at their ends and every 0.1 s, violations every 50 ms.

    Attributes:
        drawn: the entities drawn so far. A signal whose first value comes after those of its entity gets an entity of
            its own below it, because the vectors of an entity have one length.
        limits: the bounds to draw, by the path of the plot.
        violated: the paths of the plots with a marked violation, in order of time.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        entities: Sequence[Entity],
        column: Mapping[str, int],
        limits: Mapping[str, Sequence[Limit]],
        *,
        live: bool,
    ) -> None:
        self._live = live  # live viewers get the rows alone
        self._gaps = Gaps()
        self._rerun = recording
        self._column = column
        self._waiting = {entity.path: entity for entity in entities}
        self.drawn: list[Entity] = []
        self.violated: dict[str, None] = {}
        self._plots = {series.signal: entity.path for entity in entities for series in entity.series}
        self._decimator = Decimator(DRAWN_PERIOD_S)
        self._limit_decimator = Decimator(_LIMIT_PERIOD_S)
        self._marks: dict[tuple[int, str], Decimator] = {}
        self.limits = limits
        self._styled: set[str] = set()

    def rows(self, rows: Rows, times: Times, checked: Sequence[tuple[Claim, Checked]]) -> None:
        """Draw rows of shape (n, signals); ``checked`` are the claims about signals at these rows."""
        kept = self._decimator.keep(times[:, 0])
        if len(kept):
            values, at = rows[kept], times[kept]
            self._find_new(values)
            if not self._live:
                values, at = self._with_gaps(values, at)
            index = indexes(at)
            for entity in self.drawn:
                columns = [self._column[series.signal] for series in entity.series]
                self._rerun.send_columns(entity.path, index, rr.Scalars.columns(scalars=values[:, columns]))
        self._draw_limits(rows, times)
        for claim, found in checked:
            if found.violated.any():
                self._mark(claim, found, rows, times)

    def _with_gaps(self, values: Rows, times: Times) -> tuple[Rows, Times]:
        """Insert a row without values where rows are missing, so that no line is drawn across."""
        after = np.flatnonzero(self._gaps(times[:, 0]))
        if not len(after):
            return values, times
        between = times[after] - [_BEFORE_GAP_S, 0.0]
        return np.insert(values, after, np.nan, axis=0), np.insert(times, after, between, axis=0)

    def _find_new(self, values: Rows) -> None:
        """Move signals from waiting to drawn once they have a value."""
        if not self._waiting:
            return
        known = np.asarray(np.isfinite(values).any(axis=0))
        for path, entity in list(self._waiting.items()):
            new = tuple(series for series in entity.series if known[self._column[series.signal]])
            if not new:
                continue
            if any(one.path == path for one in self.drawn):
                self.drawn += [
                    entity._replace(
                        path=f"{path}/{re.sub(r'[^a-z0-9]+', '_', one.label.lower())}", series=(one,), plot=path
                    )
                    for one in new
                ]
            else:
                self.drawn.append(entity._replace(series=new))
            left = tuple(series for series in entity.series if series not in new)
            if left:
                self._waiting[path] = entity._replace(series=left)
            else:
                del self._waiting[path]
        for entity in self.drawn:
            self._style(
                entity.path,
                rr.SeriesLines,
                names=[one.label for one in entity.series],
                colors=[one.colour for one in entity.series],
                widths=[entity.width_px] * len(entity.series),
            )

    def _draw_limits(self, rows: Rows, times: Times) -> None:
        # No further than the run has come: a live view follows the newest point.
        t_s = times[:, 0]
        regular = self._limit_decimator.keep(t_s)
        for path, lines in self.limits.items():
            for number, line in enumerate(lines):
                inside = line.inside(t_s)
                if not inside.any():
                    continue
                ends = inside & ~(np.append(False, inside[:-1]) & np.append(inside[1:], False))
                kept = np.union1d(regular[inside[regular]], np.flatnonzero(ends))
                values = line.values(self._column, rows[kept])
                entity = f"{LIMITS_PATH}{path}/{number}"
                self._style(entity, rr.SeriesLines, names=line.label, colors=ALARM_COLOUR, widths=_LIMIT_WIDTH_PX)
                self._rerun.send_columns(entity, [seconds_index(t_s[kept])], rr.Scalars.columns(scalars=values))

    def _mark(self, claim: Claim, found: Checked, rows: Rows, times: Times) -> None:
        at = np.flatnonzero(found.violated)
        begins = at[~np.append(False, found.violated[:-1])[at]]
        bound = claim.high if claim.low is None else claim.low
        for signal in claim.signals:
            if (path := self._plots.get(signal)) is None:
                continue
            self.violated[path] = None
            decimator = self._marks.setdefault((claim.number, signal), Decimator(_MARK_PERIOD_S))
            kept = np.union1d(at[decimator.keep(times[at, 0])], begins)
            values = rows[kept, self._column[signal]]
            if claim.is_rest:
                kept, values = kept[np.abs(values) >= (bound or 0.0)], values[np.abs(values) >= (bound or 0.0)]
            # A signal without a value is marked at the bound.
            values = np.where(np.isfinite(values), values, bound)
            if len(kept):
                entity = f"{VIOLATIONS_PATH}{path}/{claim.number}"
                cross = {"markers": "cross", "marker_sizes": _MARK_SIZE_PX}
                self._style(entity, rr.SeriesPoints, names="violated", colors=ALARM_COLOUR, **cross)
                index = [seconds_index(times[kept, 0])]
                self._rerun.send_columns(entity, index, rr.Scalars.columns(scalars=values))

    def _style(self, path: str, kind: type[rr.SeriesLines | rr.SeriesPoints], **style: Any) -> None:
        """Say once how an entity is drawn."""
        if path not in self._styled:
            self._styled.add(path)
            self._rerun.log(path, kind(**style), static=True)


class RunDrawing:
    """Draws a run as its rows come; a ``hil.record.viewing.Drawing``, registered as ``drawing``.

    The properties' ``scenario`` gives the robot's size, the limits and the faults; what is missing there is not drawn.
    With ``live`` it is for live viewers: they get only the signals that are drawn, and views of the last seconds.
    """

    def __init__(
        self,
        recording: rr.RecordingStream,
        signals: Sequence[str],
        properties: Mapping[str, str],
        live: bool = False,
    ) -> None:
        self._rerun, self._live = recording, live
        self._properties = dict(properties)
        column = {name: i for i, name in enumerate(signals)}
        entities, values = layout(signals), scenario_values(properties)
        self._shape = RobotShape.of(values)
        claimed = claims(values)
        self._watches = [ClaimWatch(claim, column, values) for claim in claimed]
        self._times = RowTimes(column)
        self._span_s: tuple[float, float] | None = None  # of the rows that were drawn
        self._troubles: list[str] = []
        self._states = States(recording, column, values, claimed, live=self._live)
        self._curves = Curves(recording, entities, column, limits(values, claimed, entities), live=self._live)
        self._drawings: list[Trails | Scene] = [Trails(recording, column)]
        if self._shape is not None:
            torque_constant_n_m_a = values.get("firmware.torque_constant_n_m_a")
            self._drawings.append(Scene(recording, column, self._shape, torque_constant_n_m_a))
        self.blueprint = first_blueprint(entities, limits=self._curves.limits, shape=self._shape, live=self._live)

    def describe(self) -> None:
        """Log what does not change, and the page and the verdict of a run that has begun."""
        for drawing in self._drawings:
            drawing.describe()
        self._page(None)
        self._tell(running(self._properties, ()))

    def rows(self, rows: Rows) -> None:
        """Draw rows of shape (n, signals): signals, states, bounds, trails and the robot."""
        times = self._times(rows)
        self._span_s = (times[0, 0] if self._span_s is None else self._span_s[0], times[-1, 0])
        checked = [(watch.claim, watch(rows)) for watch in self._watches]
        self._states.rows(rows, times, checked)
        drawn = len(self._curves.drawn)
        self._curves.rows(rows, times, checked)
        for drawing in self._drawings:
            drawing.rows(rows, times)
        if self._live and len(self._curves.drawn) != drawn and self._span_s[1] - self._span_s[0] < _SETTLED_S:
            # Live viewers get only drawn signals, and show no empty plots. A new layout takes back what the user has
            # changed in it, so it comes at the beginning alone.
            self._rerun.send_blueprint(self._views(None))

    def event(self, t_s: float, level: str, text: str) -> None:
        """Show an event; an error is in the verdict too."""
        timed = rr.TextLog.columns(text=[f"{t_s:.3f} s  {text}"], level=[level])
        self._rerun.send_columns(LOG, [seconds_index(np.array([t_s]))], timed)
        if level == "ERROR":
            self._troubles.append(text)
            self._tell(running(self._properties, self._troubles))

    def finish(self, summary: Mapping[str, Any] | None, next_part: int | None) -> None:
        """Show the verdict and, unless there is no summary, the figures on the page.

        The layout becomes that of a review: by now the contents of the run are known.
        """
        begin_s, end_s = self._span_s or (0.0, 0.0)
        violations = [watch.violation_s for watch in self._watches if watch.violation_s is not None]
        first = min(violations, default=None)
        failed_s = None if first is None else first[0]
        self._states.finish(summary, end_s, failed_s)
        times: dict[str, Any] = {"end_s": end_s, "failed_s": failed_s}
        said = verdict(self._properties, summary, **times, next_part=next_part, troubles=self._troubles)
        self._tell(said)
        if summary is not None:
            self._page(summary)
        if self._span_s is not None:
            happened = moments(self._watches, self._states.begun, summary, end_s)
            found = windows(begin_s, end_s, summary, happened)
            violated, lines = tuple(self._curves.violated), said.count("\n- ") + 1
            course = Course(begin_s, end_s, violated, first, found, self._states.count, lines)
            self._rerun.send_blueprint(self._views(course))

    def _views(self, course: Course | None) -> rrb.Blueprint:
        is_live = self._live and course is None
        return blueprint(self._curves.drawn, limits=self._curves.limits, shape=self._shape, live=is_live, course=course)

    def _tell(self, text: str) -> None:
        """Show a text as the verdict."""
        self._rerun.log(VERDICT, rr.TextDocument(printable(text), media_type=rr.MediaType.MARKDOWN), static=True)

    def _page(self, summary: Mapping[str, object] | None) -> None:
        """Log the page: the run's properties and, at the end, its figures."""
        text = rr.TextDocument(printable(page(self._properties, summary)), media_type=rr.MediaType.MARKDOWN)
        self._rerun.log("/run", text, static=True)
