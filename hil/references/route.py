"""Plans a motion along waypoints: first the path with its corners, then the fastest speeds within the limits.

On lines the speed follows the double-S profile. A bend is driven at one speed, so that its acceleration is κ v² across
and its jerk (κ² v³, κ' v³). The heading of a leg that begins and ends at rest changes linearly with the distance.
Otherwise it is eased from the middle of one bend to the middle of the next, and the speed of the leg is low enough for
it:

    θ̇ = θ' v,   θ̈ = θ'' v² + θ' a,   jerk = θ''' v³ + 3 θ'' v a + θ' j

Each sum stays within its limit because every term gets an equal share of it. Speeds at the bends are then lowered,
forward and backward along the path, until each is reachable from the one before and after.
"""

import bisect
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import ClassVar, NamedTuple

from hil.core.kinematics import wrap_angle
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references.curves import EASED_PEAKS, Bend, Eased, HeadingLaw, Line, Linear, Section
from hil.references.double_s import Limits, Phase, after, profile, reachable_speed
from hil.references.motion import motion_through

SHARPEST_RAD = math.radians(150.0)
"""At a corner that turns by more than this the robot stops."""


class Waypoint(NamedTuple):
    """A pose to pass; ``speed_m_s`` is the top speed on the way to it, infinite where it sets none."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    dwell_s: float


class Segment(NamedTuple):
    """A time of constant jerk on a section."""

    section: Section
    phase: Phase


class Route:
    """A planned motion: at rest at its beginning and at its end, where it stays."""

    ends: ClassVar[bool] = True

    def __init__(self, segments: Sequence[Segment], end: Pose) -> None:
        self._segments = segments
        self._starts_s = []
        self._end = Reference(end, Twist(0.0, 0.0, 0.0), Acceleration(0.0, 0.0, 0.0))
        t_s = 0.0
        for segment in segments:
            self._starts_s.append(t_s)
            t_s += segment.phase.duration_s
        self.span_s = t_s

    def at(self, t_s: float) -> Reference:
        """Return the reference at ``t_s``; from the end on it rests."""
        if t_s >= self.span_s:
            return self._end
        number = max(bisect.bisect_right(self._starts_s, t_s) - 1, 0)
        section, phase = self._segments[number]
        way, speed, acceleration = after(phase, t_s - self._starts_s[number])
        return motion_through(section.point(way), speed, acceleration)


class _Leg:
    """The straight part between two waypoints, without the bends at its ends."""

    def __init__(self, first: Waypoint, last: Waypoint, limits: Limits, yaw: Limits) -> None:
        self.first, self.last = first, last
        self.length = math.hypot(last.x_m - first.x_m, last.y_m - first.y_m)
        self.direction = math.atan2(last.y_m - first.y_m, last.x_m - first.x_m)
        self.change = last.heading_rad - first.heading_rad
        self.begin: Bend | None = None
        self.end: Bend | None = None
        self.trims = (0.0, 0.0)
        self._limits, self._yaw = limits._replace(speed=min(limits.speed, last.speed_m_s)), yaw

    @property
    def way(self) -> float:
        """Length of the straight part [m]."""
        return max(self.length - sum(self.trims), 0.0)

    def limits(self) -> Limits:
        """Return limits along the path [m], or of the angle [rad] on the spot, that keep those of plane and yaw."""
        plane, yaw = self._limits, self._yaw
        change = abs(self.change)
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

    def line(self) -> Section:
        """Return the straight part, or the turn on the spot."""
        x, y, heading = self.first.x_m, self.first.y_m, self.first.heading_rad
        if self.length == 0.0:
            return Section(Line(x, y, 0.0, 0.0), Linear(heading, math.copysign(1.0, self.change)))
        c, s = math.cos(self.direction), math.sin(self.direction)
        before = self.begin.length / 2.0 if self.begin is not None else 0.0
        return Section(Line(x + self.trims[0] * c, y + self.trims[0] * s, c, s), self._law(before))

    def law_at_begin(self, bend: Bend) -> HeadingLaw:
        """Return the heading law in the bend at the beginning of this leg."""
        return self._law(-bend.length / 2.0)

    def law_at_end(self) -> HeadingLaw:
        """Return the heading law in the bend at the end of this leg."""
        before = self.begin.length / 2.0 if self.begin is not None else 0.0
        return self._law(before + self.way)

    def _law(self, offset: float) -> HeadingLaw:
        if self.begin is None and self.end is None:
            return Linear(self.first.heading_rad, self.change / self.length)
        return Eased(self.first.heading_rad, self.change, self._whole(), offset)

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
    leg_limits = [leg.limits() for leg in legs]
    ways = [leg.way if leg.length else abs(leg.change) for leg in legs]
    speeds = [0.0, *(_bend_speed(*pair, limits) for pair in pairwise(zip(legs, leg_limits, strict=True))), 0.0]
    for number, (way, within) in enumerate(zip(ways, leg_limits, strict=True)):
        speeds[number + 1] = min(speeds[number + 1], reachable_speed(speeds[number], way, within))
    for number in reversed(range(len(legs))):
        speeds[number] = min(speeds[number], reachable_speed(speeds[number + 1], ways[number], leg_limits[number]))
    segments: list[Segment] = []
    for number, leg in enumerate(legs):
        if leg.begin is not None:
            _drive_through(segments, leg.begin, leg.law_at_begin(leg.begin), 0.5 * leg.begin.length, speeds[number])
        else:
            _wait(segments, leg.first)
        section = leg.line()
        segments += [
            Segment(section, phase)
            for phase in profile(ways[number], speeds[number], speeds[number + 1], leg_limits[number])
        ]
        if leg.end is not None:
            _drive_through(segments, leg.end, leg.law_at_end(), 0.0, speeds[number + 1])
    _wait(segments, waypoints[-1])
    end = waypoints[-1]
    return Route(segments, Pose(end.x_m, end.y_m, end.heading_rad))


def _round_off(before: _Leg, behind: _Leg, blend_m: float) -> None:
    """Put a bend between two legs, unless the robot has to stop at their corner."""
    turn = wrap_angle(behind.direction - before.direction)
    corner = before.last
    tangent_m = min(blend_m, 0.5 * before.length, 0.5 * behind.length)
    if corner.dwell_s > 0.0 or tangent_m == 0.0 or abs(turn) > SHARPEST_RAD:
        return
    x = corner.x_m - tangent_m * math.cos(before.direction)
    y = corner.y_m - tangent_m * math.sin(before.direction)
    bend = Bend(x, y, before.direction, turn, tangent_m)
    before.end = behind.begin = bend
    before.trims = (before.trims[0], tangent_m)
    behind.trims = (tangent_m, behind.trims[1])


def _bend_speed(before: tuple[_Leg, Limits], behind: tuple[_Leg, Limits], limits: Limits) -> float:
    """Return the highest speed in the bend between two legs, 0 where there is none."""
    bend = before[0].end
    if bend is None:
        return 0.0
    speed = min(before[1].speed, behind[1].speed)
    if (curvature := bend.peak_curvature) > 0.0:
        speed = min(
            speed,
            math.sqrt(limits.acceleration / curvature),
            math.cbrt(limits.jerk / math.hypot(curvature**2, bend.peak_sharpness)),
        )
    return speed


def _drive_through(segments: list[Segment], bend: Bend, law: HeadingLaw, begin: float, speed: float) -> None:
    """Add half of a bend."""
    segments.append(Segment(Section(bend, law), Phase(0.5 * bend.length / speed, begin, speed, 0.0, 0.0)))


def _wait(segments: list[Segment], at: Waypoint) -> None:
    """Add the dwell time of a waypoint."""
    if at.dwell_s > 0.0:
        there = Section(Line(at.x_m, at.y_m, 0.0, 0.0), Linear(at.heading_rad))
        segments.append(Segment(there, Phase(at.dwell_s, 0.0, 0.0, 0.0, 0.0)))
