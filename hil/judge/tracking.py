"""How fast and how well the truth came to the reference: figures from blocks of rows."""

from typing import NamedTuple

import numpy as np

from hil.judge.so_far import RESOLUTION_M, NoMeaningError, Series, TruthGaps, figures_or_reasons

TRACKED_RATIO = 0.02
TRACKED_DISTANCE_M = 0.010
STEADY_WINDOW_S = 5.0
_MORE_THAN_WINDOW_S = 6.0


class Tracking(NamedTuple):
    """How fast and how well the truth came to the reference; None where ``reasons`` says why.

    Attributes:
        tracked_s: the first time from which the planar error stays below 2 % of its initial value, after the first row:
            that of a run is its t = 0, that of a service's recording the moment at which it was begun.
        t10_s: the first time from which it stays below 10 mm, after the first row too.
        steady_rms_m: planar error over the last 5 s, root mean square.
        steady_max_m: planar error over the last 5 s, largest.
        reasons: for each figure that is None, one sentence.
    """

    tracked_s: float | None
    t10_s: float | None
    steady_rms_m: float | None
    steady_max_m: float | None
    reasons: dict[str, str]

    def figures(self) -> dict[str, float | None]:
        """Return the four figures by name, in this order."""
        return {name: value for name, value in self._asdict().items() if name != "reasons"}


class _Settled:
    """The first time from which the error stays below a limit, so far."""

    def __init__(self, limit_m: float) -> None:
        self.limit_m = limit_m
        self.since_s: float | None = None

    def take(self, t_s: Series, planar_m: Series) -> None:
        """Take rows."""
        outside = np.flatnonzero(planar_m >= self.limit_m)
        if len(outside):
            self.since_s = None
        first = int(outside[-1]) + 1 if len(outside) else 0
        if self.since_s is None and first < len(t_s):
            self.since_s = float(t_s[first])


class TrackingSoFar:
    """The tracking figures of the rows that were taken."""

    def __init__(self) -> None:
        self._gaps = TruthGaps()
        self._first_s = 0.0
        self._initial_m = 0.0
        self._ratio = _Settled(np.nan)
        self._distance = _Settled(TRACKED_DISTANCE_M)
        self._tail = (np.empty(0), np.empty(0))

    def take(self, t_s: Series, planar_m: Series) -> None:
        """Take rows; those before t = 0 do not count.

        Args:
            t_s: scenario time [s], ascending, after that of the rows before, shape (n,).
            planar_m: distance [m] between truth and reference, shape (n,); NaN where there was no truth.
        """
        active = t_s >= 0.0
        t_s, planar_m = t_s[active], planar_m[active]
        if not len(t_s):
            return
        if not len(self._tail[0]):
            self._first_s, self._initial_m = float(t_s[0]), float(planar_m[0])
            self._ratio = _Settled(TRACKED_RATIO * self._initial_m)
        self._gaps.take(t_s, planar_m)
        self._ratio.take(t_s, planar_m)
        self._distance.take(t_s, planar_m)
        times, errors = (np.concatenate(both) for both in zip(self._tail, (t_s, planar_m), strict=True))
        start = min(int(np.searchsorted(times, times[-1] - _MORE_THAN_WINDOW_S)), max(0, len(times) - 2))
        self._tail = (times[start:], errors[start:])

    def tracking(self, cut: str | None = None) -> Tracking:
        """Return the figures; none of them for a run that ended before its time, of which ``cut`` is the sentence.

        All of them tell of how it was at the end: that of such a run is any moment of it.
        """
        if cut is not None:
            names = [name for name in Tracking._fields if name != "reasons"]
            return Tracking(**dict.fromkeys(names), reasons=dict.fromkeys(names, cut))
        values, reasons = figures_or_reasons(
            {
                "tracked_s": self._tracked,
                "t10_s": lambda: self._settled(self._distance),
                "steady_rms_m": lambda: float(np.sqrt(np.mean(self._steady() ** 2))),
                "steady_max_m": lambda: float(np.max(self._steady())),
            }
        )
        return Tracking(**values, reasons=reasons)

    def _tracked(self) -> float:
        self._gaps.require_truth()
        if self._initial_m < RESOLUTION_M:
            raise NoMeaningError(
                f"the run began {self._initial_m * 1e3:.3g} mm from the reference: 2 % of less than "
                f"{RESOLUTION_M * 1e3:g} mm says nothing"
            )
        return self._settled(self._ratio)

    def _settled(self, settled: _Settled) -> float:
        self._gaps.require_truth()
        if settled.since_s is None:
            raise NoMeaningError(
                f"the planar error did not stay below {settled.limit_m * 1e3:.3g} mm: it was "
                f"{self._tail[1][-1] * 1e3:.3g} mm at the end"
            )
        return settled.since_s - self._first_s

    def _steady(self) -> Series:
        """Return the errors of the last 5 s."""
        t_s, planar_m = self._tail
        if len(t_s) < 2:
            raise NoMeaningError("the run has fewer than two samples")
        # n samples cover n periods; the window's own length must not be refused for half of one.
        period_s = float(np.median(np.diff(t_s)))
        covered_s = float(t_s[-1] - self._first_s) + period_s
        if covered_s < STEADY_WINDOW_S - period_s / 2:
            raise NoMeaningError(f"the run lasted {covered_s:.3g} s, less than the window of {STEADY_WINDOW_S:g} s")
        start = int(np.searchsorted(t_s, t_s[-1] - STEADY_WINDOW_S + period_s / 2))
        window = TruthGaps()
        window.take(t_s[start:], planar_m[start:])
        window.require_truth()
        return planar_m[start:]
