"""Turning while driving: what a Mecanum robot can do and others cannot."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references.motion import ramped


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
