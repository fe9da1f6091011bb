"""The square with rounded corners."""

import bisect
import math
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Annotated, Literal

from hil.core.options import NOT_NEGATIVE, POSITIVE
from hil.core.types import Reference
from hil.references.curves import Bend, Line, Linear, Section
from hil.references.source import Lap, motion_through, ramped


@dataclass(frozen=True, slots=True)
class RoundedSquare(Lap):
    """A square at constant speed from the middle of its right side, with corners whose curvature has no jump.

    A corner takes ``corner_m`` of either side. With ``heading = "path"`` the robot looks where it goes,
    ``heading_rad`` to the left of it.
    """

    side_m: Annotated[float, POSITIVE] = 2.0
    corner_m: Annotated[float, POSITIVE] = 0.4
    period_s: Annotated[float, POSITIVE] = 20.0
    heading: Literal["fixed", "path"] = "fixed"
    heading_rad: float = 0.0
    centre_x_m: float = 0.0
    centre_y_m: float = 0.0
    clockwise: bool = False
    ramp_s: Annotated[float, NOT_NEGATIVE] = 0.0
    _sections: tuple[Section, ...] = field(init=False, repr=False, compare=False)
    _starts: tuple[float, ...] = field(init=False, repr=False, compare=False)
    """Way from the middle of the right side to where each section begins [m], and around."""

    def __post_init__(self) -> None:
        half, straight = 0.5 * self.side_m, 0.5 * self.side_m - self.corner_m
        if straight < 0.0:
            raise ValueError(f"corner_m = {self.corner_m:g}: expected at most half of side_m, {half:g}")
        follows, still = self.heading == "path", Linear(0.0)
        sections: list[Section] = []
        lengths: list[float] = []
        x, y = self.centre_x_m + half, self.centre_y_m
        for quarter in range(5):  # the right side comes in two halves
            direction = (quarter + 1) * math.pi / 2
            c, s = round(math.cos(direction)), round(math.sin(direction))
            way = straight if quarter in (0, 4) else 2.0 * straight
            sections.append(Section(Line(x, y, c, s), Linear(direction) if follows else still))
            lengths.append(way)
            if quarter < 4:
                x, y = x + way * c, y + way * s
                bend = Bend(x, y, direction, math.pi / 2, self.corner_m)
                sections.append(Section(bend, bend if follows else still))
                lengths.append(bend.length)
                # Where it ends, without what rounding made of it.
                x, y = x + self.corner_m * (c - s), y + self.corner_m * (s + c)
        object.__setattr__(self, "_sections", tuple(sections))
        object.__setattr__(self, "_starts", tuple(accumulate(lengths, initial=0.0)))

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``."""
        length = self._starts[-1]
        speed = length / self.period_s
        way, rate, acceleration = ramped(t_s, -speed if self.clockwise else speed, self.ramp_s)
        laps = math.floor(way / length)
        way -= laps * length
        number = min(max(bisect.bisect_right(self._starts, way) - 1, 0), len(self._sections) - 1)
        turned = self.heading_rad
        if self.heading == "path":
            turned += math.tau * laps - (math.pi if self.clockwise else 0.0)
        return motion_through(self._sections[number].point(way - self._starts[number], turned), rate, acceleration)
