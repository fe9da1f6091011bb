"""The times of rows as rerun's timelines: ``t`` [s] since the first ACTIVE tick, and the number of the tick."""

import numpy as np
import numpy.typing as npt
import rerun as rr

Rows = npt.NDArray[np.float64]
Times = npt.NDArray[np.float64]
"""Scenario time [s] and tick of each row, shape (n, 2)."""


def seconds_index(t_s: npt.NDArray[np.float64]) -> rr.TimeColumn:
    """Return the timeline ``t`` alone, for times of shape (n,)."""
    return rr.TimeColumn("t", duration=np.rint(t_s * 1e9).astype("timedelta64[ns]"))


def indexes(times: Times) -> list[rr.TimeColumn]:
    """Return both timelines."""
    return [seconds_index(times[:, 0]), rr.TimeColumn("tick", sequence=np.rint(times[:, 1]).astype(np.int64))]
