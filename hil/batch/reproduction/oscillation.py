"""How a robot swings about the path it settles on: amplitude and frequency, without what comes with the path itself.

Pure: NumPy arrays in, plain numbers out.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

HARMONICS = 8
"""Multiples of the path's frequency that belong to the path: lag, and friction that turns with the wheels."""


class Oscillation(NamedTuple):
    """``amplitude_m`` is the largest distance from the mean path, ``frequency_hz`` where the power is greatest."""

    amplitude_m: float
    frequency_hz: float


def oscillation(t_s: Series, error_x_m: Series, error_y_m: Series, period_s: float) -> Oscillation | None:
    """Return how the robot swings over the last lap of a path of this period; None where there is no whole lap.

    A mean and ``HARMONICS`` harmonics of the path's frequency are fitted to each error and taken away. Arrays have
    shape (n,), evenly spaced, and no gaps.
    """
    lap = t_s > t_s[-1] - period_s if len(t_s) else np.zeros(0, dtype=bool)
    if np.count_nonzero(lap) < 4 * HARMONICS or t_s[-1] - t_s[0] < period_s * 0.999:
        return None
    t_s = t_s[lap]
    phases = np.outer(t_s, np.arange(1, HARMONICS + 1)) * (math.tau / period_s)
    basis = np.column_stack([np.ones(len(t_s)), np.cos(phases), np.sin(phases)])
    left = np.column_stack([error_x_m[lap], error_y_m[lap]])
    left = left - basis @ np.linalg.lstsq(basis, left, rcond=None)[0]
    power = np.sum(np.abs(np.fft.rfft(left * np.hanning(len(t_s))[:, None], axis=0)) ** 2, axis=1)
    frequencies = np.fft.rfftfreq(len(t_s), float(t_s[1] - t_s[0]))
    return Oscillation(float(np.max(np.hypot(left[:, 0], left[:, 1]))), float(frequencies[np.argmax(power)]))
