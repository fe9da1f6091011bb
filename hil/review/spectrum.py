"""Spectra of recorded signals by Welch's method: averaged periodograms of overlapping stretches under a Hann window.

Pure NumPy. P. D. Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE Transactions on
Audio and Electroacoustics 15 (1967), 70-73.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

LEAST_SAMPLES = 64
LONGEST_STRETCH = 4096
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
    """Return the spectrum of the longest stretch of a signal without a gap; None where that is too short for one.

    A gap is a missing value or a missing tick. The mean of each periodogram's stretch is subtracted.
    """
    if len(t_s) < LEAST_SAMPLES:
        return None
    period_s = float(np.median(np.diff(t_s)))
    values = values[_longest_stretch(t_s, values, period_s)]
    if len(values) < LEAST_SAMPLES:
        return None
    size = min(LONGEST_STRETCH, 2 ** int(np.log2(max(LEAST_SAMPLES, 2 * len(values) // _STRETCHES))), len(values))
    step = size // 2
    stretches = np.lib.stride_tricks.sliding_window_view(values, size)[::step]
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    total = np.zeros(size // 2 + 1)
    for stretch in stretches:
        total += np.abs(np.fft.rfft((stretch - stretch.mean()) * window)) ** 2
    density = total / len(stretches) * period_s / np.sum(window**2)
    density[1 : -1 if size % 2 == 0 else None] *= 2  # what is at negative frequencies
    return Spectrum(np.asarray(np.fft.rfftfreq(size, period_s)), density, len(stretches), size * period_s)


def _longest_stretch(t_s: Series, values: Series, period_s: float) -> slice:
    """Return the longest run of values that are finite and one period apart."""
    broken = np.zeros(len(t_s) + 1, dtype=bool)
    broken[1:-1] = np.abs(np.diff(t_s) - period_s) > period_s / 2
    gaps = ~np.isfinite(values)
    broken[:-1] |= gaps
    broken[1:] |= gaps
    broken[0] = broken[-1] = True
    edges = np.flatnonzero(broken)
    longest = int(np.argmax(np.diff(edges)))
    begin, end = int(edges[longest]), int(edges[longest + 1])
    return slice(begin, end) if not gaps[begin:end].any() else slice(0, 0)
