"""The URL of a CAN bus."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hil.core.errors import BadInputError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link
from hil.wire import link
from hil.wire.link import Line, LinkUrl, Pair, check_text, closed_on_failure, port_name, unchanged

if TYPE_CHECKING:
    from hil.wire.link_statistics import Meter
    from hil.wire.robot_end import Wire

# The bus is imported only when it is opened: a machine may lack python-can.

_DEFAULT_BITRATE = 1_000_000


@dataclass(frozen=True, slots=True)
class CanUrl(LinkUrl):
    """A CAN bus with python-can's names and its bit rates [bit/s]; ``data_bitrate`` is for FD's data phase.

    Raises BadInputError when a field is out of range (ISO 11898-2: 1 Mbit/s; data phase 8 Mbit/s).
    """

    example: ClassVar[str] = link.CAN_EXAMPLE
    forms: ClassVar[Mapping[str, str]] = {
        "can:INTERFACE/CHANNEL?bitrate=1000000&fd=1&data_bitrate=4000000": "a CAN bus through python-can"
    }
    settings: ClassVar[tuple[str, ...]] = ("bitrate", "fd", "data_bitrate")

    interface: str
    channel: str
    bitrate: int = _DEFAULT_BITRATE
    fd: bool = False
    data_bitrate: int | None = None

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z0-9_.-]+", self.interface):
            raise BadInputError(
                f"{self.interface!r} is no CAN interface; write can:INTERFACE/CHANNEL, such as {self.example}"
            )
        check_text("the CAN channel", self.channel)
        link.check_range("bitrate", self.bitrate, 10_000, 1_000_000)
        if self.data_bitrate is not None:
            link.check_range("data_bitrate", self.data_bitrate, self.bitrate, 8_000_000)
            if not self.fd:
                raise BadInputError("data_bitrate is for CAN FD only; add fd=1 or remove it")

    @classmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> "CanUrl":
        interface, _, channel = address.partition("/")
        return cls(
            interface,
            link.unescape(channel),
            link.number(settings, "bitrate", _DEFAULT_BITRATE),
            link.flag(settings, "fd"),
            link.number(settings, "data_bitrate", 0) if "data_bitrate" in settings else None,
        )

    def __str__(self) -> str:
        bitrate = None if self.bitrate == _DEFAULT_BITRATE else self.bitrate
        settings = {"bitrate": bitrate, "fd": 1 if self.fd else None, "data_bitrate": self.data_bitrate}
        return link.join(f"can:{self.interface}/{link.escape(self.channel)}", settings)

    @property
    def wire(self) -> Literal["can", "can_fd"]:
        return "can_fd" if self.fd else "can"

    @property
    def is_switched(self) -> bool:
        return self.data_bitrate is not None

    @property
    def is_within_process(self) -> bool:
        return self.interface == "virtual"

    def device_name(self) -> str | None:
        if self.is_within_process:
            return None
        path = self.channel.partition("@")[0]  # the path of an adapter that is a serial port (slcan)
        return port_name(path) if Path(path).is_absolute() else f"{self.interface}/{self.channel}"

    def open_host(self, line: Line = unchanged, protocol: LinkProtocol = WHEEL_DBC) -> Link:
        from hil.wire.can_bus import CanLink

        return CanLink(self, "ROBOT", protocol)

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        from hil.wire.can_bus import CanLink
        from hil.wire.robot_end import CanWire

        host_end = self.open_host(line, protocol)
        with closed_on_failure(host_end):
            return Pair(host_end, CanWire(CanLink(self, "HOST", protocol)))

    def open_robot(
        self, say: Callable[[str], None], *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC
    ) -> tuple["Wire", str]:
        if self.is_within_process:
            return LinkUrl.open_robot(self, say, lockstep=lockstep, protocol=protocol)
        from hil.wire.can_bus import CanLink
        from hil.wire.robot_end import CanWire, ReopeningWire

        bus = CanLink(self, "HOST", protocol)
        return ReopeningWire(CanWire(bus), bus.reopen, say), str(self)

    def meter(self, link: Any) -> "Meter":
        from hil.wire.can_meter import BusMeter

        return BusMeter(self.bitrate, fd=self.fd, data_bitrate=self.data_bitrate)
