"""Median and 99th percentile of values that come one by one, in bounded memory."""

from array import array
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

CAPACITY = 1 << 20
"""Percentiles are exact up to this number of values; beyond it they are those of a random sample of this size."""
_BLOCK = 1024


class Percentiles(NamedTuple):
    """Median and 99th percentile, in the unit of the signal."""

    p50: float
    p99: float


class Reservoir:
    """A reservoir sample of a series: all values up to ``CAPACITY``, then a uniform random sample of that size."""

    def __init__(self) -> None:
        self._pending = array("d")
        self._kept = array("d")
        self._seen = 0
        self._chance: np.random.Generator | None = None  # made when needed: NumPy imports it only then

    def append(self, value: float) -> None:
        """Add a value."""
        self._pending.append(value)
        if len(self._pending) >= _BLOCK:
            self._fold()

    def extend(self, values: Series) -> None:
        """Add the finite values of an array of shape (n,)."""
        self._pending.frombytes(values[np.isfinite(values)].tobytes())
        self._fold()

    def percentiles(self) -> Percentiles | None:
        """Return median and 99th percentile, or None when there were no values."""
        self._fold()
        return percentiles(np.frombuffer(self._kept))

    def __len__(self) -> int:
        """Return the number of values that were added."""
        return self._seen + len(self._pending)

    def _fold(self) -> None:
        room = CAPACITY - len(self._kept)
        self._kept += self._pending[:room]
        self._seen += min(room, len(self._pending))
        if len(more := self._pending[room:]):
            self._chance = self._chance or np.random.default_rng(1)
            places = self._chance.integers(0, self._seen + 1 + np.arange(len(more)))
            lucky = places < CAPACITY
            np.frombuffer(self._kept)[places[lucky]] = np.frombuffer(more)[lucky]
            self._seen += len(more)
        self._pending = array("d")


def percentiles(series: Series) -> Percentiles | None:
    """Return median and 99th percentile of the finite values, or None when there are none."""
    there = np.sort(series[np.isfinite(series)])
    if not len(there):
        return None
    # As np.percentile, which imports numpy.ma.
    p50, p99 = np.interp([0.5 * (len(there) - 1), 0.99 * (len(there) - 1)], np.arange(len(there)), there)
    return Percentiles(float(p50), float(p99))
