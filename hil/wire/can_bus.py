"""A CAN bus through any interface of python-can, classic or FD.

``CanLink`` is the link. An open bus below it receives messages as ``raw`` objects, and converts them to frames or
``can.Message`` on request; it raises errors as python-can does.
"""

import contextlib
import errno
import logging
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from firmware_protocol.framing import Frame
from hil.core.errors import BadInputError, LinkError, nearest
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol, Side
from hil.core.ports import EXTENDED, REMOTE, Received
from hil.wire.can_errors import BUS_OFF, CAUSES, causes_of, failure, failures
from hil.wire.can_url import CanUrl
from hil.wire.device_lock import claim_file

_QUEUE_FULL_S = 0.05  # at 1 Mbit/s and full load a queue of 100 frames is empty after 13 ms
_QUEUE_RETRY_S = 0.0005
# Interfaces with filters in the kernel or the driver, which pass error frames on. python-can would filter the others in
# Python, and drop error frames too; ``receive`` filters there at no further cost.
_FILTERING_INTERFACES = ("socketcan", "ixxat")
# Interfaces on which select is used: python-can's own wait polls (slcan), or ends early after a message that is no
# frame (both). They buffer no received frame, which select would not see.
_SELECTABLE_INTERFACES = ("slcan", "udp_multicast")
# Interfaces of text lines that python-can parses. It raises ``_NO_FRAME`` for a line that is cut or garbled.
_TEXT_INTERFACES = ("slcan",)
_NO_FRAME = (IndexError, ValueError)
_WRITE_TIMEOUT_S = 1.0  # as for a serial line: one that accepts no byte for that long is lost

# struct can_frame, struct canfd_frame and the flags of their identifier, include/uapi/linux/can.h
_CLASSIC, _FD, _HEADER = struct.Struct("=IBB2x8s"), struct.Struct("=IBB2x64s"), struct.Struct("=IBB")
_ERROR = 0x20000000
_EXTENDED_IDS, _STANDARD_IDS = 0x1FFFFFFF, 0x7FF
_SWITCHED, _ERROR_STATE, _IS_FD = 0x01, 0x02, 0x04


class PythonCan:
    """Any bus of python-can. Counts each line of text that is no frame in ``rejected``, as ``garbled``."""

    def __init__(self, can: Any, bus: Any, url: CanUrl, rejected: dict[str, int]) -> None:
        self._can = can
        self._bus = bus
        self._url = url
        self._rejected = rejected
        self._failures = failures()
        self._descriptor = self._find_descriptor()
        # Without it an adapter that accepts no more bytes would block the sender for ever.
        self._send_timeout_s = _WRITE_TIMEOUT_S if url.interface in _TEXT_INTERFACES else None

    def _find_descriptor(self) -> int | None:
        """Return the file descriptor for select; None if python-can has to wait itself."""
        if self._url.interface not in _SELECTABLE_INTERFACES:
            return None
        try:
            return int(self._bus.fileno())
        except failures(NotImplementedError):
            return None  # slcan over a URL, or on Windows

    def send(self, frame: Frame) -> None:
        message = self._can.Message(
            arbitration_id=frame.id & ~(EXTENDED | REMOTE),
            data=frame.payload,
            is_extended_id=frame.id >= EXTENDED,
            is_remote_frame=bool(frame.id & REMOTE),
            is_fd=self._url.fd,
            bitrate_switch=self._url.fd and self._url.data_bitrate is not None,
        )
        try:
            self._bus.send(message, self._send_timeout_s)
        except self._failures:
            if self._url.interface in _TEXT_INTERFACES:
                # Otherwise closing the port would wait for ever for the bytes that the adapter has not accepted.
                with contextlib.suppress(*self._failures):
                    self._bus.serialPortOrig.reset_output_buffer()
            raise

    def receive(self, timeout_ns: int) -> Any:
        """Return the next raw message, or None after the timeout; 0 never waits."""
        if self._descriptor is None:
            return self._recv(max(0, timeout_ns) * 1e-9)
        deadline_ns = time.monotonic_ns() + timeout_ns
        while select.select([self._descriptor], [], [], max(0, timeout_ns) * 1e-9)[0]:
            if (message := self._recv(0)) is not None:
                return message
            # What came was no frame, for example an adapter's reply: wait for the rest of the time.
            timeout_ns = deadline_ns - time.monotonic_ns()
        return None

    def _recv(self, timeout_s: float) -> Any:
        """Return python-can's next frame; None if there is none, or if what came was no frame."""
        try:
            return self._bus.recv(timeout_s)
        except failures(IndexError) as error:
            is_not_text = isinstance(error.__cause__, UnicodeDecodeError)
            if self._url.interface not in _TEXT_INTERFACES or not (is_not_text or isinstance(error, _NO_FRAME)):
                raise
            if is_not_text:
                self._bus.flush()  # otherwise python-can would decode the same bytes again with the next line
            self._rejected["garbled"] += 1
            return None

    def frame_of(self, raw: Any) -> Frame | None:
        """Return the raw message as a frame, its id flagged with EXTENDED and REMOTE; None for an error frame."""
        if raw.is_error_frame:
            return None
        flags = EXTENDED * raw.is_extended_id | REMOTE * raw.is_remote_frame
        return Frame(raw.arbitration_id | flags, bytes(raw.data))

    def message_of(self, raw: Any) -> Any:
        return raw


class SocketCan:
    """The raw socket of python-can's socketcan bus, with the methods of ``PythonCan``; the bus opens and closes it.

    One system call per frame, where python-can makes six.
    """

    def __init__(self, can: Any, bus: Any, url: CanUrl) -> None:
        self._can = can
        self._socket: socket.socket = bus.socket
        self._layout = _FD if url.fd else _CLASSIC
        self._flags = (_IS_FD | _SWITCHED if url.data_bitrate is not None else _IS_FD) if url.fd else 0

    def send(self, frame: Frame) -> None:
        data = self._layout.pack(frame.id, len(frame.payload), self._flags, frame.payload)
        try:
            self._socket.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError as error:  # the socket's own queue is full, not the interface's
            raise OSError(errno.ENOBUFS, "No buffer space available") from error

    def receive(self, timeout_ns: int) -> bytes | None:
        if timeout_ns > 0 and not select.select([self._socket], [], [], timeout_ns * 1e-9)[0]:
            return None
        try:
            return self._socket.recv(_FD.size, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return None

    def frame_of(self, raw: bytes) -> Frame | None:
        number, length, _ = _HEADER.unpack_from(raw)
        if number & _ERROR:
            return None
        return Frame(number, b"" if number & REMOTE else raw[8 : 8 + length])

    def message_of(self, raw: bytes) -> Any:
        number, length, flags = _HEADER.unpack_from(raw)
        is_fd = len(raw) == _FD.size
        is_extended, is_remote = bool(number & EXTENDED), bool(number & REMOTE)
        return self._can.Message(
            arbitration_id=number & (_EXTENDED_IDS if is_extended else _STANDARD_IDS),
            is_extended_id=is_extended,
            is_remote_frame=is_remote,
            is_error_frame=bool(number & _ERROR),
            is_fd=is_fd,
            bitrate_switch=is_fd and bool(flags & _SWITCHED),
            error_state_indicator=is_fd and bool(flags & _ERROR_STATE),
            dlc=length,
            data=None if is_remote else raw[8 : 8 + length],
        )


class CanLink:
    """Frames over a CAN bus. ``sender`` is the remote side, whose frames are received; this end is the other.

    Frames that are not of the ``protocol`` are dropped. Counts are ``foreign`` (in this project's protocol: extended
    or remote), ``garbled`` (an slcan line that is no frame), and error frames by their class. A host also counts
    ``unknown_id`` and ``length``; a robot's firmware counts the wrong frames itself. This side's own messages, which
    some buses echo without a mark, are dropped and not counted. After a bus-off the link is lost and must be reopened.
    While a bus is open, a host in another process, of whichever user, is refused it, where the interface has a file to
    lock (socketcan, slcan).

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
            filters = [{"can_id": number, "can_mask": _STANDARD_IDS, "extended": False} for number in accepted_ids]
            yield "can_filters", filters
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
