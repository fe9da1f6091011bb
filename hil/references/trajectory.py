"""A trajectory that was recorded or computed elsewhere, from a CSV file."""

import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import numpy.typing as npt

from hil.core.errors import BadInputError
from hil.core.options import NOT_NEGATIVE, Range
from hil.core.types import Reference
from hil.references.source import Phase, ReferenceSource, at_rest, motion_through, ramped
from hil.references.table import Format, read_table

Series = npt.NDArray[np.float64]


class SmoothingSpline:
    """Cubic smoothing splines of samples in time, one per channel: continuous up to the second derivative.

    Each is the function f that minimises  Σ hᵢ (yᵢ - f(tᵢ))² + λ ∫ f''² dt  (C. H. Reinsch, "Smoothing by spline
    functions", Numerische Mathematik 10, 1967). hᵢ is the time that sample i represents. With λ = T⁴ the spline is a
    low-pass without delay: it scales a sine of angular frequency ω by 1 / (1 + (ω T)⁴), at any sampling rate.

    Args:
        t_s: times [s], ascending, at least 3.
        channels: samples, each as long as ``t_s``.
        smoothing_s: T [s]; with 0 the spline goes through the samples.
    """

    def __init__(self, t_s: Sequence[float], channels: Sequence[Sequence[float]], smoothing_s: float) -> None:
        times = np.asarray(t_s, dtype=np.float64)
        steps, weight = np.diff(times), smoothing_s**4
        shares = np.convolve(steps, (0.5, 0.5))
        factors = _factorised(steps, weight / shares)
        fits = [_pieces(np.asarray(samples, dtype=np.float64), steps, weight / shares, factors) for samples in channels]
        self._t_s: list[float] = times.tolist()
        # By piece and channel: value, slope, half the second derivative, a sixth of the third.
        self._pieces: list[list[list[float]]] = np.stack(fits, axis=1).tolist()

    def at(self, t_s: float) -> list[tuple[float, float, float]]:
        """Return value, first and second derivative of each channel at a time within those of the samples [s]."""
        number = min(max(bisect.bisect_right(self._t_s, t_s) - 1, 0), len(self._pieces) - 1)
        r = t_s - self._t_s[number]
        return [
            (a + r * (b + r * (c + r * d)), b + r * (2.0 * c + 3.0 * r * d), 2.0 * c + 6.0 * r * d)
            for a, b, c, d in self._pieces[number]
        ]


_Factors = list[tuple[float, float, float]]
"""L D Lᵀ by row: D, and the elements of L one and two places left of its diagonal, 0 where there is none."""


def _factorised(steps: Series, weights: Series) -> _Factors:
    """Factorise R + λ Qᵀ H⁻¹ Q, whose unknowns are the second derivatives at the inner samples.

    R is the matrix of every cubic spline, Q takes second differences, ``weights`` is the diagonal λ H⁻¹.
    """
    left, right = 1.0 / steps[:-1], 1.0 / steps[1:]
    middle = -left - right
    at, before, behind = weights[1:-1], weights[:-2], weights[2:]
    main = (steps[:-1] + steps[1:]) / 3.0 + left**2 * before + middle**2 * at + right**2 * behind
    one = steps[1:-1] / 6.0 + middle[:-1] * left[1:] * at[:-1] + right[:-1] * middle[1:] * behind[:-1]
    two = right[:-2] * left[2:] * behind[:-2]
    factors: _Factors = []
    d1 = d2 = 1.0  # D of the row before, and of the one before that
    l1 = 0.0
    for m, f, s in zip(main.tolist(), [0.0, *one.tolist()], [0.0, 0.0, *two.tolist()], strict=False):
        l1, l2 = (f - s * l1) / d1, s / d2
        d1, d2 = m - l1 * l1 * d1 - l2 * s, d1
        factors.append((d1, l1, l2))
    return factors


def _pieces(samples: Series, steps: Series, weights: Series, factors: _Factors) -> Series:
    """Return the coefficients of the cubic polynomial of each step, lowest first."""
    slopes = np.diff(samples) / steps
    bends = np.zeros(len(samples))
    bends[1:-1] = _solved(factors, np.diff(slopes).tolist())
    fitted = samples - weights * np.diff(np.diff(bends) / steps, prepend=0.0, append=0.0)
    slopes = np.diff(fitted) / steps - steps * (2.0 * bends[:-1] + bends[1:]) / 6.0
    return np.stack([fitted[:-1], slopes, 0.5 * bends[:-1], np.diff(bends) / (6.0 * steps)], axis=1)


def _solved(factors: _Factors, right: list[float]) -> list[float]:
    """Return the solution of L D Lᵀ x = right."""
    forward: list[float] = []
    z1 = z2 = 0.0
    for b, (_, l1, l2) in zip(right, factors, strict=True):
        z1, z2 = b - l1 * z1 - l2 * z2, z1
        forward.append(z1)
    backward: list[float] = []
    x1 = x2 = l1 = l2 = l2_next = 0.0
    for z, (d, one_left, two_left) in zip(reversed(forward), reversed(factors), strict=True):
        x1, x2 = z / d - l1 * x1 - l2 * x2, x1
        l1, l2, l2_next = one_left, l2_next, two_left
        backward.append(x1)
    return backward[::-1]


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
