"""Shared by the bases that take a velocity of the body: conversion of wheel speeds and back, and the pace of frames.

The base controls its wheels with the wheel radius and lever of its own firmware. Set points of the wheels are reached
only if they are converted to a twist with these values, so that they are used here where [robot] differs.
"""

import math

from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, body_twist, wheel_speeds
from hil.core.types import WHEEL_NAMES, FourWheels
from hil.drivers.port import RobotFacts, clamp

LATE_NS = 250_000_000
"""Age beyond which a report is not used; the slowest of these bases reports at 20 Hz."""

_LEAST_GAP_NS = 4_000_000  # the makers' control loops run at 100 Hz, and a frame with its pause takes 3 ms
_STILL_RAD_S = 0.5  # one encoder count in 10 ms, which is how the makers measure a speed
_MILLI = 1000.0
_INT16 = 0x7FFF


class TwistBase:
    """Wheel speeds [rad/s] of FL, FR, RR, RL as three counts of 0.001 m/s, 0.001 m/s and 0.001 rad/s, and back.

    ``rim_limit_m_s`` is the firmware's limit of a wheel's rim speed, ``yaw_limit_rad_s`` that of the yaw rate. Beyond
    them all four speeds are scaled together; the firmware would limit each alone, and so change the direction.

    Raises BadInputError if [device] sets a wiring of the wheels, which only the base knows.
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
        """Return the twist of these wheel speeds in the wire's counts, within the firmware's limits."""
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
        """Return the wheel speeds [rad/s] of a twist in the wire's counts, without slip."""
        x, y, turn = counts
        twist = BodyTwist(x / _MILLI, y / _MILLI, turn / _MILLI)
        return wheel_speeds(twist, self._wheel_radius_m, self._lever_m)

    def is_due(self, now_ns: int) -> bool:
        """Return whether a frame may be sent now, 4 ms after the last at the earliest; if so, count it as sent."""
        if self._sent_ns is not None and 0 <= now_ns - self._sent_ns < _LEAST_GAP_NS:
            return False
        self._sent_ns = now_ns
        return True


def is_still(speed_rad_s: FourWheels) -> bool:
    """Return whether no wheel turns, at the resolution of such a base."""
    return max(map(abs, speed_rad_s)) < _STILL_RAD_S
