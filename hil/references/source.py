"""Building blocks of references: points of a path, and the phase along it over time."""

from typing import ClassVar, Protocol

from hil.core.tuples import make_reference
from hil.core.types import Acceleration, Axes, Pose, Reference, Twist


class ReferenceSource(Protocol):
    """A motion that is defined for every time from 0 on."""

    @property
    def ends(self) -> bool:
        """Whether it moves and comes to rest after ``span_s``. False for one that repeats for ever or never moves."""

    @property
    def span_s(self) -> float:
        """Time [s] after which nothing new happens: start plus one period, or the time of the end."""

    def at(self, t_s: float) -> Reference:
        """Return pose, twist and acceleration in the world frame at this time of the scenario [s], at least 0."""

    def __hash__(self) -> int:
        """Equal sources are the same motion."""


class Lap:
    """The base of a motion that repeats for ever after a ramp; a frozen dataclass has the two durations [s]."""

    __slots__ = ()
    ends: ClassVar[bool] = False
    ramp_s: float
    period_s: float

    @property
    def span_s(self) -> float:
        """The ramp and one lap [s]."""
        return self.ramp_s + self.period_s


Phase = tuple[float, float, float]  # path parameter, and its first and second derivative with respect to time


Point = tuple[Axes, Axes, Axes]
"""A point of a path: (x, y, heading), and the first and second derivatives of these by the path's parameter."""


def at_rest(pose: Pose) -> Reference:
    """Return the reference of a robot that rests at a pose."""
    return Reference(pose, Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))


def motion_through(point: Point, rate: float, acceleration: float) -> Reference:
    """Return the motion through a point whose parameter changes with this rate and acceleration (chain rule)."""
    (x, y, heading), (x1, y1, heading1), (x2, y2, heading2) = point
    square = rate * rate
    ax, ay = square * x2 + acceleration * x1, square * y2 + acceleration * y1
    ah = square * heading2 + acceleration * heading1
    return make_reference(x, y, heading, rate * x1, rate * y1, rate * heading1, ax, ay, ah)


def ramped(t_s: float, rate: float, ramp_s: float) -> Phase:
    """Return the phase of a motion that accelerates from rest to a constant rate within ``ramp_s`` [s].

    The rate follows 3 u² - 2 u³ with u = t / ramp, so its derivative has no jump. After the ramp the phase is
    rate (t - ramp / 2). With ``ramp_s`` 0 the motion has its full rate from the beginning.
    """
    if t_s >= ramp_s or ramp_s == 0.0:
        return rate * (t_s - 0.5 * ramp_s), rate, 0.0
    u = t_s / ramp_s
    value = rate * ramp_s * u * u * u * (1.0 - 0.5 * u)
    return value, rate * u * u * (3.0 - 2.0 * u), rate * 6.0 * u * (1.0 - u) / ramp_s
