"""The times of rows as rerun's timelines: ``t`` [s] since the first ACTIVE tick, and the number of the tick."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
import rerun as rr

from hil.record.ring import Rows

Times = npt.NDArray[np.float64]
"""Scenario time [s] and tick of each row, shape (n, 2)."""


def seconds_index(t_s: npt.NDArray[np.float64]) -> rr.TimeColumn:
    """Return the timeline ``t`` alone, for times of shape (n,)."""
    return rr.TimeColumn("t", duration=np.rint(t_s * 1e9).astype("timedelta64[ns]"))


def indexes(times: Times) -> list[rr.TimeColumn]:
    """Return both timelines."""
    return [seconds_index(times[:, 0]), rr.TimeColumn("tick", sequence=np.rint(times[:, 1]).astype(np.int64))]


class RowTimes:
    """Finds time and tick of rows; where one is not finite it is the last one that was, in an earlier call too."""

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
