"""The delay margin by the equations, and a robot's oscillation about its path by the signals of a run.

No side effects: numbers and NumPy arrays in, plain numbers out.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

HARMONICS = 8
"""Multiples of the path's frequency that are no oscillation: lag, and friction that turns with the wheels."""


class DelayMargin(NamedTuple):
    """The latency at which the loop is on the edge of stability, and the frequency at which it then swings."""

    latency_s: float
    frequency_hz: float


def delay_margin(k1_1_s: float, k2_1_s: float, filter_s: float, period_s: float = 0.0) -> DelayMargin:
    """Return the delay margin of one axis.

    With equation 17 the acceleration asked for is u = s x2d - K2 (s e - x2d), x2d = -K1 e / (1 + ς s), and the robot
    answers with s² e = u: the open loop is ((s + K2) K1 / (1 + ς s) + K2 s) / s². A controller that holds its command
    for ``period_s`` delays it by half of that, which is subtracted.
    """

    def loop(rate_rad_s: float) -> complex:
        s = complex(0.0, rate_rad_s)
        return ((s + k2_1_s) * k1_1_s / (1.0 + filter_s * s) + k2_1_s * s) / s**2

    # The gain falls below 1 for good somewhere here: above, it goes with (K1 / ς + K2 s) / s² at most.
    rates = np.geomspace(1e-2, 1e4, 4000)
    above = np.flatnonzero([abs(loop(rate)) > 1.0 for rate in rates])
    low, high = float(rates[above[-1]]), float(rates[above[-1] + 1])
    for _ in range(60):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if abs(loop(middle)) > 1.0 else (low, middle)
    at = loop(low)
    phase_rad = math.atan2(-at.imag, -at.real) % math.tau
    return DelayMargin(phase_rad / low - period_s / 2.0, low / math.tau)


class Oscillation(NamedTuple):
    """``amplitude_m`` is the largest distance from the mean path, ``frequency_hz`` where the power is greatest."""

    amplitude_m: float
    frequency_hz: float


def oscillation(t_s: Series, error_x_m: Series, error_y_m: Series, period_s: float) -> Oscillation | None:
    """Return the oscillation over the last lap of a path of this period; None where there is no whole lap.

    A mean and ``HARMONICS`` harmonics of the path's frequency are fitted to each error and subtracted. Arrays have
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
