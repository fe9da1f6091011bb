"""Settling times and steady tracking error of a run, and the error of its pose estimate."""

from collections.abc import Mapping
from statistics import median

import numpy as np

from hil.core.errors import apart
from hil.judge.measure import (
    NO_TRUTH,
    RESOLUTION_M,
    Figure,
    Measure,
    NoFigureError,
    RunSetup,
    Series,
    TruthGaps,
    since_start,
)

TRACKED_RATIO = 0.02
TRACKED_DISTANCE_M = 0.010
STEADY_WINDOW_S = 5.0
_MORE_THAN_WINDOW_S = 6.0


class _Settling:
    def __init__(self, limit_m: float) -> None:
        self.limit_m = limit_m
        self.since_s: float | None = None

    def add(self, t_s: Series, planar_m: Series) -> None:
        outside = np.flatnonzero(planar_m >= self.limit_m)
        if len(outside):
            self.since_s = None
        first = int(outside[-1]) + 1 if len(outside) else 0
        if self.since_s is None and first < len(t_s):
            self.since_s = float(t_s[first])


class Tracking(Measure):
    """Settling times and steady error of ``error.planar_m``, the distance [m] between truth and reference.

    Settling times count from the first row: t = 0 of a run, or the moment at which a service's recording began.
    """

    figures = (
        Figure("tracked_s", "tracked after", "s", 1.0,
               "first time from which the planar error stays below 2 % of its initial value", column="tracked_s",
               of_end=True, resolution=0.005, resolution_ticks=1),
        Figure("t10_s", "within 10 mm after", "s", 1.0, "first time from which the planar error stays below 10 mm",
               column="t10_s", of_end=True, resolution=0.005, resolution_ticks=1),
        Figure("steady_rms_m", "steady error rms", "mm", 1e3, "planar error over the last 5 s, root mean square",
               column="steady_rms_m", of_end=True, resolution=2e-6),
        Figure("steady_max_m", "steady error max", "mm", 1e3, "planar error over the last 5 s, largest",
               column="steady_max_m", of_end=True, resolution=5e-6),
    )  # fmt: skip
    signals = ("loop.t_s", "error.planar_m")

    def __init__(self, _setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._gaps = TruthGaps()
        self._first_s = 0.0
        self._initial_m = 0.0
        self._ratio = _Settling(np.nan)
        self._distance = _Settling(TRACKED_DISTANCE_M)
        self._tail: list[tuple[Series, Series]] = []  # the newest blocks, of 6 s at least

    def add(self, signals: Mapping[str, Series]) -> None:
        begun = since_start(signals)
        t_s, planar_m = begun["loop.t_s"], begun["error.planar_m"]
        if not len(t_s):
            return
        if not self._tail:
            self._first_s, self._initial_m = float(t_s[0]), float(planar_m[0])
            self._ratio = _Settling(TRACKED_RATIO * self._initial_m)
        self._gaps.add(t_s, planar_m)
        self._ratio.add(t_s, planar_m)
        self._distance.add(t_s, planar_m)
        self._tail.append((t_s.copy(), planar_m.copy()))
        while len(self._tail) > 2 and self._tail[1][0][0] < t_s[-1] - _MORE_THAN_WINDOW_S:
            del self._tail[0]

    def value(self, name: str) -> float:
        match name:
            case "tracked_s":
                return self._tracked()
            case "t10_s":
                return self._settled(self._distance)
            case "steady_rms_m":
                return float(np.sqrt(np.mean(self._steady() ** 2)))
            case _:
                return float(np.max(self._steady()))

    def _tracked(self) -> float:
        self._gaps.require_truth()
        if self._initial_m < RESOLUTION_M:
            began_mm = apart(self._initial_m * 1e3, RESOLUTION_M * 1e3)
            raise NoFigureError(
                f"the run began {began_mm} mm from the reference: 2 % of less than "
                f"{RESOLUTION_M * 1e3:g} mm is not a usable limit"
            )
        return self._settled(self._ratio)

    def _settled(self, settling: _Settling) -> float:
        self._gaps.require_truth()
        if settling.since_s is None:
            limit_mm, last_mm = f"{settling.limit_m * 1e3:.3g}", self._tail[-1][1][-1] * 1e3
            raise NoFigureError(
                f"the planar error did not stay below {limit_mm} mm: it was {apart(last_mm, float(limit_mm))} mm at "
                "the end"
            )
        return settling.since_s - self._first_s

    def _steady(self) -> Series:
        if sum(len(t_s) for t_s, _ in self._tail) < 2:
            raise NoFigureError("the run has fewer than two samples")
        t_s, planar_m = (np.concatenate(column) for column in zip(*self._tail, strict=True))
        start = min(int(np.searchsorted(t_s, t_s[-1] - _MORE_THAN_WINDOW_S)), len(t_s) - 2)
        t_s, planar_m = t_s[start:], planar_m[start:]
        # n samples cover n periods. Half a period of tolerance lets a run as long as the window pass.
        period_s = median(np.diff(t_s).tolist())  # NumPy's median imports numpy.ma
        covered_s = float(t_s[-1] - self._first_s) + period_s
        if covered_s < STEADY_WINDOW_S - period_s / 2:
            lasted = apart(covered_s, STEADY_WINDOW_S)
            raise NoFigureError(f"the run lasted {lasted} s, less than the window of {STEADY_WINDOW_S:g} s")
        start = int(np.searchsorted(t_s, t_s[-1] - STEADY_WINDOW_S + period_s / 2))
        window = TruthGaps()
        window.add(t_s[start:], planar_m[start:])
        window.require_truth()
        return planar_m[start:]


class EstimationError(Measure):
    """How far the pose that the controller acted on was from the truth, over all ticks that have both."""

    figures = (
        Figure("estimation_error.rms_m", "estimation error rms", "mm", 1e3,
               "distance of the estimated pose from the true one, root mean square", column="estimation_rms_m",
               printed=False, resolution=2e-6),
        Figure("estimation_error.max_m", "estimation error max", "mm", 1e3,
               "distance of the estimated pose from the true one, largest", column="estimation_max_m",
               printed=False, resolution=5e-6),
        Figure("estimation_error.heading_rms_rad", "heading error rms", "mrad", 1e3,
               "difference of the estimated heading from the true one, root mean square",
               column="estimation_heading_rms_rad", printed=False, resolution=2e-6),
    )  # fmt: skip
    signals = (
        "loop.t_s",
        *(f"{group}.{name}" for group in ("pose", "truth") for name in ("x_m", "y_m", "heading_rad")),
    )

    def __init__(self, _setup: RunSetup = RunSetup()) -> None:  # noqa: B008 -- immutable
        self._ticks = self._truths = 0
        self._square_m2 = 0.0
        self._largest_m2 = 0.0
        self._square_rad2 = 0.0

    def add(self, signals: Mapping[str, Series]) -> None:
        x_m, y_m, heading_rad = (
            signals[f"pose.{name}"] - signals[f"truth.{name}"] for name in ("x_m", "y_m", "heading_rad")
        )
        heading_rad = np.remainder(heading_rad + np.pi, 2 * np.pi) - np.pi
        square_m2 = x_m**2 + y_m**2
        self._truths += int(np.isfinite(signals["truth.x_m"]).any())
        there = np.isfinite(square_m2 + heading_rad) & (signals["loop.t_s"] >= 0.0)
        if there.any():
            self._ticks += int(np.count_nonzero(there))
            self._square_m2 += float(square_m2[there].sum())
            self._largest_m2 = max(self._largest_m2, float(square_m2[there].max()))
            self._square_rad2 += float((heading_rad[there] ** 2).sum())

    def value(self, _name: str) -> dict[str, float]:
        if not self._ticks:
            raise NoFigureError("there is no tick with both an estimated and a true pose" if self._truths else NO_TRUTH)
        return {
            "rms_m": float(np.sqrt(self._square_m2 / self._ticks)),
            "max_m": float(np.sqrt(self._largest_m2)),
            "heading_rms_rad": float(np.sqrt(self._square_rad2 / self._ticks)),
        }
