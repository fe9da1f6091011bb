"""Stretches of a run's rows, each shown by its minimum and its maximum: a long run stays small and quick to draw.

    shown = Stretches(t_s, instants=[0.0, 6.22])
    line = Line("planar error", shown.t_s, shown(planar_m))

All signals of a run share the stretches, so that a reader compares their values at one instant.
"""

from collections.abc import Sequence

import numpy as np

from hil.review.contents import Series

FINE_ROWS = 1000
"""Rows that are shown one by one around each instant: one second at 1 kHz."""
_MOST_INSTANTS = 8
_STRETCHES = 1500


class Stretches:
    """Shows signals by the minimum and maximum of each stretch, and row by row around some instants.

    ``t_s`` are the times of all rows, ascending, of shape (rows,). Around each of the first 8 ``instants`` [s] 1000
    rows are shown one by one. The others are shown in at most 1500 stretches; a recording of up to 3000 rows is shown
    whole. Where rows are missing, lines have a gap.

    Attributes:
        t_s: the times at which signals are shown, of shape (n,).
        longest_s: the length of a stretch [s]; that of one row if the recording is shown whole.
    """

    def __init__(self, t_s: Series, instants: Sequence[float] = ()) -> None:
        count = len(t_s)
        size = -(-count // _STRETCHES) if count > 2 * _STRETCHES else 1
        is_start = np.zeros(count, dtype=bool)
        is_start[::size] = True
        if size > 1:
            for instant in instants[:_MOST_INSTANTS]:
                near = int(np.searchsorted(t_s, instant))
                is_start[max(0, near - FINE_ROWS // 2) : near + FINE_ROWS // 2] = True
        period_s = float(np.median(np.diff(t_s))) if count > 1 else 0.0
        is_gap = np.append(False, np.diff(t_s) > 1.5 * period_s) if count else is_start
        self._starts = np.flatnonzero(is_start | is_gap)
        self._ends = np.append(self._starts[1:], count)
        middle = (self._starts + self._ends) // 2
        # Of each stretch a point at its start and one in its middle; before them one without a value at a gap.
        self._kept = np.stack([is_gap[self._starts], np.ones(len(middle), bool), middle > self._starts], 1).ravel()
        times = np.stack([t_s[self._starts] - period_s / 2, t_s[self._starts], t_s[middle]], 1) if count else t_s
        self.t_s: Series = times.ravel()[self._kept]
        self.longest_s = size * period_s

    def __call__(self, values: Series) -> Series:
        """Return the values of a signal, of shape (rows,), at ``t_s``; NaN where a whole stretch has none."""
        if not len(self._starts):
            return values
        low = np.fmin.reduceat(values, self._starts)
        high = np.fmax.reduceat(values, self._starts)
        rises = values[self._ends - 1] >= values[self._starts]
        first, second = np.where(rises, low, high), np.where(rises, high, low)
        shown: Series = np.stack([np.full(len(low), np.nan), first, second], 1).ravel()[self._kept]
        return shown
