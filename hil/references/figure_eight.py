"""The figure eight: two lemniscates, each with the derivatives of its direction in closed form.

With the parameter φ from 0 at the centre, s = sin φ, c = cos φ and the half length a:

- Gerono:     x = a s,             y = a s c,             direction atan2(c, 1 - 2 c²) - π/2
- Bernoulli:  x = a s / (1 + c²),  y = a s c / (1 + c²),  direction 3 atan(c) - π/2

Both directions are written so that they are continuous: an eight turns left as much as right, and its heading
comes back without a jump of 2π. Bernoulli's curve is z = a s / (1 - i c) in the complex plane, from which its
derivatives follow.
"""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import Reference
from hil.references.motion import Point, motion_through, ramped


@dataclass(frozen=True, slots=True)
class FigureEight:
    """A lying eight from its centre, first up to the right, with a heading that is fixed or turns with the path.

    It is 2 ``half_length_m`` long in x, and half as wide (Gerono) or 0.354 times as wide (Bernoulli). With
    ``heading = "path"`` the robot looks where it goes, ``heading_rad`` to the left of it.
    """

    half_length_m: Annotated[float, POSITIVE] = 1.0
    period_s: Annotated[float, POSITIVE] = 15.0
    shape: Literal["gerono", "bernoulli"] = "gerono"
    heading: Literal["fixed", "path"] = "fixed"
    heading_rad: float = 0.0
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0

    ends: ClassVar[bool] = False

    @property
    def span_s(self) -> float:
        """The ramp and one period [s]."""
        return self.ramp_s + self.period_s

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
