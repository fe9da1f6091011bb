"""The wiring of a robot: the wheel of each channel and its direction, its encoder, and how the IMU is mounted."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple, Self

from hil.core.types import WHEEL_NAMES, Axes, FourWheels, Wheels

IMU_AXES: Final = ("x", "y", "z")


class WheelMap:
    """A permutation with signs between our wheels (FL, FR, RR, RL) and the robot's four channels.

    ``wheels`` names the wheel on each channel; ``reversed_wheels`` the wheels that turn in the opposite direction.
    """

    def __init__(self, wheels: Sequence[str] = WHEEL_NAMES, reversed_wheels: Sequence[str] = ()) -> None:
        self.wheel_of_channel = tuple(WHEEL_NAMES.index(wheel) for wheel in wheels)
        self.sign_of_channel = tuple(-1 if wheel in reversed_wheels else 1 for wheel in wheels)
        self._channel_of_wheel = tuple(self.wheel_of_channel.index(i) for i in range(4))
        self.is_identity = self.wheel_of_channel == (0, 1, 2, 3) and not reversed_wheels

    def to_wire(self, value: Wheels) -> Wheels:
        """Return values per wheel in the order and sign of the robot's channels."""
        if self.is_identity:
            return value
        channels = zip(self.wheel_of_channel, self.sign_of_channel, strict=True)
        return Wheels(*(sign * value[wheel] for wheel, sign in channels))

    def from_wire(self, value: FourWheels) -> Wheels:
        """Return values per channel of the robot in the order and sign of our wheels."""
        if self.is_identity:
            return Wheels._make(value)
        return Wheels(*(self.sign_of_channel[c] * value[c] for c in self._channel_of_wheel))

    def counts_from_wire(self, value: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        """Return encoder counts, modulo 65536, in the order and sign of our wheels."""
        if self.is_identity:
            return value
        fl, fr, rr, rl = (self.sign_of_channel[c] * value[c] & 0xFFFF for c in self._channel_of_wheel)
        return fl, fr, rr, rl

    def temperatures_from_wire(self, value: Wheels) -> Wheels:
        """Return temperatures in the order of our wheels."""
        return Wheels(*(value[c] for c in self._channel_of_wheel))


class ImuMount:
    """How an IMU is mounted. ``axes`` has the robot's axis along each of its three: x forward, y left, z up, -x, ...

    Raises ValueError unless these are three different axes that form a right-handed frame, as every IMU does.
    """

    def __init__(self, axes: Sequence[str] = IMU_AXES) -> None:
        self.axis = tuple(IMU_AXES.index(axis[-1]) for axis in axes)
        self.sign = tuple(-1 if axis.startswith("-") else 1 for axis in axes)
        self.is_identity = tuple(axes) == IMU_AXES
        if sorted(self.axis) != [0, 1, 2]:
            raise ValueError("expected one of x, one of y and one of z, each with or without a minus")
        first, second, third = self.axis
        handed = math.prod(self.sign) * (1 if (first, second, third) in ((0, 1, 2), (1, 2, 0), (2, 0, 1)) else -1)
        if handed < 0:
            raise ValueError("this frame is left-handed, which no IMU is; expected such as ['-y', 'x', 'z']")

    def to_body(self, measured: Axes) -> Axes:
        """Return a vector along the robot's axes, of one along the IMU's."""
        body = [0.0, 0.0, 0.0]
        for axis, sign, value in zip(self.axis, self.sign, measured, strict=True):
            body[axis] = sign * value
        return body[0], body[1], body[2]

    def yaw_rate(self, measured_rad_s: float) -> float:
        """Return the robot's yaw rate, of the rate about the IMU's third axis; NaN where that axis is not upright."""
        return self.sign[2] * measured_rad_s if self.axis[2] == 2 else math.nan


class Wiring(NamedTuple):
    """How a robot is wired: the wheels of its motors, the encoder at each input, and the IMU.

    ``encoder_wheels`` names the wheel that each encoder input counts; ``reversed_encoders`` the wheels whose encoder
    counts against its motor.
    """

    motors: WheelMap
    encoder_wheels: tuple[str, ...]
    reversed_encoders: tuple[str, ...]
    imu: ImuMount

    @classmethod
    def of(cls, motors: WheelMap, imu: ImuMount | None = None) -> Self:
        """Return a wiring in which each channel counts its own wheel, in the direction of the motor."""
        wheels = tuple(WHEEL_NAMES[wheel] for wheel in motors.wheel_of_channel)
        return cls(motors, wheels, (), imu or ImuMount())

    @property
    def encoder_channels(self) -> tuple[int, ...]:
        """For each encoder input the channel whose motor turns the counted wheel."""
        return tuple(self.motors.wheel_of_channel.index(WHEEL_NAMES.index(wheel)) for wheel in self.encoder_wheels)

    @property
    def encoder_signs(self) -> tuple[int, ...]:
        """For each encoder input -1 where it counts against the motor of its wheel, else 1."""
        return tuple(-1 if wheel in self.reversed_encoders else 1 for wheel in self.encoder_wheels)
