"""Shapes in closed form: circle, lying eight, a spin along a line or a circle, and a pose to hold."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.tuples import make_reference
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references.source import Lap, Point, at_rest, motion_through, ramped


@dataclass(frozen=True, slots=True)
class Circle(Lap):
    """A circle at constant speed from its rightmost point, with a heading that is fixed or turns with the path.

    Nguyen Minh et al. 2023, AFDSC, section IV.A: radius 1 m, period 15 s, heading π/4, about the origin. With
    ``heading = "path"`` the robot looks where it goes, ``heading_rad`` to the left of it.
    """

    radius_m: Annotated[float, POSITIVE] = 1.0
    period_s: Annotated[float, POSITIVE] = 15.0
    heading_rad: float = 0.0
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0
    heading: Literal["fixed", "path"] = "fixed"
    clockwise: bool = False
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; after the ramp the acceleration points to the centre."""
        turn = -math.tau if self.clockwise else math.tau
        angle, rate, acceleration = ramped(t_s, turn / self.period_s, self.ramp_s)
        x = self.radius_m * math.cos(angle)
        y = self.radius_m * math.sin(angle)
        heading, yaw_rate, yaw_acceleration = self.heading_rad, 0.0, 0.0
        if self.heading == "path":
            heading, yaw_rate, yaw_acceleration = heading + 0.25 * turn + angle, rate, acceleration
        vx, vy = -rate * y, rate * x
        ax, ay = -rate * rate * x - acceleration * y, -rate * rate * y + acceleration * x
        x, y = self.centre_x_m + x, self.centre_y_m + y
        return make_reference(x, y, heading, vx, vy, yaw_rate, ax, ay, yaw_acceleration)


@dataclass(frozen=True, slots=True)
class FigureEight(Lap):
    """A lying eight from its centre, first up to the right, with a heading that is fixed or turns with the path.

    It is 2 ``half_length_m`` long in x, and half as wide (Gerono) or 0.354 times as wide (Bernoulli). With
    ``heading = "path"`` the robot looks where it goes, ``heading_rad`` to the left of it.

    With the parameter φ from 0 at the centre, s = sin φ, c = cos φ and the half length a:

    - Gerono:     x = a s,             y = a s c,             direction atan2(c, 1 - 2 c²) - π/2
    - Bernoulli:  x = a s / (1 + c²),  y = a s c / (1 + c²),  direction 3 atan(c) - π/2

    Both directions are written so that they are continuous: an eight turns left as much as right, and its heading
    comes back without a jump of 2π. Bernoulli's curve is z = a s / (1 - i c) in the complex plane, from which its
    derivatives follow.
    """

    half_length_m: Annotated[float, POSITIVE] = 1.0
    period_s: Annotated[float, POSITIVE] = 15.0
    shape: Literal["gerono", "bernoulli"] = "gerono"
    heading: Literal["fixed", "path"] = "fixed"
    heading_rad: float = 0.0
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; the parameter, not the speed, is even in time."""
        angle, rate, acceleration = ramped(t_s, math.tau / self.period_s, self.ramp_s)
        curve = _gerono if self.shape == "gerono" else _bernoulli
        (x, y, direction), (x1, y1, turn1), (x2, y2, turn2) = curve(math.sin(angle), math.cos(angle))
        if self.heading == "fixed":
            direction = turn1 = turn2 = 0.0
        a = self.half_length_m
        pose = (self.centre_x_m + a * x, self.centre_y_m + a * y, self.heading_rad + direction)
        return motion_through((pose, (a * x1, a * y1, turn1), (a * x2, a * y2, turn2)), rate, acceleration)


def _gerono(s: float, c: float) -> Point:
    """Return the curve of half length 1, its direction as heading."""
    c2, s2 = c * c - s * s, 2.0 * s * c  # of 2 φ
    # Direction: with u = x' = c and v = y' = cos 2φ its slope is (u v' - v u') / (u² + v²).
    speed2 = c * c + c2 * c2
    turn = -2.0 * c * s2 + s * c2
    turn1 = -3.0 * c * c2  # u v'' - v u''
    speed2_1 = -s2 - 4.0 * c2 * s2
    return (
        (s, s * c, math.atan2(c, 1.0 - 2.0 * c * c) - math.pi / 2),
        (c, c2, turn / speed2),
        (-s, -2.0 * s2, (turn1 * speed2 - turn * speed2_1) / (speed2 * speed2)),
    )


def _bernoulli(s: float, c: float) -> Point:
    """Return the curve of half length 1, its direction as heading."""
    cc = c * c
    f = 1.0 / (1.0 + cc)
    f2 = f * f
    # z' = -i (1 + i c) / (1 - i c)² and z'' = -s (3 + i c) / (1 - i c)³
    third = -s * f2 * f
    return (
        (s * f, s * c * f, 3.0 * math.atan(c) - math.pi / 2),
        (c * (3.0 - cc) * f2, (3.0 * cc - 1.0) * f2, -3.0 * s * f),
        (third * (3.0 - 12.0 * cc + cc * cc), third * c * (10.0 - 6.0 * cc), -3.0 * c * (3.0 - cc) * f2),
    )


@dataclass(frozen=True, slots=True)
class Spin:
    """A line, or a circle to the left, at constant speed while the robot turns at a yaw rate of its own.

    It begins at (``x_m``, ``y_m``) in ``direction_rad``. The speed is reached within ``ramp_s``, the yaw rate within
    ``yaw_ramp_s``; a negative yaw rate turns clockwise. ``radius_m`` is that of the circle; a line has none.
    """

    path: Literal["line", "circle"] = "line"
    speed_m_s: Annotated[float, NOT_NEGATIVE] = 0.3
    direction_rad: float = 0.0
    radius_m: Annotated[float, POSITIVE] = 1.0
    yaw_rate_rad_s: float = 0.8
    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0
    yaw_ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0

    ends: ClassVar[bool] = False

    @property
    def span_s(self) -> float:
        """The ramps, and the time until the robot has the same angle to its path again [s]."""
        turning = self.speed_m_s / self.radius_m if self.path == "circle" else 0.0
        relative = abs(self.yaw_rate_rad_s - turning)
        return max(self.ramp_s, self.yaw_ramp_s) + (math.tau / relative if relative else 0.0)

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``."""
        way, speed, acceleration = ramped(t_s, self.speed_m_s, self.ramp_s)
        turned, yaw_rate, yaw_acceleration = ramped(t_s, self.yaw_rate_rad_s, self.yaw_ramp_s)
        direction = self.direction_rad
        c, s = math.cos(direction), math.sin(direction)
        if self.path == "line":
            x, y, ahead, aside = self.x_m + way * c, self.y_m + way * s, acceleration, 0.0
        else:
            angle = direction + way / self.radius_m
            c0, s0, c, s = c, s, math.cos(angle), math.sin(angle)
            x, y = self.x_m + self.radius_m * (s - s0), self.y_m + self.radius_m * (c0 - c)
            ahead, aside = acceleration, speed * speed / self.radius_m
        return Reference(
            Pose(x, y, self.heading_rad + turned),
            Twist(speed * c, speed * s, yaw_rate),
            Acceleration(ahead * c - aside * s, ahead * s + aside * c, yaw_acceleration),
        )


@dataclass(frozen=True, slots=True)
class Hold:
    """A pose to reach and to keep."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    ends: ClassVar[bool] = False

    @property
    def span_s(self) -> float:
        """0: nothing changes."""
        return 0.0

    def at(self, t_s: float) -> Reference:
        """Return the pose, at rest."""
        return at_rest(Pose(self.x_m, self.y_m, self.heading_rad))
