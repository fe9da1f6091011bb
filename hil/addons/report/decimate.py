"""Decimation of rows by time: at most one row per period, also across batches."""

import numpy as np
import numpy.typing as npt


class Decimator:
    """Keeps the first row of each period; a period may have none."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last_period = -np.inf

    def keep(self, t_s: npt.NDArray[np.float64]) -> npt.NDArray[np.intp]:
        """Return the indices of the rows to keep, for times [s] of shape (n,), later than those before."""
        # Half a nanosecond is added because 0.3 / 0.1 is just below 3.
        period = np.floor((t_s + 0.5e-9) / self._period_s)
        before = np.append(self._last_period, period[:-1])
        if len(period):
            self._last_period = period[-1]
        return np.flatnonzero(period != before)
