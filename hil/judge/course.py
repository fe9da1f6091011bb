"""The course of the position error: the worst of each stretch of a run, so that a text can say when it went wrong."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.judge.measure import Series, since_start

_MOST = 20
_FIRST_S = 0.05


class ErrorCourse:
    """Keeps the worst position error of each stretch of a run, from its rows, block by block.

    All stretches are equally long: 0.05 s at first, twice as long whenever a run outgrows 20 of them. So a run of more
    than a second has 10 to 20, and a shorter one fewer.
    """

    signals = ("loop.t_s", "error.planar_m")

    def __init__(self) -> None:
        self._stretch_s = _FIRST_S
        self._worst_m = np.full(_MOST, np.nan)

    def add(self, signals: Mapping[str, Series]) -> None:
        """Add the next rows; those before t = 0 and those without truth do not count."""
        begun = since_start(signals)
        t_s, error_m = begun["loop.t_s"], begun["error.planar_m"]
        known = np.isfinite(error_m)
        t_s, error_m = t_s[known], error_m[known]
        if not len(t_s):
            return
        while t_s[-1] >= _MOST * self._stretch_s:
            pairs = self._worst_m.reshape(-1, 2)
            self._worst_m = np.append(np.fmax(pairs[:, 0], pairs[:, 1]), np.full(_MOST // 2, np.nan))
            self._stretch_s *= 2.0
        np.fmax.at(self._worst_m, (t_s / self._stretch_s).astype(np.intp), error_m)

    def figures(self) -> dict[str, Any] | None:
        """Return the length of a stretch, and the worst error of each (None for a gap); None without any truth."""
        known = np.flatnonzero(np.isfinite(self._worst_m))
        if not len(known):
            return None
        worst = self._worst_m[: known[-1] + 1]
        return {"stretch_s": self._stretch_s, "worst_m": [None if math.isnan(one) else float(one) for one in worst]}


def course_words(course: Mapping[str, Any]) -> str:
    """Return the course in words, in mm."""
    worst = ", ".join("-" if one is None else _mm(one) for one in course["worst_m"])
    return f"worst of each {course['stretch_s']:g} s from t = 0 on: {worst} mm"


def _mm(error_m: float) -> str:
    return f"{error_m * 1e3:.0f}" if error_m >= 0.1 else f"{error_m * 1e3:.3g}"
