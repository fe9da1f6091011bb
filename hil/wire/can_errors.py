"""Errors of a CAN bus: the causes in an error frame, and a sentence for each failure of a CAN interface.

Classes of error frames are those of SocketCAN (Linux, include/uapi/linux/can/error.h).
"""

import errno
import re
from collections.abc import Iterator

from hil.core.errors import LinkError
from hil.wire.can_url import CanUrl
from hil.wire.serial_failures import GONE, LIST_PORTS, PORT_ERRORS, is_gone, opening_problem, words_of

# Classes are bits of the identifier, details bits of data bytes.
_CLASSES = {
    0x001: "error_transmit_timeout",
    0x002: "error_arbitration",
    0x010: "error_transceiver",
    0x020: "error_acknowledgement",
    0x040: "error_bus_off",
    0x100: "error_restarted",
}
_CONTROLLER, _CONTROLLER_BYTE = 0x004, 1
_PROTOCOL, _PROTOCOL_BYTE = 0x008, 2
_BUS_ERROR = 0x080
_CONTROLLER_DETAILS = {0x03: "error_overflow", 0x0C: "error_warning", 0x30: "error_passive"}
_PROTOCOL_DETAILS = {0x19: "error_bit", 0x02: "error_form", 0x04: "error_stuff"}
BUS_OFF = "error_bus_off"
CAUSES = (*_CLASSES.values(), *_CONTROLLER_DETAILS.values(), *_PROTOCOL_DETAILS.values(), "error_other")
"""The keys under which error frames are counted."""


def causes_of(identifier: int, data: bytes) -> tuple[str, ...]:
    """Return the causes in an error frame as members of ``CAUSES``; ``error_other`` if the interface reports none."""
    found = tuple(dict.fromkeys(_causes(identifier, data.ljust(8, b"\0"))))
    return found or ("error_other",)


def _causes(identifier: int, data: bytes) -> Iterator[str]:
    for bit, cause in _CLASSES.items():
        if identifier & bit:
            yield cause
    for bit, byte, details in (
        (_CONTROLLER, _CONTROLLER_BYTE, _CONTROLLER_DETAILS),
        # The kernel's drivers set BUSERROR beside PROT. An error frame with BUSERROR alone has the details of PROT.
        (_PROTOCOL | _BUS_ERROR, _PROTOCOL_BYTE, _PROTOCOL_DETAILS),
    ):
        if identifier & bit:
            yield from (cause for mask, cause in details.items() if data[byte] & mask)


_INSTEAD = "; on Linux most adapters need none with can:socketcan/can0"
_LIBRARIES = {
    "pcan": "PEAK's PCAN-Basic library (libpcanbasic on Linux, PCANBasic.dll on Windows)" + _INSTEAD,
    "kvaser": "Kvaser's CANlib (linuxcan on Linux, the Kvaser drivers on Windows)" + _INSTEAD,
    "vector": "Vector's XL Driver Library, which exists for Windows only" + _INSTEAD,
    "ixxat": "IXXAT's VCI driver, which exists for Windows only" + _INSTEAD,
}
# Error numbers in the messages of the system and of python-can, to be removed.
_NUMBERS = re.compile(r"\[(Errno|Error Code) -?\d+\] ?")
_SERIAL_INTERFACES = ("slcan", "serial", "robotell", "seeedstudio")


def failures(*others: type[Exception]) -> tuple[type[Exception], ...]:
    """Return what python-can raises for a bus, and ``others``: its errors, those of a serial port below it, ValueError.

    It lets errors of the port pass where it sets the port's time-out, and so does whoever calls the port itself.
    """
    import can

    return (can.CanError, ValueError, *PORT_ERRORS, *others)


def failure(url: CanUrl, error: Exception) -> LinkError:
    where = f"CAN interface {url.interface!r}, channel {url.channel!r}"
    number, text = _number(error), " ".join(_NUMBERS.sub("", str(error)).split())
    if url.interface in _SERIAL_INTERFACES and "bitrate" not in text:
        return _of_serial_adapter(where, url, error)
    up = f"bring it up: ip link set {url.channel} up type can bitrate {url.bitrate}"
    if number == errno.ENETDOWN or "Network is down" in text:
        return LinkError(f"{where} is down; {up}")
    if number in (errno.ENODEV, errno.ENXIO) or "No such device" in text:
        return LinkError(f"{where} does not exist; see the interfaces with: ip -br link; then {up}")
    if number == errno.EAFNOSUPPORT or "Address family not supported" in text:
        return LinkError(f"{where}: this system's kernel has no CAN; load it with: modprobe can_raw")
    if number == errno.ENOBUFS or "No buffer space" in text or "buffer full" in text.lower():
        return LinkError(f"{where}: the transmit queue stays full; no node acknowledges, check bit rate and cable")
    if _lacks_library(error, text):
        needs = _LIBRARIES.get(url.interface, f"its manufacturer's software, which python-can asks for: {text}")
        return LinkError(f"{where} cannot be used: install {needs}")
    if "bitrate" in text:
        return LinkError(f"{where} cannot run at {url.bitrate} bit/s ({text}); set bitrate= to one of these")
    why = words_of(error)
    return LinkError(f"{where} failed ({why}); check that the adapter is plugged in and used by no other program")


def _of_serial_adapter(where: str, url: CanUrl, error: Exception) -> LinkError:
    if "Write timeout" in str(error.__cause__):
        return LinkError(f"{where} takes no bytes any more; unplug the adapter and plug it in again")
    if is_gone(error):
        return LinkError(f"{where} was lost ({GONE}); plug the adapter in again, and check its cable")
    if (problem := opening_problem(error)) is not None:
        return LinkError(f"{where} {problem}")
    return LinkError(f"{where} failed ({words_of(error)}); check that the adapter is plugged in and free; {LIST_PORTS}")


def _number(error: BaseException) -> int | None:
    cause: BaseException | None = error
    while cause is not None:
        number = getattr(cause, "error_code", None) or getattr(cause, "errno", None)
        if isinstance(number, int):
            return number
        cause = cause.__cause__
    return None


def _lacks_library(error: Exception, text: str) -> bool:
    if isinstance(error, ImportError | NameError | AttributeError | NotImplementedError):
        return True
    return any(words in text for words in ("library not found", "not installed", "msgpack", "could not be loaded"))
