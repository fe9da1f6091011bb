"""What the drivers share: checks, the age of a value, packets on a serial line, and four controllers with ids."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from typing import ClassVar, Generic, TypeVar

from firmware_protocol.framing import Frame
from hil.core.types import NAN, WHEEL_NAMES
from hil.robot.driver import Capabilities, Driver, Found, Probe, RobotFacts, Sample, four


def expected_length(payload: bytes, length: int) -> str | None:
    """Return for ``Driver.feed`` that a payload has another length; None if it has this one."""
    return None if len(payload) == length else f"{len(payload)} bytes, expected {length}"


def four_ids(low: int, high: int) -> Callable[[tuple[int, ...]], tuple[int, ...]]:
    """Return a check for an option (``Annotated``): four different ids within a range."""

    def check(ids: tuple[int, ...]) -> tuple[int, ...]:
        if len(ids) != 4 or len(set(ids)) != 4 or not all(low <= number <= high for number in ids):
            raise ValueError(f"expected four different ones, each {low} to {high}")
        return ids

    return check


def oldest(stamps: Iterable[int | None]) -> int | None:
    """Return the oldest of the channels' stamps, None while one of them has none."""
    found = list(stamps)
    return None if None in found else min(stamp for stamp in found if stamp is not None)


# The age of a value. A driver has no clock: it learns the time from other frames. A value is too old when other frames
# have come for longer than ``late_ns`` since. If none come, the sample gets old, and the robot is stopped for that.


def late_ns(period_s: float) -> int:
    """Return how long a periodic value stays valid after it came: five periods, at least 0.1 s."""
    return round(max(5 * period_s, 0.1) * 1e9)


def holds_back(stamp_ns: int, other_ns: int, limit_ns: int) -> int:
    """Return the stamp of a sample that also depends on another value, which came at ``other_ns``.

    It is the speeds' stamp until the other value is older than ``limit_ns``, and constant after that. So a sample
    never goes back in time, and still gets old.
    """
    return min(stamp_ns, other_ns + limit_ns)


def torques_dropped(title: str) -> str:
    """Return the warning of a driver in mode SPEED whose controllers do not add torques."""
    return (
        f"{title} takes no torque beside a speed: the torques that a law gives ahead of the motion are dropped, and "
        "the wheels follow by their speed loops alone"
    )


# Packets on a serial line


class PacketFraming(ABC):
    """Finds packets in the bytes of a serial line. ``head`` begins each; ``longest`` is the most bytes of one.

    ``rejected`` counts bad packets by the cause, one of ``causes``, and bytes that belong to no packet (``stray``).
    """

    head: ClassVar[bytes]
    longest: ClassVar[int]
    causes: ClassVar[tuple[str, ...]]

    def __init__(self) -> None:
        self.rejected = dict.fromkeys((*self.causes, "stray"), 0)
        self._buffer = bytearray()

    @abstractmethod
    def encode(self, frame: Frame) -> bytes:
        """Return the bytes for the wire. Raises ValueError for a frame that the device does not take."""

    @abstractmethod
    def _decode(self, data: bytes) -> tuple[int, list[Frame]] | str | None:
        """Return length and frames of the packet at the start of ``data``, the cause if it is bad, None if cut off."""

    def feed(self, data: bytes) -> list[Frame]:
        """Take received bytes, in pieces of any size, and return the frames that they complete."""
        buffer = self._buffer
        buffer += data
        frames: list[Frame] = []
        at = 0
        while (begin := self._find(buffer, at)) >= 0:
            self.rejected["stray"] += begin - at
            at = begin
            packet = self._decode(bytes(buffer[begin : begin + self.longest]))
            if packet is None:
                break
            if isinstance(packet, str):
                self.rejected[packet] += 1
                at += len(self.head)  # the next packet may begin within this one
            else:
                at += packet[0]
                frames += packet[1]
        else:
            is_cut = len(self.head) > 1 and buffer[at:].endswith(self.head[:1])
            self.rejected["stray"] += len(buffer) - is_cut - at
            at = len(buffer) - is_cut
        del buffer[:at]
        return frames

    def _find(self, buffer: bytearray, at: int) -> int:
        """Return where the first packet from ``at`` on may begin; -1 for nowhere."""
        return buffer.find(self.head, at)


# Four controllers


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
        """Return the errors that a controller reports, as texts that follow its name."""
        raise NotImplementedError

    def restart(self) -> None:
        super().restart()
        for channel in self._channels:
            channel.forget()


class IdProbe(Probe):
    """Finds controllers with ids. A maker's class sets ``unknown`` and adds a sentence for each id that it finds."""

    unknown: ClassVar[Sequence[str]]

    def __init__(self) -> None:
        self._sentences: dict[int, str] = {}

    def found(self) -> Found | None:
        """Return a sentence for each id; four ids make a robot."""
        ids = sorted(self._sentences)
        motors = {"ids": ids} if len(ids) == 4 else None
        return Found([self._sentences[number] for number in ids], motors, unknown=self.unknown) if ids else None
