"""Plans a motion along waypoints: first the path with its corners, then the fastest speeds within the limits.

On lines the speed follows the double-S profile. A bend is driven at one speed v; with its curvature κ the acceleration
is κ v² across the path, and the jerk is (κ² v³, κ' v³). The heading of a leg that begins and ends at rest changes
linearly with the distance. On any other leg the heading θ is eased from the middle of one bend to the middle of the
next. Its derivatives θ', θ'' and θ''' by the distance give, with speed v, acceleration a and jerk j of the robot:

    yaw rate = θ' v,   yaw acceleration = θ'' v² + θ' a,   yaw jerk = θ''' v³ + 3 θ'' v a + θ' j

Each term of a sum gets an equal share of the limit, so that the sum keeps it; this limits the speed of the leg. Speeds
at the bends are then lowered, forward and backward along the path, until each can be reached from its neighbours.
"""

import bisect
import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import ClassVar, NamedTuple

from hil.core.kinematics import wrap_angle
from hil.core.types import Pose, Reference
from hil.references.curves import EASED_PEAKS, Bend, Eased, HeadingLaw, Line, Linear, Section
from hil.references.double_s import Limits, Phase, after, profile, reachable_speed
from hil.references.source import at_rest, motion_through

SHARPEST_RAD = math.radians(150.0)  # the robot stops at a corner that turns by more than this

Segment = tuple[Section, Phase]  # a phase of constant jerk on a section


class Waypoint(NamedTuple):
    """A pose to pass; ``speed_m_s`` is the top speed on the way to it, infinite where it sets none."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    dwell_s: float


class Route:
    """A planned motion: at rest at its beginning and at its end, where it stays."""

    ends: ClassVar[bool] = True

    def __init__(self, segments: Sequence[Segment], end: Pose) -> None:
        self._segments = segments
        *self._starts_s, self.span_s = accumulate((phase.duration_s for _, phase in segments), initial=0.0)
        self._end = at_rest(end)

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; from the end on it rests."""
        if t_s >= self.span_s:
            return self._end
        number = max(bisect.bisect_right(self._starts_s, t_s) - 1, 0)
        section, phase = self._segments[number]
        way, speed, acceleration = after(phase, t_s - self._starts_s[number])
        return motion_through(section.point(way), speed, acceleration)


class _Leg:
    """The way between two waypoints: straight, or a turn on the spot. A bend at either end takes a part of it."""

    def __init__(self, first: Waypoint, last: Waypoint, limits: Limits, yaw: Limits) -> None:
        self.first, self.last = first, last
        self.length = math.hypot(last.x_m - first.x_m, last.y_m - first.y_m)
        self.direction = math.atan2(last.y_m - first.y_m, last.x_m - first.x_m)
        self._change = last.heading_rad - first.heading_rad
        self.begin: Bend | None = None
        self.end: Bend | None = None
        self._limits, self._yaw = limits._replace(speed=min(limits.speed, last.speed_m_s)), yaw

    @property
    def way(self) -> float:
        """Length of the straight part [m], or the angle of the turn on the spot [rad]."""
        if self.length == 0.0:
            return abs(self._change)
        return max(self.length - sum(bend.tangent_m for bend in (self.begin, self.end) if bend is not None), 0.0)

    @cached_property
    def limits(self) -> Limits:
        """Limits along ``way`` that keep those of plane and yaw. To be read after the bends are set."""
        plane, yaw, change = self._limits, self._yaw, abs(self._change)
        if self.length == 0.0:
            return yaw
        if change == 0.0:
            return plane
        whole = self._whole()
        if self.begin is None and self.end is None:
            return Limits(*(min(p, y * whole / change) for p, y in zip(plane, yaw, strict=True)))
        slope, bend, twist = (peak * change / whole**n for n, peak in enumerate(EASED_PEAKS, start=1))
        speed = min(
            plane.speed,
            yaw.speed / slope,
            math.sqrt(yaw.acceleration / (2.0 * bend)),
            math.cbrt(yaw.jerk / (3.0 * twist)),
        )
        acceleration = min(plane.acceleration, yaw.acceleration / (2.0 * slope), yaw.jerk / (9.0 * bend * speed))
        return Limits(speed, acceleration, min(plane.jerk, yaw.jerk / (3.0 * slope)))

    def segments(self, first_speed: float, last_speed: float) -> Iterator[Segment]:
        """Yield the motion from the middle of the bend at the beginning to the middle of the one at the end.

        Without a bend at the beginning, it begins with the dwell time of the first waypoint.
        """
        x, y, heading = self.first[:3]
        before = tangent_m = 0.0
        if self.begin is None:
            yield from _dwell(self.first)
        else:
            before, tangent_m = 0.5 * self.begin.length, self.begin.tangent_m
            yield Section(self.begin, self._law(-before)), Phase(before / first_speed, before, first_speed, 0.0, 0.0)
        if self.length == 0.0:
            section = Section(Line(x, y, 0.0, 0.0), Linear(heading, math.copysign(1.0, self._change)))
        else:
            c, s = math.cos(self.direction), math.sin(self.direction)
            section = Section(Line(x + tangent_m * c, y + tangent_m * s, c, s), self._law(before))
        for phase in profile(self.way, first_speed, last_speed, self.limits):
            yield section, phase
        if self.end is not None:
            duration_s = 0.5 * self.end.length / last_speed
            yield Section(self.end, self._law(before + self.way)), Phase(duration_s, 0.0, last_speed, 0.0, 0.0)

    def _law(self, offset: float) -> HeadingLaw:
        """Return the heading law of a section that begins ``offset`` [m] behind where the heading begins to change."""
        if self.begin is None and self.end is None:
            return Linear(self.first.heading_rad, self._change / self.length)
        return Eased(self.first.heading_rad, self._change, self._whole(), offset)

    def _whole(self) -> float:
        """Return the length from the middle of one bend to the middle of the next [m]."""
        return self.way + sum(bend.length / 2.0 for bend in (self.begin, self.end) if bend is not None)


def plan(waypoints: Sequence[Waypoint], limits: Limits, yaw: Limits, blend_m: float) -> Route:
    """Return the motion along waypoints, of which no two in a row are the same pose.

    ``limits`` are those of the robot's centre in m and s, ``yaw`` those of its heading in rad and s. ``blend_m`` is the
    length that a bend may take of either leg, at most half of the leg; with 0 the robot stops at each corner. The robot
    stops at a waypoint with a dwell time, before and after a turn on the spot, and at corners sharper than
    ``SHARPEST_RAD``.
    """
    legs = [_Leg(first, last, limits, yaw) for first, last in pairwise(waypoints)]
    if blend_m > 0.0:
        for before, behind in pairwise(legs):
            _round_off(before, behind, blend_m)
    speeds = [0.0, *(_bend_speed(before, behind, limits) for before, behind in pairwise(legs)), 0.0]
    for number, leg in enumerate(legs):
        speeds[number + 1] = min(speeds[number + 1], reachable_speed(speeds[number], leg.way, leg.limits))
    for number, leg in reversed(list(enumerate(legs))):
        speeds[number] = min(speeds[number], reachable_speed(speeds[number + 1], leg.way, leg.limits))
    segments = [segment for leg, ends in zip(legs, pairwise(speeds), strict=True) for segment in leg.segments(*ends)]
    return Route([*segments, *_dwell(waypoints[-1])], Pose(*waypoints[-1][:3]))


def _round_off(before: _Leg, behind: _Leg, blend_m: float) -> None:
    """Put a bend between two legs, unless the robot has to stop at their corner."""
    turn = wrap_angle(behind.direction - before.direction)
    corner = before.last
    tangent_m = min(blend_m, 0.5 * before.length, 0.5 * behind.length)
    if corner.dwell_s == 0.0 and tangent_m > 0.0 and abs(turn) <= SHARPEST_RAD:
        x = corner.x_m - tangent_m * math.cos(before.direction)
        y = corner.y_m - tangent_m * math.sin(before.direction)
        before.end = behind.begin = Bend(x, y, before.direction, turn, tangent_m)


def _bend_speed(before: _Leg, behind: _Leg, limits: Limits) -> float:
    """Return the highest speed in the bend between two legs, 0 where there is none."""
    if (bend := before.end) is None:
        return 0.0
    speed = min(before.limits.speed, behind.limits.speed)
    if (curvature := bend.peak_curvature) > 0.0:
        across = math.sqrt(limits.acceleration / curvature)
        speed = min(speed, across, math.cbrt(limits.jerk / math.hypot(curvature**2, bend.peak_sharpness)))
    return speed


def _dwell(at: Waypoint) -> list[Segment]:
    """Return the dwell time of a waypoint as segments: one, or none."""
    if at.dwell_s == 0.0:
        return []
    there = Section(Line(at.x_m, at.y_m, 0.0, 0.0), Linear(at.heading_rad))
    return [(there, Phase(at.dwell_s, 0.0, 0.0, 0.0, 0.0))]
