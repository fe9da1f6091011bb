"""Shared by the drivers of bases that take a velocity of the body: conversions, and arming.

A base controls its wheels with the wheel radius and lever of its own firmware. The wheels reach the commanded speeds
only if these are converted to a twist with the same values. So these are used here, also where [robot] has others.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.addons.motors.driver_parts import torques_dropped
from hil.core.errors import BadInputError
from hil.core.kinematics import BodyTwist, body_twist, wheel_speeds
from hil.core.types import WHEEL_NAMES, CommandMode, FourWheels
from hil.robot.driver import Capabilities, Driver, RobotFacts, clamp

LATE_NS = 250_000_000
"""Age beyond which a report is not used; the slowest of these bases reports at 20 Hz."""

Counts = tuple[int, int, int]
"""A twist in the wire's counts of 0.001 m/s forward, 0.001 m/s left, and 0.001 rad/s."""

_STANDSTILL: Counts = (0, 0, 0)
_LEAST_GAP_NS = 4_000_000  # the makers' control loops run at 100 Hz, and a frame with its pause takes 3 ms
_STILL_RAD_S = 0.5  # one encoder count in 10 ms, which is how the makers measure a speed
_MILLI = 1000.0
_INT16 = 0x7FFF


class TwistBase(Driver):
    """Drives one base with four Mecanum wheels.

    ``rim_limit_m_s`` is the firmware's limit of a wheel's rim speed, ``yaw_limit_rad_s`` that of the yaw rate. Beyond
    them all four speeds are scaled together; the firmware would limit each alone, and so change the direction.

    Raises BadInputError if [device] sets a wiring of the wheels, which only the base knows.
    """

    def __init__(
        self,
        title: str,
        robot: RobotFacts,
        *,
        wheel_radius_m: float,
        lever_m: float,
        rim_limit_m_s: float,
        yaw_limit_rad_s: float = math.inf,
        capabilities: Capabilities,
        warnings: Sequence[str],
    ) -> None:
        wheels = [WHEEL_NAMES[wheel] for wheel in robot.wheel_of_channel]
        reversed_wheels = [wheel for wheel, sign in zip(wheels, robot.sign_of_channel, strict=True) if sign < 0]
        if wheels != list(WHEEL_NAMES) or reversed_wheels:
            raise BadInputError(
                f"device.wheels = {wheels} with device.reversed = {reversed_wheels}: {title} takes a velocity of the "
                "body and knows itself how its wheels are wired; remove both keys"
            )
        self._wheel_radius_m, self._lever_m = wheel_radius_m, lever_m
        self._rim_limit_m_s, self._yaw_limit_rad_s = rim_limit_m_s, yaw_limit_rad_s
        self._sent_ns: int | None = None
        self._capabilities = capabilities._replace(modes=frozenset({CommandMode.SPEED}), is_twist=True)
        self._warnings = (*warnings, torques_dropped(title))
        self.restart()

    # Defined by a maker's class

    @abstractmethod
    def _motion(self, counts: Counts) -> Frame:
        """Return the frame that commands a twist."""

    @property
    @abstractmethod
    def _off(self) -> str | None:
        """Why the base has switched its motors off, as an error; None while they are on."""

    def _second_stop(self) -> Frame:
        """Return a stop that is sent after the first one: the base discards a frame that the line has damaged."""
        return self._motion(_STANDSTILL)

    # As every driver

    def restart(self) -> None:
        super().restart()
        self._arming = 0

    def arm(self, now_ns: int) -> Sequence[Frame]:
        """Send stops until a fresh report says that the wheels stand still and the motors are on."""
        sample = self.sample
        is_fresh = sample is not None and now_ns - sample.stamp_ns < LATE_NS
        is_still = sample is not None and max(map(abs, sample.speed_rad_s)) < _STILL_RAD_S
        self._is_armed = self._arming > 0 and is_fresh and is_still and self._off is None
        if not self._is_due(now_ns):
            return ()
        self._arming += 1
        return (self._motion(_STANDSTILL),)

    def command(self, speed_rad_s: FourWheels, torque_n_m: FourWheels, now_ns: int) -> Sequence[Frame]:
        if not self._is_due(now_ns):
            return ()
        return (self._motion(self._counts_of(speed_rad_s) if self._is_armed else _STANDSTILL),)

    def disarm(self) -> Sequence[Frame]:
        self._is_armed = False
        return self._motion(_STANDSTILL), self._second_stop()

    @property
    def errors(self) -> Sequence[str]:
        return () if self._off is None else (self._off,)

    # Conversions

    def _counts_of(self, speed_rad_s: FourWheels) -> Counts:
        rim = self._wheel_radius_m * max(map(abs, speed_rad_s))
        twist = body_twist(speed_rad_s, self._wheel_radius_m, self._lever_m)
        scale = min(
            1.0,
            self._rim_limit_m_s / rim if rim > 0.0 else 1.0,
            self._yaw_limit_rad_s / abs(twist.yaw_rate_rad_s) if twist.yaw_rate_rad_s else 1.0,
        )
        x, y, turn = (clamp(round(scale * value * _MILLI), _INT16) for value in twist)
        return x, y, turn

    def _speeds_of(self, counts: Counts) -> FourWheels:
        twist = BodyTwist(*(count / _MILLI for count in counts))
        return wheel_speeds(twist, self._wheel_radius_m, self._lever_m)

    def _is_due(self, now_ns: int) -> bool:
        """Return whether a frame may be sent now, 4 ms after the last at the earliest; if so, count it as sent."""
        if self._sent_ns is not None and 0 <= now_ns - self._sent_ns < _LEAST_GAP_NS:
            return False
        self._sent_ns = now_ns
        return True
