"""How much latency dynamic surface control tolerates near its path, by its equations alone.

Pure. An oracle for what the runs show: no plant, no wire, no saturation.
"""

import math
from typing import NamedTuple

import numpy as np


class DelayMargin(NamedTuple):
    """The latency at which the loop is on the edge of stability, and the frequency at which it then swings."""

    latency_s: float
    frequency_hz: float


def delay_margin(k1_1_s: float, k2_1_s: float, filter_s: float, period_s: float = 0.0) -> DelayMargin:
    """Return the delay margin of one axis.

    With equation 17 the acceleration asked for is u = s x2d - K2 (s e - x2d), x2d = -K1 e / (1 + ς s), and the robot
    answers with s² e = u: the open loop is ((s + K2) K1 / (1 + ς s) + K2 s) / s². A controller that holds its command
    for a period delays it by half of that, which is taken off.
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
