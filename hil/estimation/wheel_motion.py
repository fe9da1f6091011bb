"""The robot's motion between two measurements, by its wheels and its inertial sensors."""

import math
import operator
from typing import NamedTuple

from hil.core.errors import BadInputError
from hil.core.kinematics import body_twist
from hil.core.model import RobotModel
from hil.core.types import NAN, Wheels
from hil.estimation.measurement import Measurement

# Over a longer gap the two ends of a rate say little about the time between them, while encoders count on. No robot is
# driven on feedback this old, and the slowest base sends its own every 50 ms.
_LONGEST_S = 0.1


class Motion(NamedTuple):
    """Displacement in the body frame between two measurements, and the measures of its consistency.

    ``turned_rad`` is by the wheels, ``gyro_rad`` by the gyro. ``disagreement_m`` is how much further the front wheels
    rolled than the rear ones: four wheels with three degrees of freedom roll without slip only if it is zero. The gain
    in velocity is by the accelerometer. Values of a sensor that is missing are NaN, and so are those over a gap of
    more than 0.1 s between the measurements.
    """

    dt_s: float
    forward_m: float
    left_m: float
    turned_rad: float
    gyro_rad: float
    disagreement_m: float
    gained_forward_m_s: float
    gained_left_m_s: float

    def and_then(self, after: "Motion") -> "Motion":
        """Return both motions as one. They must be so short that the turn within them is negligible."""
        return Motion(*map(operator.add, self, after))


class MotionReader:
    """Computes the motion between measurements.

    A wheel's angle comes from its encoder, counted through the wrap of 16 bits: between two measurements it must turn
    less than 32768 counts (8 revolutions at 4096 a revolution). Without counts it comes from the wheel's speed.

    Over a gap of more than 0.1 s, as after a lost link, no rate is integrated: the robot may have stopped just after
    the first measurement. Gyro and accelerometer then give NaN, and a speed counts for at most 0.1 s.

    ``count_m`` is how far a rim moves in one count. Raises BadInputError for less than one count per revolution.
    """

    def __init__(self, model: RobotModel, counts_per_revolution: int) -> None:
        if counts_per_revolution < 1:
            raise BadInputError(
                f"firmware.counts_per_revolution = {counts_per_revolution}: expected a whole number of at least 1"
            )
        self._model = model
        self._rad_per_count = math.tau / counts_per_revolution
        self.count_m = self._rad_per_count * model.wheel_radius_m

    def between(self, last: Measurement, now: Measurement) -> Motion:
        """Return the motion from one measurement to a later one."""
        dt_s = (now.robot_time_ns - last.robot_time_ns) * 1e-9
        angles = self._wheel_angles(last, now, dt_s)
        radius_m = self._model.wheel_radius_m
        forward, left, turned = body_twist(angles, radius_m, self._model.lever_m)
        fl, fr, rr, rl = angles
        # For means over the two intervals this is the difference of the wheels' mean velocities.
        before, after = last.acceleration_m_s2, now.acceleration_m_s2
        rate_s = NAN if dt_s > _LONGEST_S else dt_s
        return Motion(
            dt_s,
            forward,
            left,
            turned,
            0.5 * (last.yaw_rate_rad_s + now.yaw_rate_rad_s) * rate_s,
            0.25 * radius_m * (fl + fr - rr - rl),
            0.5 * (before[0] + after[0]) * rate_s,
            0.5 * (before[1] + after[1]) * rate_s,
        )

    def _wheel_angles(self, last: Measurement, now: Measurement, dt_s: float) -> Wheels:
        """Return how far each wheel turned [rad]."""
        if last.encoder_count is not None and now.encoder_count is not None:
            scale = self._rad_per_count
            a, b, c, d = last.encoder_count
            e, f, g, h = now.encoder_count
            # The signed distance between two 16-bit counts, the shorter way around.
            return Wheels(
                scale * ((((e - a) & 0xFFFF) ^ 0x8000) - 0x8000),
                scale * ((((f - b) & 0xFFFF) ^ 0x8000) - 0x8000),
                scale * ((((g - c) & 0xFFFF) ^ 0x8000) - 0x8000),
                scale * ((((h - d) & 0xFFFF) ^ 0x8000) - 0x8000),
            )
        at_s = min(dt_s, _LONGEST_S)
        return Wheels(*(0.5 * (a + b) * at_s for a, b in zip(last.speed_rad_s, now.speed_rad_s, strict=True)))
