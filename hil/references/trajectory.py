"""A trajectory that was recorded or computed elsewhere, from a CSV file."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from hil.core.errors import BadInputError
from hil.core.options import NOT_NEGATIVE, Range
from hil.core.types import Reference
from hil.references.motion import Phase, ReferenceSource, at_rest, motion_through, ramped
from hil.references.smoothing import SmoothingSpline
from hil.references.table import Format, read_table

_COLUMNS = ("t_s", "x_m", "y_m", "heading_rad")
FORMAT = Format(_COLUMNS, optional={}, fewest_rows=4, most_rows=200_000, others=True)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses over time from a CSV file, smoothed by a spline whose acceleration has no jump; at the end it rests.

    Columns: t_s, x_m, y_m, heading_rad; others are not read. Times count from the first row. A step of the heading by
    more than half a turn is unwrapped. Oscillations with a period below about 2π ``smoothing_s`` are smoothed away; 0
    goes through every row. With ``ramp_s`` it starts from rest and comes to rest within that time.
    """

    file: str
    smoothing_s: Annotated[float, Range(ge=0, le=1)] = 0.05
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0

    def read(self, directory: Path) -> ReferenceSource:
        """Return the motion of the file's rows; a relative path starts from ``directory``.

        Raises BadInputError for a file that cannot be used.
        """
        rows = read_table(directory, self.file, FORMAT)
        name = f"reference.file = {self.file!r}"
        for (_, (before_s, *_)), (line, (t_s, *_)) in pairwise(rows):
            if t_s <= before_s:
                raise BadInputError(f"{name}, line {line}: t_s = {t_s:g} after {before_s:g}; expected ascending times")
        times_s, x_m, y_m, heading_rad = zip(*(values for _, values in rows), strict=True)
        from_zero = [t_s - times_s[0] for t_s in times_s]
        if self.ramp_s > from_zero[-1]:
            raise BadInputError(
                f"reference: ramp_s = {self.ramp_s:g}: expected at most the {from_zero[-1]:g} s of {self.file!r}"
            )
        spline = SmoothingSpline(from_zero, (x_m, y_m, np.unwrap(heading_rad).tolist()), self.smoothing_s)
        return Played(spline, from_zero[-1], self.ramp_s)


class Played:
    """A spline over time as a reference, optionally with a smooth start and end."""

    ends: ClassVar[bool] = True

    def __init__(self, spline: SmoothingSpline, length_s: float, ramp_s: float) -> None:
        self._spline = spline
        self._length_s = length_s
        self._ramp_s = ramp_s
        self.span_s = length_s + ramp_s
        self._end = at_rest(self._moving((length_s, 0.0, 0.0)).pose)

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; from the end on it rests."""
        left_s = self.span_s - t_s
        if left_s <= 0.0:
            return self._end
        if left_s < self._ramp_s:
            gone_s, rate, acceleration = ramped(left_s, 1.0, self._ramp_s)
            return self._moving((self._length_s - gone_s, rate, -acceleration))
        return self._moving(ramped(t_s, 1.0, self._ramp_s))

    def _moving(self, phase: Phase) -> Reference:
        spline_s, rate, acceleration = phase
        (x, x1, x2), (y, y1, y2), (heading, heading1, heading2) = self._spline.at(spline_s)
        return motion_through(((x, y, heading), (x1, y1, heading1), (x2, y2, heading2)), rate, acceleration)
