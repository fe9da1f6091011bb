"""Where the robot should be: references as pure functions of the scenario's time."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from hil.errors import BadInputError, nearest
from hil.options import build, require_positive
from hil.types import Acceleration, Pose, Reference, Twist


class ReferenceSource(Protocol):
    """A motion that is known for every time from 0 on."""

    def at(self, t_s: float) -> Reference:
        """Return pose, twist and acceleration in the world frame at this time of the scenario [s]."""


@dataclass(frozen=True, slots=True)
class Circle:
    """A circle, counter-clockwise at constant speed from its rightmost point, with a heading that does not
    turn.

    Nguyen Minh et al. 2023, AFDSC, section IV.A: radius 1 m, period 15 s, heading π/4, about the origin.
    """

    radius_m: float = 1.0
    period_s: float = 15.0
    heading_rad: float = 0.0
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0

    def __post_init__(self) -> None:
        require_positive(self, "radius_m", "period_s")

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; the acceleration points to the centre."""
        rate = math.tau / self.period_s
        x = self.radius_m * math.cos(rate * t_s)
        y = self.radius_m * math.sin(rate * t_s)
        return Reference(
            Pose(self.centre_x_m + x, self.centre_y_m + y, self.heading_rad),
            Twist(-rate * y, rate * x, 0.0),
            Acceleration(-rate * rate * x, -rate * rate * y, 0.0),
        )


@dataclass(frozen=True, slots=True)
class Hold:
    """A pose to reach and to keep."""

    x_m: float = 0.0
    y_m: float = 0.0
    heading_rad: float = 0.0

    def at(self, t_s: float) -> Reference:
        """Return the pose, at rest."""
        return Reference(Pose(self.x_m, self.y_m, self.heading_rad), Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))


KINDS: dict[str, type[Circle] | type[Hold]] = {"circle": Circle, "hold": Hold}


def make_reference(kind: str, options: Mapping[str, object]) -> ReferenceSource:
    """Return the reference of a scenario's ``[reference]`` table, ``options`` being the table without its
    kind.

    Raises BadInputError for an unknown kind or option (with the nearest), a wrong type and a value out of
    range.
    """
    if kind not in KINDS:
        raise BadInputError(f"reference.kind = {kind!r}: unknown{nearest(kind, KINDS)}")
    return build(KINDS[kind], options, "reference")
