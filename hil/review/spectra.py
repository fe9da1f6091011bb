"""Spectra of signals by Welch's method."""

from typing import NamedTuple

import numpy as np

from hil.review.contents import Series

LEAST_SAMPLES = 64
"""The least number of samples of which ``spectrum`` makes one."""
_LONGEST_STRETCH = 4096
_STRETCHES = 8


class Spectrum(NamedTuple):
    """One-sided power spectral density [signal's unit² / Hz] over frequency [Hz], both of shape (n,).

    It is the average of ``stretches`` periodograms, each of ``stretch_s``.
    """

    frequency_hz: Series
    density: Series
    stretches: int
    stretch_s: float


def spectrum(t_s: Series, values: Series) -> Spectrum | None:
    """Return the spectrum of the longest part of a signal without a gap; None where that is too short for one.

    A gap is a missing value or a missing tick. By Welch's method (IEEE Transactions on Audio and Electroacoustics 15,
    1967, 70-73): averaged periodograms of overlapping stretches under a Hann window, each without its mean.
    """
    if len(t_s) < LEAST_SAMPLES:
        return None
    period_s = float(np.median(np.diff(t_s)))
    values = values[_longest_part(t_s, values, period_s)]
    if len(values) < LEAST_SAMPLES:
        return None
    from matplotlib import mlab

    size = min(_LONGEST_STRETCH, 2 ** int(np.log2(max(LEAST_SAMPLES, 2 * len(values) // _STRETCHES))), len(values))
    step = size // 2
    hann = np.hanning(size + 1)[:-1]
    density, frequency_hz = mlab.psd(values, size, 1.0 / period_s, "mean", hann, size - step)
    return Spectrum(np.asarray(frequency_hz), np.asarray(density), (len(values) - size) // step + 1, size * period_s)


def _longest_part(t_s: Series, values: Series, period_s: float) -> slice:
    """Return the longest run of values that are finite and one period apart."""
    broken = np.ones(len(t_s) + 1, dtype=bool)
    broken[1:-1] = np.abs(np.diff(t_s) - period_s) > period_s / 2
    gaps = ~np.isfinite(values)
    broken[:-1] |= gaps
    broken[1:] |= gaps
    edges = np.flatnonzero(broken)
    longest = int(np.argmax(np.diff(edges)))
    begin, end = int(edges[longest]), int(edges[longest + 1])
    return slice(begin, end) if not gaps[begin:end].any() else slice(0, 0)
