"""The wiring of the wheels: which wheel each channel of the robot drives, and in which direction."""

from collections.abc import Sequence

from hil.core.types import WHEEL_NAMES, FourWheels, Wheels, make_wheels


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
            return make_wheels(value)
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
