"""What bases have in common that take a velocity of the body: wheel speeds to that and back, and the pace of frames.

The base closes the loops of its wheels with a wheel radius and a lever of its own firmware. A set point of the wheels
is right when it is turned into a twist with those, whatever the robot really measures: so they, and not [robot], count
where the two differ.
"""

import math

from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, body_twist, wheel_speeds
from hil.core.types import WHEEL_NAMES, FourWheels
from hil.drivers.port import RobotFacts, clamp

LATE_NS = 250_000_000
"""A report that is older says nothing about now; the slowest of these bases reports at 20 Hz."""

_LEAST_GAP_NS = 4_000_000  # the makers' control loops run at 100 Hz, and a frame with its pause takes 3 ms
_STILL_RAD_S = 0.5  # one encoder count in 10 ms, which is how the makers measure a speed
_MILLI = 1000.0
_INT16 = 0x7FFF


class TwistBase:
    """Wheel speeds [rad/s] of FL, FR, RR, RL as three counts of 0.001 m/s, 0.001 m/s and 0.001 rad/s, and back.

    ``rim_limit_m_s`` is what the firmware lets a wheel's rim do, ``yaw_limit_rad_s`` what it takes as a yaw rate:
    beyond them all four are scaled together, where the firmware would cut each by itself and turn the motion.

    Raises BadInputError for a wiring of wheels: it is the base's own.
    """

    def __init__(
        self,
        title: str,
        robot: RobotFacts,
        wheel_radius_m: float,
        lever_m: float,
        rim_limit_m_s: float,
        yaw_limit_rad_s: float = math.inf,
    ) -> None:
        if robot.wheel_of_channel != (0, 1, 2, 3) or robot.sign_of_channel != (1, 1, 1, 1):
            wheels = [WHEEL_NAMES[wheel] for wheel in robot.wheel_of_channel]
            channels = zip(wheels, robot.sign_of_channel, strict=True)
            turned = [wheel for wheel, sign in channels if sign < 0]
            raise BadInputError(
                f"device.wheels = {wheels} with device.reversed = {turned}: {title} takes a velocity of the body and "
                "knows itself how its wheels are wired; remove both keys"
            )
        self._wheel_radius_m = wheel_radius_m
        self._lever_m = lever_m
        self._rim_limit_m_s = rim_limit_m_s
        self._yaw_limit_rad_s = yaw_limit_rad_s
        self._sent_ns: int | None = None

    def counts(self, speed_rad_s: FourWheels) -> tuple[int, int, int]:
        """Return the twist of these wheel speeds in the wire's counts, within what the firmware takes."""
        rim = self._wheel_radius_m * max(map(abs, speed_rad_s))
        twist = body_twist(speed_rad_s, self._wheel_radius_m, self._lever_m)
        scale = min(
            1.0,
            self._rim_limit_m_s / rim if rim > 0.0 else 1.0,
            self._yaw_limit_rad_s / abs(twist.yaw_rate_rad_s) if twist.yaw_rate_rad_s else 1.0,
        )
        x, y, turn = (clamp(round(scale * value * _MILLI), _INT16) for value in twist)
        return x, y, turn

    def speeds(self, counts: tuple[int, int, int]) -> FourWheels:
        """Return the wheel speeds [rad/s] of a twist in the wire's counts: those without the slip between wheels."""
        x, y, turn = counts
        twist = BodyTwist(x / _MILLI, y / _MILLI, turn / _MILLI)
        return wheel_speeds(twist, self._wheel_radius_m, self._lever_m)

    def is_due(self, now_ns: int) -> bool:
        """Tell whether the line has room for a frame again, and take that room."""
        if self._sent_ns is not None and 0 <= now_ns - self._sent_ns < _LEAST_GAP_NS:
            return False
        self._sent_ns = now_ns
        return True


def is_still(speed_rad_s: FourWheels) -> bool:
    """Tell whether no wheel turns, as far as such a base can tell."""
    return max(map(abs, speed_rad_s)) < _STILL_RAD_S
