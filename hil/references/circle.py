"""The circle."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.tuples import make_reference
from hil.core.types import Reference
from hil.references.motion import ramped


@dataclass(frozen=True, slots=True)
class Circle:
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

    ends: ClassVar[bool] = False

    @property
    def span_s(self) -> float:
        """The ramp and one turn [s]."""
        return self.ramp_s + self.period_s

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
