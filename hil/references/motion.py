"""What references are made of: a path of points, and how far along it the robot should be at a time."""

from typing import NamedTuple, Protocol

from hil.core.types import Reference, make_acceleration, make_pose, make_reference, make_twist


class ReferenceSource(Protocol):
    """A motion that is known for every time from 0 on."""

    @property
    def ends(self) -> bool:
        """Whether it comes to rest after ``span_s``; False for what goes on for ever, and for what never moves."""

    @property
    def span_s(self) -> float:
        """Time [s] from 0 within which all happens that ever will: the start and one period, or the way to the end."""

    def at(self, t_s: float) -> Reference:
        """Return pose, twist and acceleration in the world frame at this time of the scenario [s], at least 0."""


Phase = tuple[float, float, float]
"""How far along a path, and the first and second derivative of that with respect to time."""


class Point(NamedTuple):
    """A point of a path: x, y and heading, and their derivatives with respect to the path's parameter."""

    x: float
    y: float
    heading: float
    x1: float
    y1: float
    heading1: float
    x2: float
    y2: float
    heading2: float


def moving(point: Point, rate: float, acceleration: float) -> Reference:
    """Return the motion through a point whose parameter changes with this rate and acceleration (chain rule)."""
    x, y, heading, x1, y1, heading1, x2, y2, heading2 = point
    square = rate * rate
    slope = (
        square * x2 + acceleration * x1,
        square * y2 + acceleration * y1,
        square * heading2 + acceleration * heading1,
    )
    twist = make_twist((rate * x1, rate * y1, rate * heading1))
    return make_reference((make_pose((x, y, heading)), twist, make_acceleration(slope)))


def ramped(t_s: float, rate: float, ramp_s: float) -> Phase:
    """Return the phase of a motion that comes from rest to a constant rate within ``ramp_s``.

    The rate follows 3 u² - 2 u³ with u = t / ramp, so that its derivative has no jump; after the ramp the phase is
    rate (t - ramp / 2). Without a ramp the motion is at its rate from the beginning.
    """
    if t_s >= ramp_s or ramp_s == 0.0:
        return rate * (t_s - 0.5 * ramp_s), rate, 0.0
    u = t_s / ramp_s
    value = rate * ramp_s * u * u * u * (1.0 - 0.5 * u)
    return value, rate * u * u * (3.0 - 2.0 * u), rate * 6.0 * u * (1.0 - u) / ramp_s
