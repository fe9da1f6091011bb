"""From a link's URL to its two ends: the host's, which is a Link, and the robot's, which is a Wire."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hil.core.errors import BadInputError
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol, Side
from hil.core.ports import Link
from hil.wire.framed import StreamLink
from hil.wire.memory_bus import memory_bus
from hil.wire.robot_end import CanWire, LossySerialWire, ReopeningWire, SerialWire, Wire
from hil.wire.streams import HostStream, memory_pair
from hil.wire.url import CanUrl, LinkUrl, MemoryUrl, SerialUrl, format_link

if TYPE_CHECKING:
    from hil.wire.can_bus import CanLink
    from hil.wire.pty import PtyStream
    from hil.wire.serial_port import SerialStream


Line = Callable[[HostStream], HostStream]
"""What a link's byte stream goes through at the host's end: faults of the line, or nothing."""


def _as_it_is(stream: HostStream) -> HostStream:
    return stream


class Pair(NamedTuple):
    """Both ends of a link in this process."""

    link: Link
    wire: Wire


def is_within_process(url: LinkUrl) -> bool:
    """Tell whether the robot is made inside this process: ``memory:``, ``serial:pty`` and ``can:virtual/...``."""
    match url:
        case MemoryUrl():
            return True
        case SerialUrl():
            return url.is_pty
        case CanUrl():
            return url.interface == "virtual"


def open_pair(url: LinkUrl, line: Line = _as_it_is, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
    """Open both ends of a link that stays within this process. Raises LinkError when that fails."""
    match url:
        case MemoryUrl():
            if protocol.make_framing is None:
                link, other = memory_bus()
                return Pair(link, CanWire(other))
            host, robot = memory_pair()
            return Pair(StreamLink(line(host), protocol), SerialWire(robot))
        case SerialUrl():
            pty = _pty_stream(url, protocol, lockstep=lockstep)
            with _closed_on_failure(pty):
                return Pair(StreamLink(line(_serial_stream(pty.port, url.baud)), protocol), LossySerialWire(pty))
        case CanUrl():
            host_end = _can_link(url, "ROBOT", protocol)
            with _closed_on_failure(host_end):
                return Pair(host_end, CanWire(_can_link(url, "HOST", protocol)))


@contextlib.contextmanager
def _closed_on_failure(end: "CanLink | PtyStream") -> Iterator[None]:
    """Close the one end of a link when the other cannot be opened."""
    with contextlib.ExitStack() as resources:
        resources.callback(end.close)
        yield
        resources.pop_all()


def open_host(url: LinkUrl, line: Line = _as_it_is, protocol: LinkProtocol = WHEEL_DBC) -> Link:
    """Open the host's end of a link to a robot elsewhere. Raises LinkError or BadInputError when that fails."""
    match url:
        case SerialUrl():
            return StreamLink(line(_serial_stream(url.port, url.baud)), protocol)
        case CanUrl():
            return _can_link(url, "ROBOT", protocol)
        case MemoryUrl():
            raise BadInputError("memory: has no other end outside this process; use serial:... or can:...")


def open_robot(
    url: LinkUrl, say: Callable[[str], None], *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC
) -> tuple[Wire, str]:
    """Open the robot's end of a link, and return it with the URL that a host uses to reach it.

    When it is lost later it is opened anew, and ``say`` gets a sentence. Raises LinkError or BadInputError.
    """
    match url:
        case SerialUrl() if url.is_pty:
            pty = _pty_stream(url, protocol, lockstep=lockstep)
            return LossySerialWire(pty), format_link(SerialUrl(url.symlink or pty.port, url.baud))
        case SerialUrl():
            stream = _serial_stream(url.port, url.baud)
            return ReopeningWire(SerialWire(stream), stream.reopen, say), format_link(url)
        case CanUrl() if url.interface != "virtual":
            bus = _can_link(url, "HOST", protocol)
            return ReopeningWire(CanWire(bus), bus.reopen, say), format_link(url)
        case _:
            raise BadInputError(
                f"{format_link(url)} does not reach another process; use --link serial:pty, serial:PATH or "
                "can:INTERFACE/CHANNEL"
            )


# The transports are imported when they are needed: a machine may have only one of them, and pseudo-terminals are
# POSIX's.


def _serial_stream(port: str, baud: int) -> "SerialStream":
    from hil.wire.serial_port import SerialStream

    return SerialStream(port, baud)


def _pty_stream(url: SerialUrl, protocol: LinkProtocol, *, lockstep: bool) -> "PtyStream":
    try:
        from hil.wire.pty import PtyStream
    except ImportError as error:
        raise BadInputError(
            "serial:pty needs a POSIX system; on Windows use memory:, or a pair of virtual COM ports"
        ) from error
    # In lockstep time stands still while bytes are on their way.
    baud = None if lockstep else url.baud
    return PtyStream(Path(url.symlink) if url.symlink else None, waits=lockstep, baud=baud, protocol=protocol)


def _can_link(url: CanUrl, hears: Side, protocol: LinkProtocol) -> "CanLink":
    from hil.wire.can_bus import CanLink

    return CanLink(url, hears, protocol)
