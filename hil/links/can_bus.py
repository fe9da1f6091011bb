"""CAN by python-can: any of its interfaces, classic and FD."""

import errno
import time
from collections.abc import Callable
from typing import Any

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import LENGTHS
from hil.errors import BadInputError, LinkError, nearest
from hil.links.url import CanUrl, format_link
from hil.ports import Received


def _failure(url: CanUrl, error: Exception) -> LinkError:
    """Say what is the matter with an interface and what to do about it."""
    where = f"CAN interface {url.interface!r}, channel {url.channel!r}"
    number = getattr(error, "error_code", None) or getattr(error, "errno", None)
    text = str(error)
    up = f"bring it up: ip link set {url.channel} up type can bitrate {url.bitrate}"
    if number == errno.ENETDOWN or "Network is down" in text:
        return LinkError(f"{where} is down; {up}")
    if number == errno.ENODEV or "No such device" in text:
        return LinkError(f"{where} does not exist; see the interfaces with: ip -br link; then {up}")
    if number == errno.EAFNOSUPPORT or "Address family not supported" in text:
        return LinkError(f"{where}: this system's kernel has no CAN; load it with: modprobe can_raw")
    if number == errno.ENOBUFS or "No buffer space" in text:
        return LinkError(f"{where}: the transmit queue is full; nobody acknowledges, check bit rate and cable")
    return LinkError(f"{where} failed: {text}")


class CanLink:
    """Frames of our ids over a CAN bus.

    Foreign frames are dropped and counted: ``foreign`` (extended or remote), ``error_frame``, ``unknown_id``,
    ``length``. ``on_foreign``, where set, is shown each of them as a ``can.Message``.

    Raises BadInputError for an interface that python-can does not know, LinkError when it cannot be opened.
    """

    def __init__(self, url: CanUrl) -> None:
        import can

        self._can = can
        self._url = url
        self._failures = (can.CanError, OSError)
        self.on_foreign: Callable[[Any], None] | None = None
        self._rejected = {"foreign": 0, "error_frame": 0, "unknown_id": 0, "length": 0}
        if url.interface not in can.VALID_INTERFACES:
            raise BadInputError(
                f"link {format_link(url)!r}: unknown CAN interface {url.interface!r}"
                f"{nearest(url.interface, can.VALID_INTERFACES)}"
            )
        options: dict[str, Any] = {"bitrate": url.bitrate, "fd": url.fd}
        if url.data_bitrate is not None:
            options["data_bitrate"] = url.data_bitrate
        try:
            self._bus = can.Bus(interface=url.interface, channel=url.channel, **options)
        except (*self._failures, ValueError, TypeError, ImportError, NotImplementedError) as error:
            raise _failure(url, error) from error

    def send(self, frame: Frame) -> None:
        message = self._can.Message(
            arbitration_id=frame.id,
            data=frame.payload,
            is_extended_id=False,
            is_fd=self._url.fd,
            bitrate_switch=self._url.fd and self._url.data_bitrate is not None,
        )
        try:
            self._bus.send(message)
        except self._failures as error:
            raise _failure(self._url, error) from error

    def receive(self, timeout_ns: int) -> Received | None:
        deadline_ns = time.monotonic_ns() + timeout_ns if timeout_ns > 0 else 0
        while True:
            try:
                message = self._bus.recv(timeout_ns * 1e-9 if timeout_ns > 0 else 0)
            except self._failures as error:
                raise _failure(self._url, error) from error
            if message is None:
                return None
            if (cause := self._refusal(message)) is None:
                return Received(Frame(message.arbitration_id, bytes(message.data)), time.monotonic_ns())
            self._rejected[cause] += 1
            if self.on_foreign is not None:
                self.on_foreign(message)
            timeout_ns = max(0, deadline_ns - time.monotonic_ns())

    @staticmethod
    def _refusal(message: Any) -> str | None:
        if message.is_error_frame:
            return "error_frame"
        if message.is_extended_id or message.is_remote_frame:
            return "foreign"
        expected = LENGTHS.get(message.arbitration_id)
        if expected is None:
            return "unknown_id"
        return None if len(message.data) == expected else "length"

    def rejected(self) -> dict[str, int]:
        return dict(self._rejected)

    def close(self) -> None:
        self._bus.shutdown()
