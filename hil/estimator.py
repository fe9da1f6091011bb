"""Where the robot is: by ground truth, by an external localisation, or by odometry.

The estimators are pure: they are given what was received and hold no clock. Time is robot time in
nanoseconds.
"""

import math
from typing import Protocol

from hil.errors import BadInputError, nearest
from hil.kinematics import BodyTwist, body_twist, to_world
from hil.model import RobotModel
from hil.types import Pose, PoseFix, State, Wheels

SOURCES = ("truth", "odometry")

Counts = tuple[int, int, int, int]
"""Encoder counts of FL, FR, RR, RL as on the wire: 16 bits, wrapping (DBC ENCODERS)."""


class Measurement(Protocol):
    """What one feedback snapshot has for an estimator (``hil.devices.snapshot.Feedback`` has more)."""

    @property
    def robot_time_ns(self) -> int:
        """Robot time of the sample; does not wrap."""

    @property
    def encoder_count(self) -> Counts | None:
        """Encoder counts, or None where there are none."""

    @property
    def speed_rad_s(self) -> Wheels:
        """Wheel speeds as the firmware estimates them."""

    @property
    def yaw_rate_rad_s(self) -> float:
        """The gyro's yaw rate; NaN where there is none."""


class Estimator(Protocol):
    """Turns measurements into the state that the controller acts on."""

    def update(self, measurement: Measurement, fix: PoseFix | None) -> State | None:
        """Return the state at the newest measurement, or None while it is not known.

        ``fix`` is the newest one there is; the same measurement or fix may be given again.
        """

    def restart(self) -> None:
        """Go on with a robot that was reset: its clock and its counts began anew, the pose is the last one known."""


class TruthEstimator:
    """Takes the pose from the fixes, and the twist too where they have one.

    Else the twist is that of the wheels and the gyro. Between fixes the last one stands. A fix whose pose is
    not finite is ignored. None until there is one.
    """

    def __init__(self, model: RobotModel) -> None:
        self._model = model
        self._fix: PoseFix | None = None

    def update(self, measurement: Measurement, fix: PoseFix | None) -> State | None:
        """Return the pose of the newest fix and the twist."""
        if fix is not None and math.isfinite(sum(fix.pose)):
            self._fix = fix
        if self._fix is None:
            return None
        pose, twist = self._fix.pose, self._fix.twist
        if not math.isfinite(sum(twist)):
            twist = to_world(_body_twist(self._model, measurement), pose.heading_rad)
        return State(pose, twist)

    def restart(self) -> None:
        """Wait for a new fix."""
        self._fix = None


class OdometryEstimator:
    """Integrates the motion of the wheels from a known pose; fixes have no part in it.

    A wheel's angle comes from its encoder, counted through the wrap of 16 bits: between two measurements it
    must turn less than 32768 counts (8 revolutions at 4096 a revolution). Without counts it comes from the
    wheel's speed. The heading comes from the gyro where there is one, because rollers slip sideways first in
    a turn. The displacement is taken at the heading half way (midpoint rule).
    """

    def __init__(self, model: RobotModel, start: Pose, counts_per_revolution: int) -> None:
        if counts_per_revolution < 1:
            raise BadInputError(
                f"firmware.counts_per_revolution = {counts_per_revolution}: expected a whole number from 1 on"
            )
        self._model = model
        self._pose = start
        self._rad_per_count = math.tau / counts_per_revolution
        self._last: Measurement | None = None

    def update(self, measurement: Measurement, fix: PoseFix | None) -> State | None:
        """Return the integrated pose, and the twist of wheels and gyro. The first call is at the start."""
        last = self._last
        if last is None or measurement.robot_time_ns > last.robot_time_ns:
            if last is not None:
                self._pose = self._moved(last, measurement)
            self._last = last = measurement
        return State(self._pose, to_world(_body_twist(self._model, last), self._pose.heading_rad))

    def restart(self) -> None:
        """Count from the next measurement on; how far the wheels rolled meanwhile is not known."""
        self._last = None

    def _moved(self, last: Measurement, now: Measurement) -> Pose:
        dt_s = (now.robot_time_ns - last.robot_time_ns) * 1e-9
        forward, left, turned = body_twist(
            self._wheel_angles(last, now, dt_s), self._model.wheel_radius_m, self._model.lever_m
        )
        yaw_rate = 0.5 * (last.yaw_rate_rad_s + now.yaw_rate_rad_s)
        if not math.isnan(yaw_rate):
            turned = yaw_rate * dt_s
        x, y, heading = self._pose
        middle = heading + 0.5 * turned
        c, s = math.cos(middle), math.sin(middle)
        return Pose(x + c * forward - s * left, y + s * forward + c * left, heading + turned)

    def _wheel_angles(self, last: Measurement, now: Measurement, dt_s: float) -> Wheels:
        """Return how far each wheel turned [rad]."""
        if last.encoder_count is not None and now.encoder_count is not None:
            scale = self._rad_per_count
            return Wheels(*(scale * _forward(a, b) for a, b in zip(last.encoder_count, now.encoder_count, strict=True)))
        return Wheels(*(0.5 * (a + b) * dt_s for a, b in zip(last.speed_rad_s, now.speed_rad_s, strict=True)))


def make_estimator(source: str, model: RobotModel, start: Pose, counts_per_revolution: int) -> Estimator:
    """Return the estimator that a scenario's ``estimator.source`` names. Raises BadInputError for another."""
    if source == "truth":
        return TruthEstimator(model)
    if source == "odometry":
        return OdometryEstimator(model, start, counts_per_revolution)
    raise BadInputError(f"estimator.source = {source!r}: unknown{nearest(source, SOURCES)}")


def _body_twist(model: RobotModel, measurement: Measurement) -> BodyTwist:
    body = body_twist(measurement.speed_rad_s, model.wheel_radius_m, model.lever_m)
    yaw_rate = measurement.yaw_rate_rad_s
    return body if math.isnan(yaw_rate) else body._replace(yaw_rate_rad_s=yaw_rate)


def _forward(before: int, after: int) -> int:
    """Return the signed distance between two 16-bit counts, the shorter way around."""
    return ((after - before + 0x8000) & 0xFFFF) - 0x8000
