"""A CAN bus through any interface of python-can, classic or FD."""

import errno
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError, LinkError, nearest
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol, Side
from hil.core.ports import Received
from hil.wire.can_errors import BUS_OFF, CAUSES, causes_of, failure, failures
from hil.wire.can_ports import PythonCan, SocketCan
from hil.wire.device_lock import claim_file
from hil.wire.url import CanUrl

_QUEUE_FULL_S = 0.05  # at 1 Mbit/s and full load a queue of 100 frames is empty after 13 ms
_QUEUE_RETRY_S = 0.0005
_MOST_FILTERS = 8
_IDENTIFIER_BITS = 11
# Interfaces with filters in the kernel or the driver, which pass error frames on. python-can would filter the others in
# Python, and drop error frames too; ``receive`` filters there at no further cost.
_FILTERING_INTERFACES = ("socketcan", "ixxat")


class CanLink:
    """Frames over a CAN bus. ``sender`` is the remote side, whose frames are received; this end is the other.

    Frames that are not of the ``protocol`` are dropped and counted: ``foreign`` (in this project's protocol: extended
    or remote), ``garbled`` (an slcan line that is no frame), error frames by their class (``error_bus_off``,
    ``error_passive``, ...) and, for a host that receives from the robot, ``unknown_id`` and ``length``. A robot
    receives all standard data frames that pass the filters, and its firmware counts the wrong ones. This side's own
    messages, which some buses echo (python-can's ``udp_multicast``, without a mark), are dropped and not counted. After
    a bus-off the link is lost and must be reopened. While a bus is open, a host in another process, of whichever user,
    is refused it, where the interface has a file to lock (socketcan, slcan).

    Raises BadInputError for an interface or option that python-can does not know, LinkError when the bus cannot be
    opened.

    Attributes:
        on_foreign: if set, is called with each counted ``can.Message``; not for ``garbled``.
        now_ns: the clock that stamps received frames.
    """

    def __init__(self, url: CanUrl, sender: Side, protocol: LinkProtocol = WHEEL_DBC) -> None:
        import can

        self._can = can
        # python-can logs a warning about optional packages that are missing. It still appears once logging is set up.
        logging.getLogger("can").addHandler(logging.NullHandler())
        self._url = url
        self._sender = sender
        self._protocol = protocol
        self._failures = failures()
        self._rejected = dict.fromkeys(("foreign", "garbled", "unknown_id", "length", *CAUSES), 0)
        self._bus: Any = None
        self._port: PythonCan | SocketCan | None = None
        self._give_back: Callable[[], None] | None = None
        self.on_foreign: Callable[[Any], None] | None = None
        self.now_ns: Callable[[], int] = time.monotonic_ns
        if url.interface not in can.VALID_INTERFACES:
            raise BadInputError(
                f"link {str(url)!r}: unknown CAN interface {url.interface!r}"
                f"{nearest(url.interface, can.VALID_INTERFACES)}"
            )
        self.reopen()

    def reopen(self) -> None:
        """Close the bus and open it again. Raises LinkError when that fails."""
        self.close()
        options = dict(self._options())
        if (file := self._file_to_claim()) is not None:
            url = self._url
            self._give_back = claim_file(file, f"CAN interface {url.interface!r}, channel {url.channel!r}")
        try:
            self._bus = self._can.Bus(interface=self._url.interface, **options)
        # NameError, AttributeError: raised by python-can itself when a vendor's library is missing.
        except failures(TypeError, ImportError, NotImplementedError, NameError, AttributeError) as error:
            self.close()
            raise failure(self._url, error) from error
        if self._url.fd and self._bus.protocol is self._can.CanProtocol.CAN_20:
            self.close()
            raise BadInputError(
                f"link {str(self._url)!r}: the interface {self._url.interface!r} has no CAN FD in python-can; "
                "remove fd=1, or use another interface"
            )
        if self._url.interface == "socketcan":
            self._port = SocketCan(self._can, self._bus, self._url)
        else:
            self._port = PythonCan(self._can, self._bus, self._url, self._rejected)

    def _file_to_claim(self) -> str | None:
        """Return the file whose lock stands for the bus; None if it has none, or if this is a robot on a shared bus."""
        url = self._url
        if url.interface == "socketcan":
            is_host = self._sender == "ROBOT"
            return f"/sys/class/net/{url.channel}/type" if is_host and "/" not in url.channel else None
        name = url.device_name()  # the path of an adapter that is a serial port
        return name if name is not None and Path(name).is_absolute() else None

    def _options(self) -> Iterator[tuple[str, Any]]:
        url = self._url
        yield "bitrate", url.bitrate
        yield "fd", url.fd
        if url.data_bitrate is not None:
            yield "data_bitrate", url.data_bitrate
        if url.interface == "virtual" and url.fd:
            yield "protocol", self._can.CanProtocol.CAN_FD
        if url.interface in _FILTERING_INTERFACES and (senders := self._protocol.senders) is not None:
            accepted_ids = [number for number, sender in senders.items() if sender == self._sender]
            filters = filters_for(accepted_ids, _MOST_FILTERS)
            yield "can_filters", [{"can_id": f.identifier, "can_mask": f.mask, "extended": False} for f in filters]
        if url.interface == "socketcand":
            yield from _socketcand(url)
        else:
            yield "channel", url.channel

    def send(self, frame: Frame) -> None:
        port, deadline = self._open_port(), 0.0
        while True:
            try:
                port.send(frame)
            except self._failures as error:
                if not _is_queue_full(error) or (deadline and time.monotonic() > deadline):
                    raise failure(self._url, error) from error
                deadline = deadline or time.monotonic() + _QUEUE_FULL_S
                time.sleep(_QUEUE_RETRY_S)
            else:
                return

    def receive(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        port, refusal = self._open_port(), self._protocol.refusal
        while True:
            try:
                raw = port.receive(timeout_ns)
            except self._failures as error:
                raise failure(self._url, error) from error
            if raw is None:
                if self._bus.state is self._can.BusState.ERROR:
                    raise self._bus_off()
                return None
            frame = port.frame_of(raw)
            cause = "foreign" if frame is None else refusal(frame.id, len(frame.payload), self._sender)
            if frame is not None and cause is None:
                return Received((frame,), self.now_ns())
            if cause in self._rejected:
                self._count(cause, port.message_of(raw))
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    def _open_port(self) -> PythonCan | SocketCan:
        if self._port is None:
            raise LinkError(f"{self.describe()}, is closed; reopen it")
        return self._port

    def _count(self, cause: str, message: Any) -> None:
        """Count a dropped frame by its cause, an error frame by its classes. Raises LinkError for a bus-off."""
        causes = causes_of(message.arbitration_id, bytes(message.data)) if message.is_error_frame else (cause,)
        if self.on_foreign is not None:
            self.on_foreign(message)
        for one in causes:
            self._rejected[one] += 1
        if BUS_OFF in causes:
            raise self._bus_off()

    def _bus_off(self) -> LinkError:
        return LinkError(
            f"CAN interface {self._url.interface!r}, channel {self._url.channel!r} is bus-off after too many errors; "
            "check the bit rate, the cable and its two terminators; Linux restarts it by itself with: "
            f"ip link set {self._url.channel} type can restart-ms 100"
        )

    def rejected(self) -> dict[str, int]:
        return dict(self._rejected)

    def describe(self) -> str:
        url = self._url
        rate = f"{url.bitrate} bit/s" + (f", data {url.data_bitrate} bit/s" if url.data_bitrate else "")
        return f"CAN{' FD' if url.fd else ''} interface {url.interface}, channel {url.channel}, {rate}"

    def close(self) -> None:
        bus, self._bus, self._port = self._bus, None, None
        give_back, self._give_back = self._give_back, None
        if bus is not None:
            try:
                bus.shutdown()
            except self._failures as error:
                # Closing an adapter that was unplugged fails; its channel is released all the same.
                logging.getLogger(__name__).info("%s: closing failed: %s", self.describe(), error)
        if give_back is not None:
            give_back()


def _is_queue_full(error: Exception) -> bool:
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    return number == errno.ENOBUFS or "buffer full" in str(error).lower() or "No buffer space" in str(error)


def _socketcand(url: CanUrl) -> Iterator[tuple[str, Any]]:
    """Yield python-can's options for a socketcand channel HOST:PORT/CHANNEL. Raises BadInputError."""
    server, _, channel = url.channel.rpartition("/")
    host, _, port = server.rpartition(":")
    if not (host and channel and port.isdecimal()):
        raise BadInputError(
            f"link {str(url)!r}: expected can:socketcand/HOST:PORT/CHANNEL, such as "
            "can:socketcand/192.168.1.10:29536/can0"
        )
    yield from (("host", host), ("port", int(port)), ("channel", channel))


class Filter(NamedTuple):
    """Passes an identifier when it equals ``identifier`` in the bits that are 1 in ``mask``."""

    identifier: int
    mask: int

    def passes(self, identifier: int) -> bool:
        """Whether a frame with the identifier passes."""
        return not (identifier ^ self.identifier) & self.mask

    def joined(self, other: "Filter") -> "Filter":
        """Return the narrowest filter that passes what either passes."""
        mask = self.mask & other.mask & ~(self.identifier ^ other.identifier)
        return Filter(self.identifier & mask, mask)

    @property
    def width(self) -> int:
        """Number of identifiers that pass."""
        return 1 << (_IDENTIFIER_BITS - self.mask.bit_count())


def filters_for(identifiers: Iterable[int], most: int) -> list[Filter]:
    """Return at most ``most`` filters that pass all of these 11-bit identifiers.

    Starts with one exact filter each. Joins the two whose union passes the fewest further identifiers, until there are
    few enough filters; then goes on as long as a union passes no further identifier.
    """
    filters = [Filter(identifier, (1 << _IDENTIFIER_BITS) - 1) for identifier in sorted(set(identifiers))]
    while len(filters) > 1:
        pairs = combinations(filters, 2)
        cost, one, other = min((one.joined(two).width - one.width - two.width, one, two) for one, two in pairs)
        if cost > 0 and len(filters) <= most:
            break
        union = one.joined(other)
        filters = sorted([union] + [f for f in filters if f.joined(union) != union])
    return filters
