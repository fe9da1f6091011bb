"""The motions of a served robot, as references: by twist, at rest, to a pose, or along a path. Pure.

Time is the service's own, in seconds; it never decreases.
"""

import math

from hil.core.errors import BadInputError, apart
from hil.core.kinematics import BodyTwist, to_body, to_world, wrap_angle
from hil.core.types import Acceleration, Pose, Reference, Twist
from hil.references import ReferenceSource
from hil.references.double_s import Limits
from hil.references.route import Route, Waypoint, plan
from hil.scenario import ServiceTable

_NO_TWIST = BodyTwist(0.0, 0.0, 0.0)
STILL = Acceleration(0.0, 0.0, 0.0)
_SAME_M, _SAME_RAD = 0.001, 0.001
"""A shorter way is not driven: the robot is there already."""
_LEAP_M, _LEAP_RAD = 0.02, 0.04
_LOOK_S, _MOST_LOOKS = 0.01, 2000
_ROUNDING = 1e-6


class TwistMotion:
    """Drives by a twist in the body frame, with limited acceleration; without a twist it comes to rest and holds.

    The reference is ahead of the robot by at most ``MOST_AHEAD_M`` and ``MOST_AHEAD_RAD``. So a blocked robot does not
    jump when it is free again, and a robot that was carried away does not drive back far. When the estimated pose jumps
    (a localisation may correct it), the motion starts again there, from rest.

    ``start`` is the reference, or the robot's state, at ``t_s``; ``options`` has the limits of speed and acceleration.
    """

    MOST_AHEAD_M = 0.1
    MOST_AHEAD_RAD = 0.2

    def __init__(self, start: Reference, t_s: float, options: ServiceTable) -> None:
        self._pose = start.pose
        self._twist = to_body(start.twist, start.pose.heading_rad)
        self._t_s = t_s
        self._options = options
        self._robot: Pose | None = None
        self.target = _NO_TWIST

    @property
    def rests(self) -> bool:
        """Whether the reference stands still."""
        return self._twist == _NO_TWIST

    def set_target(self, twist: BodyTwist) -> BodyTwist:
        """Drive by this twist from now on, scaled to the limits; return the scaled twist."""
        options = self._options
        forward, left, yaw_rate = twist
        largest = max(math.hypot(forward, left) / options.speed_m_s, abs(yaw_rate) / options.yaw_rate_rad_s, 1.0)
        self.target = BodyTwist(forward / largest, left / largest, yaw_rate / largest)
        return self.target

    def at(self, t_s: float, pose: Pose | None) -> Reference:
        """Return the reference of this tick."""
        dt_s = t_s - self._t_s
        self._t_s = t_s
        if pose is not None and self._leapt(pose, dt_s):
            self._pose, self._twist = pose, _NO_TWIST
        self._robot = pose
        before, self._twist = self._twist, self._towards(dt_s)
        forward, left, yaw_rate = ((a + b) / 2.0 for a, b in zip(before, self._twist, strict=True))
        x_m, y_m, heading_rad = self._pose
        vx_m_s, vy_m_s, _ = to_world(BodyTwist(forward, left, yaw_rate), heading_rad + yaw_rate * dt_s / 2.0)
        self._pose = Pose(x_m + vx_m_s * dt_s, y_m + vy_m_s * dt_s, heading_rad + yaw_rate * dt_s)
        if pose is not None:
            self._pose = _limit_lead(self._pose, pose)
        twist = to_world(self._twist, self._pose.heading_rad)
        return Reference(self._pose, twist, self._acceleration(before, dt_s, twist))

    def _leapt(self, pose: Pose, dt_s: float) -> bool:
        """Whether the estimated pose moved farther since the last tick than the robot can have driven."""
        if self._robot is None:
            return False
        turn_rad = abs(wrap_angle(pose.heading_rad - self._robot.heading_rad))
        return (
            math.dist(pose[:2], self._robot[:2]) > _LEAP_M + 2.0 * self._options.speed_m_s * dt_s
            or turn_rad > _LEAP_RAD + 2.0 * self._options.yaw_rate_rad_s * dt_s
        )

    def _towards(self, dt_s: float) -> BodyTwist:
        """Return the twist after ``dt_s``, on the way to the target twist."""
        options = self._options
        change = [b - a for a, b in zip(self._twist, self.target, strict=True)]
        plane, turn = math.hypot(*change[:2]), abs(change[2])
        share = min(1.0, options.acceleration_m_s2 * dt_s / plane) if plane else 1.0
        turn_share = min(1.0, options.yaw_acceleration_rad_s2 * dt_s / turn) if turn else 1.0
        if share == turn_share == 1.0:
            return self.target
        shares = (share, share, turn_share)
        return BodyTwist(*(a + share * b for a, b, share in zip(self._twist, change, shares, strict=True)))

    def _acceleration(self, before: BodyTwist, dt_s: float, twist: Twist) -> Acceleration:
        if dt_s <= 0.0:
            return STILL
        change = BodyTwist(*((b - a) / dt_s for a, b in zip(before, self._twist, strict=True)))
        ax, ay, yaw = to_world(change, self._pose.heading_rad)
        # The body frame turns with the robot: a = R u' + ω × R u.
        return Acceleration(ax - twist.yaw_rate_rad_s * twist.vy_m_s, ay + twist.yaw_rate_rad_s * twist.vx_m_s, yaw)


def _limit_lead(reference: Pose, pose: Pose) -> Pose:
    x_m, y_m = reference.x_m - pose.x_m, reference.y_m - pose.y_m
    turn_rad = wrap_angle(reference.heading_rad - pose.heading_rad)
    share = min(1.0, TwistMotion.MOST_AHEAD_M / max(math.hypot(x_m, y_m), TwistMotion.MOST_AHEAD_M))
    limit = TwistMotion.MOST_AHEAD_RAD
    if share == 1.0 and abs(turn_rad) <= limit:
        return reference
    return Pose(pose.x_m + share * x_m, pose.y_m + share * y_m, pose.heading_rad + min(max(turn_rad, -limit), limit))


class Follow:
    """Follows a path from ``start_s`` on, or from the end of the ``way`` to the path's start, if one is given.

    ``frame`` is the pose of the path's own origin in the world; None for the world's origin.
    """

    def __init__(
        self, path: ReferenceSource, start_s: float, way: Route | None = None, frame: Pose | None = None
    ) -> None:
        self._path = path
        self._way = way
        self._start_s = start_s
        self._begin_s = start_s + (way.span_s if way is not None else 0.0)
        self._frame = frame

    def at(self, t_s: float, pose: Pose | None) -> Reference:
        """Return the reference of this tick."""
        if self._way is not None and t_s < self._begin_s:
            return self._way.at(t_s - self._start_s)
        reference = self._path.at(max(t_s - self._begin_s, 0.0))
        return reference if self._frame is None else _moved(reference, self._frame)


def way_to(start: Pose, end: Pose, options: ServiceTable) -> Route | None:
    """Return a straight route from rest to rest, by the shorter turn; None when it is too short to drive."""
    turn_rad = wrap_angle(end.heading_rad - start.heading_rad)
    length_m = math.dist(start[:2], end[:2])
    if length_m < _SAME_M and abs(turn_rad) < _SAME_RAD:
        return None
    x_m, y_m = (start[:2]) if length_m < _SAME_M else end[:2]
    plane = Limits(options.speed_m_s, options.acceleration_m_s2, options.jerk_m_s3)
    yaw = Limits(options.yaw_rate_rad_s, options.yaw_acceleration_rad_s2, options.yaw_jerk_rad_s3)
    first = Waypoint(*start, math.inf, 0.0)
    return plan([first, Waypoint(x_m, y_m, start.heading_rad + turn_rad, math.inf, 0.0)], plane, yaw, 0.0)


def frame_at(pose: Pose, begin: Pose) -> Pose:
    """Return a path's origin in the world. The path starts at ``begin`` in its own frame, at ``pose`` in the world."""
    turn_rad = pose.heading_rad - begin.heading_rad
    x_m, y_m, _ = to_world(BodyTwist(*begin), turn_rad)
    return Pose(pose.x_m - x_m, pose.y_m - y_m, turn_rad)


def _moved(reference: Reference, frame: Pose) -> Reference:
    """Return a reference of a path's own frame in the world."""
    pose, twist, acceleration = (to_world(BodyTwist(*part), frame.heading_rad) for part in reference)
    return Reference(Pose(*map(sum, zip(frame, pose, strict=True))), twist, Acceleration(*acceleration))


def check_path(path: ReferenceSource, options: ServiceTable) -> None:
    """Raise BadInputError for a path that is faster than the limits of the service, or not finite somewhere.

    Speeds and accelerations are looked at every 10 ms, in a path of more than 20 s at 2000 times. A jump of the path
    has none; the limiter of the commands keeps the robot within the limits there.
    """
    limits = (
        ("m/s", "speed_m_s", options.speed_m_s),
        ("rad/s", "yaw_rate_rad_s", options.yaw_rate_rad_s),
        ("m/s²", "acceleration_m_s2", options.acceleration_m_s2),
        ("rad/s²", "yaw_acceleration_rad_s2", options.yaw_acceleration_rad_s2),
    )
    worst = [(0.0, 0.0)] * len(limits)
    step_s = max(_LOOK_S, path.span_s / _MOST_LOOKS)
    times = (
        [number * step_s for number in range(math.floor(path.span_s / step_s) + 1)] if path.span_s < math.inf else []
    )
    for t_s in (*times, path.span_s, 10.0 * path.span_s):
        try:
            pose, (vx, vy, yaw_rate), (ax, ay, yaw_acceleration) = path.at(t_s)
            found = math.hypot(vx, vy), abs(yaw_rate), math.hypot(ax, ay), abs(yaw_acceleration)
            is_finite = math.isfinite(sum(pose) + sum(found))
        except (ArithmeticError, ValueError):
            is_finite = False
        if not is_finite:
            raise BadInputError("the path has no finite pose at some time; its options are too large or too small")
        worst = [
            (one, t_s) if one > before[0] * (1.0 + _ROUNDING) else before
            for before, one in zip(worst, found, strict=True)
        ]
    for (unit, name, limit), (value, t_s) in zip(limits, worst, strict=True):
        if value > limit * (1.0 + _ROUNDING):
            raise BadInputError(
                f"the path reaches {apart(value, limit)} {unit} at t = {t_s:.3g} s, and service.{name} is "
                f"{limit:g}; make it slower"
            )
