"""An open CAN bus. It receives messages as ``raw`` objects, and converts them to frames or ``can.Message`` on request.

Errors are raised as python-can raises them; ``CanLink`` explains them. ``SocketCan`` uses the socket itself: one system
call per frame, where python-can makes six.
"""

import contextlib
import errno
import select
import socket
import struct
import time
from typing import Any

from firmware_protocol.framing import Frame
from hil.core.ports import EXTENDED, REMOTE
from hil.wire.can_errors import failures
from hil.wire.url import CanUrl

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
        """Send a frame."""
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
        """Return the raw message as a ``can.Message``."""
        return raw


class SocketCan:
    """The raw socket of python-can's socketcan bus, with the methods of ``PythonCan``; the bus opens and closes it."""

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
