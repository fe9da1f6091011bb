"""Where the robot is by its wheels and its gyro alone."""

import math

from hil.errors import BadInputError
from hil.estimator.measurement import Measurement, measured_twist
from hil.kinematics import body_twist, to_world
from hil.model import RobotModel
from hil.types import Pose, PoseFix, State, Wheels


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
        return State(self._pose, to_world(measured_twist(self._model, last), self._pose.heading_rad))

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


def _forward(before: int, after: int) -> int:
    """Return the signed distance between two 16-bit counts, the shorter way around."""
    return ((after - before + 0x8000) & 0xFFFF) - 0x8000
