"""The base class of all kinds of link: the URL that names a link, its properties, and how its two ends are opened.

A new kind is a frozen subclass of ``LinkUrl`` that overrides the differences from a serial line. Its entry point in the
group ``hil.links`` is named like the scheme of its URLs.
"""

import contextlib
import os
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, Protocol, Self

from hil.core.errors import BadInputError, nearest
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.core.ports import Link

if TYPE_CHECKING:
    from firmware_protocol.host_line import PackedFrames
    from hil.wire.link_statistics import Meter
    from hil.wire.robot_end import Wire
    from hil.wire.streams import HostStream

DEFAULT_BAUD = 921_600
"""Bit rate of the serial line of this project's firmware."""
EXAMPLE, CAN_EXAMPLE = "serial:/dev/ttyACM0", "can:socketcan/can0"
"""URLs of a serial line and of a CAN bus, for messages."""

Line = Callable[["HostStream"], "HostStream"]
"""Wraps a link's byte stream at the host's end with faults of the line, or returns it unchanged."""


class Pair(NamedTuple):
    """Both ends of a link in this process."""

    link: Link
    wire: "Wire"


def unchanged(stream: "HostStream") -> "HostStream":
    """Return a stream unchanged: a line without faults."""
    return stream


class DirectTransport(Protocol):
    """A link to a robot in this thread."""

    def exchange(self, ticks: int) -> "PackedFrames":
        """Send what waits in its client, and a STEP; return all that the robot then sends. Raises LinkError."""

    @property
    def crossed(self) -> Callable[[], tuple[bytes, int, bytes, int]]:
        """Returns the packed frames of the newest exchange, and their number: the client's, and the answer."""


class LinkUrl(ABC):
    """The URL of a link; each kind of link is a subclass. Making one opens nothing; ``str`` gives its shortest form.

    ``open_host`` and ``open_robot`` open a link to another process, ``open_pair`` a link within this one. They raise
    LinkError, or BadInputError when the URL asks for something that does not exist.

    Attributes:
        example: a URL, for messages.
        forms: the URLs of this kind, each with its purpose.
        settings: the names of the settings that may follow the question mark.
        wire: the medium of the frames; None if it depends on the robot's protocol.
        is_switched: whether the data of FD frames has its own bit rate.
        is_within_process: whether the robot is made inside this process.
        is_direct: whether in lockstep the host may call the robot directly, in one thread.
        serial_port: name and speed [baud] of its port, if a guardian process can open it too; else None.
    """

    example: ClassVar[str]
    forms: ClassVar[Mapping[str, str]] = {}
    settings: ClassVar[tuple[str, ...]] = ()

    @property
    def wire(self) -> Literal["serial", "can", "can_fd"] | None:
        return "serial"

    @property
    def is_switched(self) -> bool:
        return False

    @property
    def is_within_process(self) -> bool:
        return False

    @property
    def is_direct(self) -> bool:
        return False

    @property
    def serial_port(self) -> tuple[str, int] | None:
        return None

    @property
    def is_bus(self) -> bool:
        """Whether it is a CAN bus: it carries frames, not bytes, and may have other nodes than host and robot."""
        return self.wire in ("can", "can_fd")

    @classmethod
    @abstractmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> Self:
        """Return the link of a URL; ``baud`` is the speed of a line whose URL gives none. Raises BadInputError."""

    @abstractmethod
    def __str__(self) -> str: ...

    def device_name(self) -> str | None:
        """Return the device's name, the same for each spelling of the URL; None if the link makes its own device."""
        return None if self.is_within_process else str(self)

    def open_host(self, line: Line = unchanged, protocol: LinkProtocol = WHEEL_DBC) -> Link:
        """Open the host's end of a link to a robot in another process."""
        raise BadInputError(f"{self} has no other end outside this process; use serial:... or can:...")

    def open_robot(
        self, say: Callable[[str], None], *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC
    ) -> tuple["Wire", str]:
        """Open the robot's end of a link, and return it with the URL that a host uses to reach it.

        A link that is lost later is reopened; ``say`` gets one message about the loss and one when it is open again.
        """
        raise BadInputError(
            f"{self} does not reach another process; use --link serial:pty, serial:PATH or can:INTERFACE/CHANNEL"
        )

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        """Open both ends of a link that stays within this process."""
        raise BadInputError(f"{self} does not stay within this process")

    def meter(self, link: Any) -> "Meter":
        """Return the counter of traffic for a link that was opened from this URL."""
        from hil.wire.link_statistics import LineMeter

        return LineMeter(link, None)


@contextlib.contextmanager
def closed_on_failure(end: Any) -> Iterator[None]:
    """Close ``end``, one end of a link, if the body raises because the other cannot be opened."""
    with contextlib.ExitStack() as resources:
        resources.callback(end.close)
        yield
        resources.pop_all()


# The text of URLs


def number(settings: Mapping[str, str], key: str, default: int) -> int:
    """Return a setting that is a whole number. Raises BadInputError."""
    if key not in settings:
        return default
    # int() would also take "1_000", " 5" and digits of other scripts.
    if not re.fullmatch("[0-9]{1,9}", settings[key]):
        raise BadInputError(f"{key} = {settings[key]!r}; expected a whole number of at most 9 digits")
    return int(settings[key])


def flag(settings: Mapping[str, str], key: str) -> bool:
    """Return a setting that is 0 or 1, by default False. Raises BadInputError."""
    value = settings.get(key, "0")
    if value not in ("0", "1"):
        raise BadInputError(f"{key} = {value!r}; expected 0 or 1")
    return value == "1"


def check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise BadInputError(f"{name} = {value}; expected {low} to {high}")


def join(address: str, settings: Mapping[str, str | int | None]) -> str:
    """Return a URL of an escaped address and the settings that are not None."""
    given = [f"{key}={escape(str(value))}" for key, value in settings.items() if value is not None]
    return f"{address}?{'&'.join(given)}" if given else address


def split(text: str, kind: str, known: tuple[str, ...]) -> tuple[str, dict[str, str]]:
    """Split what follows the colon of a URL into the address, still escaped, and the settings. Raises BadInputError."""
    address, question_mark, query = text.partition("?")
    settings: dict[str, str] = {}
    for item in query.split("&") if question_mark else ():
        key, equals, value = item.partition("=")
        if not known:
            raise BadInputError(f"{kind}: takes no settings; write {kind}:{address}")
        if key not in known:
            raise BadInputError(f"unknown setting {key!r}{nearest(key, known)}")
        if not equals or not value:
            raise BadInputError(f"the setting {key!r} has no value; write {key}=VALUE")
        if key in settings:
            raise BadInputError(f"the setting {key!r} is given twice; keep one of them")
        settings[key] = unescape(value)
    return address, settings


def escape(text: str) -> str:
    """Return a text as it is written in an address or a value: reserved characters as %XX."""

    def percent(match: re.Match[str]) -> str:
        return "".join(f"%{byte:02X}" for byte in match.group().encode("utf-8", "surrogateescape"))

    return re.sub("[%?& \\udc80-\\udcff]", percent, text)


def unescape(text: str) -> str:
    """Decode %XX. Bytes that are not UTF-8 become surrogates, as Python keeps them in paths (PEP 383)."""
    if bad := re.search("%(?![0-9A-Fa-f]{2}).{0,2}", text):
        raise BadInputError(f"{bad.group()!r} is not an escape sequence; write a percent sign as %25")
    data = text.encode("utf-8", "surrogateescape")
    data = re.sub(rb"%(..)", lambda match: bytes.fromhex(match.group(1).decode("ascii")), data)
    return data.decode("utf-8", "surrogateescape")


def port_name(port: str) -> str:
    """Return the real path of a serial port: ``/dev/serial/by-id/...`` becomes ``/dev/ttyACM0``."""
    if "://" in port:
        return port
    if sys.platform == "win32":
        return port.upper().removeprefix("\\\\.\\")
    return os.path.realpath(port)


def check_text(name: str, text: str) -> None:
    if not text:
        raise BadInputError(f"{name} is missing; write a link such as {EXAMPLE} or {CAN_EXAMPLE}")
    if re.search(r"[\x00-\x1f\x7f]", text):
        raise BadInputError(f"{name} = {text!r}; remove the control character")
