"""The speed of a wheel as our firmware estimates it: its lag, and what a coarse encoder adds to it. Pure.

A filter follows the encoder's count, critically damped, every 1 ms; its rate is the speed. The count differs from the
true angle by up to half a count either way. An error of at most this size, whatever it does, moves the rate by at most
half a count times the sum of the changes of the filter's answer to a step.
"""

import functools
import math
from typing import NamedTuple

BANDWIDTH_RAD_S = 150.0
"""Of the filter, unless a scenario gives another one or its encoder is coarse."""
FINE_COUNTS = 1024
"""Counts of a turn from which on filter and speed loop need not be slower than those of a finer encoder."""
_SLOWER = 0.4
_LAG = 1.995  # times 1 / bandwidth: two filters in a row, 13.3 ms with the default
_TICK_S = 0.001
_SETTLED = 5.0  # times 1 / bandwidth: the answers have passed their extremes


class WheelSpeed(NamedTuple):
    """An encoder of so many counts in a turn of the wheel, behind a filter of this bandwidth [rad/s]."""

    counts_per_revolution: int = 4096
    bandwidth_rad_s: float = BANDWIDTH_RAD_S

    @property
    def lag_s(self) -> float:
        """By which the speed is late [s]."""
        return _LAG / self.bandwidth_rad_s

    @property
    def noise_rad_s(self) -> float:
        """How far the speed of a wheel may be from that behind an encoder without steps [rad/s]."""
        return math.tau / self.counts_per_revolution * max(_answer(self.bandwidth_rad_s))

    def noise_of_change_rad_s(self, apart_s: float) -> float:
        """Return the same of the difference of two speeds, ``apart_s`` one after the other [rad/s]."""
        answer, apart = _answer(self.bandwidth_rad_s), max(1, round(apart_s / _TICK_S))
        later = (*(0.0,) * apart, *answer)
        changes = [now - before for now, before in zip((*answer, *answer[-1:] * apart), later, strict=True)]
        return math.tau / self.counts_per_revolution * (max(changes) - min(changes))


def slower(counts_per_revolution: int) -> float:
    """Return the factor at most 1 by which a coarse encoder's filter and speed loop are to be slower.

    The bandwidth and the proportional gain take it, the integral gain its square: the loop keeps its shape. With this
    power, between what noise and what lag ask for, the torque that a count makes is at 64 counts 1.7 times that at
    1024, and the lag 3 times.
    """
    return min(1.0, math.pow(counts_per_revolution / FINE_COUNTS, _SLOWER))


@functools.lru_cache(maxsize=64)
def _answer(bandwidth_rad_s: float) -> tuple[float, ...]:
    """Return the rate [1/s] after a step of one count, tick by tick (``wheel_tracker_update`` in ``control.c``)."""
    position, rates = 0.0, [0.0]
    for _ in range(math.ceil(_SETTLED / bandwidth_rad_s / _TICK_S)):
        position += rates[-1] * _TICK_S
        error = 1.0 - position
        position += 2.0 * bandwidth_rad_s * _TICK_S * error
        rates.append(rates[-1] + bandwidth_rad_s * bandwidth_rad_s * _TICK_S * error)
    return tuple(rates)
