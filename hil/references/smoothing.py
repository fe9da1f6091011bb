"""The cubic smoothing spline of samples in time: continuous up to the second derivative.

It is the function f that minimises  Σ hᵢ (yᵢ - f(tᵢ))² + λ ∫ f''² dt  (C. H. Reinsch, "Smoothing by spline functions",
Numerische Mathematik 10, 1967). hᵢ is the time that sample i represents. With λ = T⁴ the spline is a low-pass without
delay: it scales a sine of angular frequency ω by 1 / (1 + (ω T)⁴), at any sampling rate.
"""

import bisect
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]


class SmoothingSpline:
    """Smoothing splines over the same times, one per channel.

    Args:
        t_s: times [s], ascending, at least 3.
        channels: samples, each as long as ``t_s``.
        smoothing_s: the T of the module's docstring [s]; with 0 the spline goes through the samples.
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
