"""Serial ports by pyserial: device files, COM ports and pyserial's own URLs (``socket://``, ``rfc2217://``)."""

import errno
import select
from typing import Any

import serial

from hil.errors import LinkError

_CHUNK = 65536
_WRITE_TIMEOUT_S = 1.0  # a line that takes no byte for so long is lost


def _open_failure(port: str, error: Exception) -> LinkError:
    """Say what is the matter with a port and what to do about it."""
    number = getattr(error, "errno", None)
    text = str(error)
    if number == errno.ENOENT or ("could not open port" in text and "FileNotFoundError" in text):
        return LinkError(f"serial port {port!r} does not exist; list the ports with: python -m serial.tools.list_ports")
    if number == errno.EACCES or "PermissionError" in text:
        return LinkError(
            f"serial port {port!r} may not be opened (permission denied); on Linux add yourself to its group, "
            "mostly dialout, and log in again; on Windows another program may hold it"
        )
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK) or "exclusively lock" in text:
        return LinkError(f"serial port {port!r} is busy: another program holds it; close that program")
    if number == errno.ENOTTY or "Could not configure port" in text:
        return LinkError(f"{port!r} is not a serial port ({text}); expected a device such as /dev/ttyACM0 or COM3")
    return LinkError(f"serial port {port!r} could not be opened: {text}")


class SerialStream:
    """A serial port as a byte stream, opened exclusively.

    Raises LinkError when the port does not exist, is busy, is forbidden or is no serial port.
    """

    def __init__(self, port: str, baud: int) -> None:
        self._name = port
        try:
            self._port: Any = serial.serial_for_url(
                port, baudrate=baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S, do_not_open=True
            )
            if "://" not in port:
                self._port.exclusive = True
            self._port.open()
            # What was sent before we listened is not meant for us.
            self._port.reset_input_buffer()
        except (serial.SerialException, OSError, ValueError) as error:
            raise _open_failure(port, error) from error
        self._selectable = self._has_descriptor()

    def _has_descriptor(self) -> bool:
        try:
            select.select([self._port.fileno()], [], [], 0)
        except (AttributeError, OSError, ValueError):
            return False  # Windows, and URLs that are no file: pyserial's own timeout serves there
        return True

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except (serial.SerialException, OSError) as error:
            raise self._lost(error) from error

    def read(self, timeout_ns: int) -> bytes:
        try:
            if self._selectable:
                if timeout_ns > 0:
                    select.select([self._port.fileno()], [], [], timeout_ns * 1e-9)
                return bytes(self._port.read(_CHUNK))
            return self._read_with_timeout(timeout_ns)
        except (serial.SerialException, OSError) as error:
            raise self._lost(error) from error

    def _read_with_timeout(self, timeout_ns: int) -> bytes:
        if timeout_ns <= 0:
            return bytes(self._port.read(_CHUNK))
        self._port.timeout = timeout_ns * 1e-9
        first = bytes(self._port.read(1))
        self._port.timeout = 0
        return first + bytes(self._port.read(_CHUNK)) if first else first

    def _lost(self, error: Exception) -> LinkError:
        return LinkError(f"serial port {self._name!r} was lost ({error}); check the cable and the robot's power")

    def close(self) -> None:
        self._port.close()
