"""Error frames: what SocketCAN's classes mean (Linux, include/uapi/linux/can/error.h). Pure."""

from collections.abc import Iterator

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
CAUSES = (
    *_CLASSES.values(),
    *_CONTROLLER_DETAILS.values(),
    *_PROTOCOL_DETAILS.values(),
    "error_other",
)
"""The keys under which error frames are counted."""


def causes_of(identifier: int, data: bytes) -> tuple[str, ...]:
    """Return what an error frame tells, at least one of ``CAUSES``; interfaces without classes give ``error_other``."""
    found = tuple(dict.fromkeys(_causes(identifier, data.ljust(8, b"\0"))))
    return found or ("error_other",)


def _causes(identifier: int, data: bytes) -> Iterator[str]:
    for bit, cause in _CLASSES.items():
        if identifier & bit:
            yield cause
    for bit, byte, details in (
        (_CONTROLLER, _CONTROLLER_BYTE, _CONTROLLER_DETAILS),
        # The kernel's drivers set BUSERROR beside PROT; alone it comes with the details of PROT.
        (_PROTOCOL | _BUS_ERROR, _PROTOCOL_BYTE, _PROTOCOL_DETAILS),
    ):
        if identifier & bit:
            yield from (cause for mask, cause in details.items() if data[byte] & mask)
