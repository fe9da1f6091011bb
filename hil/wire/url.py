"""The table of link kinds, and the three that are shipped. Parsing a URL gives a frozen value and opens nothing.

    memory:                                       both sides in one process
    serial:PATH?baud=921600                       PATH is any port name or URL that pyserial takes
    serial:pty?symlink=PATH                       makes a pseudo-terminal, with a fixed name if one is given
    can:INTERFACE/CHANNEL?bitrate=1000000&fd=1    an interface and a channel of python-can

The address ends at the first ``?``, and the CAN interface at the first ``/``. Every later slash belongs to the channel;
it may be written as %2F too. ``%XX`` stands for one byte of UTF-8 in an address and in a value. So ``?`` is written
%3F, ``%`` is written %25 and, in a value, ``&`` is written %26.
"""

import os
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from hil.core.errors import BadInputError, nearest
from hil.core.extensions import Extensions
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link
from hil.wire import link
from hil.wire.link import Line, LinkUrl, Pair, closed_on_failure, unchanged

if TYPE_CHECKING:
    from hil.wire.meters import Meter
    from hil.wire.pty import PtyStream
    from hil.wire.robot_end import Wire

# Transports are imported only when opened: a machine may lack some of their packages, and pseudo-terminals need POSIX.

_PSEUDO_TERMINAL = "pty"
DEFAULT_BAUD = 921_600
"""Bit rate of the serial line of this project's firmware."""
_DEFAULT_BITRATE = 1_000_000


@dataclass(frozen=True, slots=True)
class MemoryUrl(LinkUrl):
    """Both sides in one process."""

    example: ClassVar[str] = "memory:"
    forms: ClassVar[Mapping[str, str]] = {
        "memory:": "both sides in one process; the bytes are the same as on a serial line"
    }
    wire = None
    is_within_process = True
    is_direct = True

    @classmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> "MemoryUrl":
        if address:
            raise BadInputError("memory: takes no address; write memory:")
        return cls()

    def __str__(self) -> str:
        return "memory:"

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        from hil.wire.framed import StreamLink
        from hil.wire.robot_end import CanWire, SerialWire
        from hil.wire.streams import memory_bus, memory_pair

        if protocol.make_framing is None:
            bus, other = memory_bus()
            return Pair(bus, CanWire(other))
        host, robot = memory_pair()
        return Pair(StreamLink(line(host), protocol), SerialWire(robot))


@dataclass(frozen=True, slots=True)
class SerialUrl(LinkUrl):
    """A serial line: pyserial's name or URL of the port, and its speed [baud].

    The port ``pty`` makes a new pseudo-terminal; ``symlink`` gives it a fixed name. Raises BadInputError for a field
    out of range.
    """

    example: ClassVar[str] = "serial:/dev/ttyACM0"
    forms: ClassVar[Mapping[str, str]] = {
        "serial:PATH?baud=921600": "a serial port by name, or a URL of pyserial such as socket://127.0.0.1:5000",
        "serial:pty?symlink=PATH": "a new pseudo-terminal; symlink gives it a fixed name",
    }
    settings: ClassVar[tuple[str, ...]] = ("baud", "symlink")

    port: str
    baud: int = DEFAULT_BAUD
    symlink: str | None = None

    def __post_init__(self) -> None:
        _check_text("the port", self.port)
        link.check_range("baud", self.baud, 1_200, 12_000_000)
        if self.symlink is not None:
            _check_text("symlink", self.symlink)
            if not self.is_within_process:
                raise BadInputError("symlink belongs to serial:pty only; remove it, or write serial:pty")

    @classmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> "SerialUrl":
        return cls(link.unescape(address), link.number(settings, "baud", baud), settings.get("symlink"))

    def __str__(self) -> str:
        baud = None if self.baud == DEFAULT_BAUD else self.baud
        return link.join(f"serial:{link.escape(self.port)}", {"baud": baud, "symlink": self.symlink})

    @property
    def is_within_process(self) -> bool:
        return self.port == _PSEUDO_TERMINAL

    @property
    def serial_port(self) -> tuple[str, int]:
        return self.port, self.baud

    def device_name(self) -> str | None:
        return None if self.is_within_process else _port_name(self.port)

    def open_host(self, line: Line = unchanged, protocol: LinkProtocol = WHEEL_DBC) -> Link:
        from hil.wire.framed import StreamLink
        from hil.wire.serial_port import SerialStream

        return StreamLink(line(SerialStream(self.port, self.baud)), protocol)

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        from hil.wire.robot_end import SerialWire

        pty = self._open_pty(protocol, lockstep=lockstep)
        with closed_on_failure(pty):
            return Pair(SerialUrl(pty.port, self.baud).open_host(line, protocol), SerialWire(pty))

    def open_robot(
        self, say: Callable[[str], None], *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC
    ) -> tuple["Wire", str]:
        from hil.wire.robot_end import ReopeningWire, SerialWire
        from hil.wire.serial_port import SerialStream

        if self.is_within_process:
            pty = self._open_pty(protocol, lockstep=lockstep)
            return SerialWire(pty), str(SerialUrl(self.symlink or pty.port, self.baud))
        stream = SerialStream(self.port, self.baud)
        return ReopeningWire(SerialWire(stream), stream.reopen, say), str(self)

    def _open_pty(self, protocol: LinkProtocol, *, lockstep: bool) -> "PtyStream":
        try:
            from hil.wire.pty import PtyStream
        except ImportError as error:
            raise BadInputError(
                "serial:pty needs a POSIX system; on Windows use memory:, or a pair of virtual COM ports"
            ) from error
        # In lockstep, time stands still while bytes are on their way.
        baud = None if lockstep else self.baud
        return PtyStream(Path(self.symlink) if self.symlink else None, waits=lockstep, baud=baud, protocol=protocol)

    def meter(self, link: Any) -> "Meter":
        from hil.wire.meters import LineMeter

        return LineMeter(link, self.baud)


@dataclass(frozen=True, slots=True)
class CanUrl(LinkUrl):
    """A CAN bus with python-can's names and its bit rates [bit/s]; ``data_bitrate`` is for FD's data phase.

    Raises BadInputError when a field is out of range (ISO 11898-2: 1 Mbit/s; data phase 8 Mbit/s).
    """

    example: ClassVar[str] = "can:socketcan/can0"
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
        _check_text("the CAN channel", self.channel)
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
        return _port_name(path) if Path(path).is_absolute() else f"{self.interface}/{self.channel}"

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
        from hil.wire.meters import BusMeter

        return BusMeter(self.bitrate, fd=self.fd, data_bitrate=self.data_bitrate)


SHIPPED: Mapping[str, type[LinkUrl]] = {"memory": MemoryUrl, "serial": SerialUrl, "can": CanUrl}
"""The shipped kinds of links by the scheme of their URLs."""
_EXTENSIONS = Extensions("hil.links", SHIPPED)


def link_forms() -> dict[str, str]:
    """Return every form of link URL with its purpose; for another package's kind, with its origin."""
    shipped = {form: meaning for kind in SHIPPED.values() for form, meaning in kind.forms.items()}
    others = {f"{scheme}:": f"from the package {package} ({line})" for scheme, package, line in _EXTENSIONS.lines()}
    return shipped | others


def parse_link(url: str, *, baud: int = DEFAULT_BAUD) -> LinkUrl:
    """Parse a link URL; ``baud`` is the speed of a serial line whose URL gives none.

    Raises BadInputError with the URL, the wrong part and the remedy.
    """
    try:
        scheme, colon, rest = url.partition(":")
        kind = SHIPPED.get(scheme) if colon else None
        if kind is None:
            kind = _kind_of_others(url, scheme, is_complete=bool(colon))
        address, settings = link.split(rest, scheme, kind.settings)
        return kind.read(address, settings, baud)
    except BadInputError as error:
        raise BadInputError(f"link {url!r}: {error}") from None


def _kind_of_others(url: str, scheme: str, *, is_complete: bool) -> type[LinkUrl]:
    """Return the kind of a URL whose scheme is not shipped. Raises BadInputError."""
    if re.match(r"/dev/|COM[0-9]|\\\\", url):
        raise BadInputError(f"the kind of link is missing; for a serial port write serial:{url}")
    known = _EXTENSIONS.names()
    if scheme not in known:
        raise BadInputError(f"unknown kind of link {scheme!r}{nearest(scheme, known)}; an example: {SerialUrl.example}")
    if not is_complete:
        example = SHIPPED[scheme].example if scheme in SHIPPED else f"{scheme}:"
        raise BadInputError(f"the colon is missing; write {example}")
    kind = _EXTENSIONS.load(scheme, f"the kind of link {scheme!r}")
    if not (isinstance(kind, type) and issubclass(kind, LinkUrl)):
        raise BadInputError(f"the kind of link {scheme!r} is {kind!r}; expected a subclass of hil.wire.link.LinkUrl")
    return kind


def _port_name(port: str) -> str:
    """Return the real path of a serial port: ``/dev/serial/by-id/...`` becomes ``/dev/ttyACM0``."""
    if "://" in port:
        return port
    if sys.platform == "win32":
        return port.upper().removeprefix("\\\\.\\")
    return os.path.realpath(port)


def _check_text(name: str, text: str) -> None:
    if not text:
        raise BadInputError(f"{name} is missing; write a link such as {SerialUrl.example} or {CanUrl.example}")
    if re.search(r"[\x00-\x1f\x7f]", text):
        raise BadInputError(f"{name} = {text!r}; remove the control character")
