"""Shared by the drivers and probes of four motor controllers that have ids on one bus."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from hil.core.types import NAN, WHEEL_NAMES
from hil.drivers.port import Capabilities, Driver, Found, RobotFacts, Sample, four, oldest


class Channel:
    """The newest values of one controller, NaN if not known. A maker's class adds what its messages contain.

    Attributes:
        stamp_ns: when the speed arrived; None before the first.
        speed, position: in the maker's units; ``FourMotors`` converts them.
        current_a, temperature_degc: of the motor. supply_v, supply_a: of the controller's supply.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Return to the state before the first message."""
        self.stamp_ns: int | None = None
        self.speed = self.position = 0.0
        self.current_a = self.temperature_degc = self.supply_v = self.supply_a = NAN


SettingsT = TypeVar("SettingsT")
ChannelT = TypeVar("ChannelT", bound=Channel)


class FourMotors(Driver, Generic[SettingsT, ChannelT]):
    """Drives four controllers of one maker.

    Args:
        title: what messages call a controller, before its id.
        ids, channels: of the controllers, in the order of the robot's channels.
        to_rad_s, to_rad: factors from ``Channel.speed`` and ``Channel.position`` to those of the wheel.
    """

    def __init__(
        self,
        settings: SettingsT,
        robot: RobotFacts,
        capabilities: Capabilities,
        title: str,
        ids: Sequence[int],
        channels: Iterable[ChannelT],
        to_rad_s: float,
        to_rad: float,
    ) -> None:
        self._settings, self._robot, self._capabilities = settings, robot, capabilities
        self._ids, self._channels = ids, tuple(channels)
        self._by_id = dict(zip(ids, self._channels, strict=True))
        self._to_rad_s, self._to_rad = to_rad_s, to_rad
        wheels = [WHEEL_NAMES[wheel] for wheel in robot.wheel_of_channel]
        self._names = [f"{title} {number} of wheel {wheel}" for number, wheel in zip(ids, wheels, strict=True)]

    def _with(self, flags: Iterable[bool | None]) -> str:
        """Return the ids of the channels whose flag is set, in words; empty when none is."""
        return ", ".join(str(number) for number, flag in zip(self._ids, flags, strict=True) if flag)

    @property
    def sample(self) -> Sample | None:
        channels, to_rad_s, to_rad = self._channels, self._to_rad_s, self._to_rad
        stamp_ns = oldest(channel.stamp_ns for channel in channels)
        if stamp_ns is None:
            return None
        return Sample(
            stamp_ns,
            four(channel.speed * to_rad_s for channel in channels),
            four(channel.position * to_rad for channel in channels),
            four(channel.current_a for channel in channels),
            four(channel.temperature_degc for channel in channels),
            min((channel.supply_v for channel in channels if not math.isnan(channel.supply_v)), default=NAN),
            math.fsum(channel.supply_a for channel in channels),
        )

    @property
    def errors(self) -> Sequence[str]:
        channels = zip(self._names, self._channels, strict=True)
        return [f"{name} {problem}" for name, channel in channels for problem in self._problems(channel)]

    def _problems(self, channel: ChannelT) -> Iterable[str]:
        """Return what a controller reports as wrong, in words that follow on its name."""
        raise NotImplementedError

    def restart(self) -> None:
        super().restart()
        for channel in self._channels:
            channel.forget()


def found_by_id(sentences: Mapping[int, str], unknown: Sequence[str], key: str = "ids", **more: Any) -> Found | None:
    """Return what a probe found: a sentence for each id. Four ids make a robot, with ``more`` in [device.motors]."""
    ids = sorted(sentences)
    motors = {key: ids, **more} if len(ids) == 4 else None
    return Found([sentences[number] for number in ids], motors, unknown=unknown) if ids else None
