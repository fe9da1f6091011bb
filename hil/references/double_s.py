"""The double-S speed profile: from one speed to another over a given way, with limited speed, acceleration and jerk.

The acceleration is zero at both ends, and the speed never changes its sign. The fastest profile then rises to a peak
speed, keeps it, and falls to the last speed. Each change of speed has a phase of constant jerk, one without jerk, and
one of the opposite jerk (Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008,
section 3.4).
"""

import math
from collections.abc import Callable
from typing import NamedTuple

_HALVINGS = 60  # bisection steps of a search for a speed; they suffice for the precision of a float


class Limits(NamedTuple):
    """Limits of a motion, in units of the way: speed [1/s], acceleration [1/s²], jerk [1/s³]."""

    speed: float
    acceleration: float
    jerk: float


class Phase(NamedTuple):
    """A phase of constant jerk: its duration, and the way, speed, acceleration and jerk at its beginning."""

    duration_s: float
    way: float
    speed: float
    acceleration: float
    jerk: float


def change_time_s(by: float, limits: Limits) -> float:
    """Return how long a change of speed by the amount ``by`` takes [s]."""
    return sum(duration_s for duration_s, _ in _change(by, limits))


def change_way(first: float, last: float, limits: Limits) -> float:
    """Return the way covered while the speed changes from one to the other."""
    return 0.5 * (first + last) * change_time_s(abs(last - first), limits)


def reachable_speed(speed: float, way: float, limits: Limits) -> float:
    """Return the highest speed within the limit that can be reached from ``speed`` over this way."""
    if speed >= limits.speed:
        return limits.speed
    return _highest(lambda peak: change_way(speed, peak, limits) <= way, speed, limits.speed)


def profile(way: float, first: float, last: float, limits: Limits) -> list[Phase]:
    """Return the fastest profile over a way, from a first to a last speed.

    Both must be within the limit, and each reachable from the other: see ``reachable_speed``.
    """

    def fits(peak: float) -> bool:
        return change_way(first, peak, limits) + change_way(peak, last, limits) <= way

    peak = _highest(fits, max(first, last), limits.speed)
    rest = way - change_way(first, peak, limits) - change_way(peak, last, limits)
    steps = [*_change(peak - first, limits), (max(rest, 0.0) / peak if peak > 0.0 else 0.0, 0.0)]
    phases: list[Phase] = []
    at, speed, acceleration = 0.0, first, 0.0
    for duration, jerk in [*steps, *_change(last - peak, limits)]:
        if duration <= 0.0:
            continue
        phases.append(Phase(duration, at, speed, acceleration, jerk))
        at, speed, acceleration = after(phases[-1], duration)
    return phases


def after(phase: Phase, t_s: float) -> tuple[float, float, float]:
    """Return way, speed and acceleration at a time [s] after the beginning of a phase."""
    _, way, speed, acceleration, jerk = phase
    return (
        way + t_s * (speed + t_s * (0.5 * acceleration + t_s * jerk / 6.0)),
        speed + t_s * (acceleration + 0.5 * t_s * jerk),
        acceleration + t_s * jerk,
    )


def _change(by: float, limits: Limits) -> list[tuple[float, float]]:
    """Return the durations and jerks of a change of speed."""
    size, jerk = abs(by), math.copysign(limits.jerk, by)
    if size * limits.jerk <= limits.acceleration**2:
        bent_s, even_s = math.sqrt(size / limits.jerk), 0.0
    else:
        bent_s = limits.acceleration / limits.jerk
        even_s = size / limits.acceleration - bent_s
    return [(bent_s, jerk), (even_s, 0.0), (bent_s, -jerk)]


def _highest(fits: Callable[[float], bool], low: float, high: float) -> float:
    """Return the highest value from ``low`` to ``high`` that fits; all values below it must fit, and none above."""
    if fits(high):
        return high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low
