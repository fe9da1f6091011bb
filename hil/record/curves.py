"""Draws a run's signals, their bounds, and where they violate an expectation.

A signal is drawn from its first value on: a signal without any value has no entity, so no plot and no legend shows it.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from hil.record.claims import Checked, Claim
from hil.record.decimate import Decimator
from hil.record.drawings import Gaps, Times, indexes, seconds_index
from hil.record.layout import ALARM_COLOUR, Entity
from hil.record.limits import LIMITS_PATH, VIOLATIONS_PATH, Limit
from hil.record.ring import Rows

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
        violated: the paths of the plots in which a violation is marked, in the order in which they began.
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
        """Move the signals that have a value for the first time from those that wait to those that are drawn."""
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
