"""The registers of an emulated moteus, and its answers.

Source: mjbots moteus, docs/protocol/registers.md and docs/protocol/can.md.
"""

import math
from collections.abc import Mapping

from hil.drivers.moteus import frames

ID, SERIAL_NUMBER, UUID, UUID_MASK, UUID_CAPABLE = 0x110, 0x120, 0x150, 0x154, 0x158
SET_NEAREST, SET_EXACT, RECAPTURE = 0x130, 0x131, 0x133
MILLISECONDS = 0x70

_MAX_BYTES = 64  # of a CAN FD frame
NO_REGISTER, READ_ONLY, NO_MODE = 1, 2, 3

COMMAND: Mapping[int, float] = {  # the value of each register where a command does not write it
    **dict.fromkeys((0x18, 0x19, 0x1A, 0x1B, 0x1C, 0x1D, 0x1E, 0x20, 0x21, 0x22, 0x27, 0x2D, 0x40, 0x41), 0.0),
    **dict.fromkeys((0x23, 0x24, 0x2B), 1.0),
    **dict.fromkeys((0x25, 0x26, 0x28, 0x29), math.nan),
}
SHADOWS: Mapping[int, int] = {  # the same registers again, beside the bounds of "stay within"
    0x42: 0x22,
    0x43: 0x23,
    0x44: 0x24,
    0x45: 0x25,
    0x46: 0x27,
    0x47: 0x2B,
    0x48: 0x2D,
}
NOT_EMULATED = frozenset((0x10, 0x11, 0x12, 0x14, 0x15, 0x16, 0x2A, 0x2C))
"""Raw voltages of the phases and overrides of the control: a command that writes one is ignored."""

MEASURED = (0x01, 0x02, 0x03, 0x04, 0x05, 0x07, 0x0A, 0x0B, 0x0C, 0x0D, 0x0E, 0x38, 0x39, 0x3A, 0x50, 0x51)


class Answer:
    """Collects the subframes of one answer. Values of consecutive registers share one; a subframe is never cut off."""

    def __init__(self) -> None:
        self._whole = b""
        self._first, self._kind = 0, frames.INT8
        self._values: list[bytes] = []

    def add_value(self, register: int, kind: int, raw: float) -> None:
        """Add the raw value of a register."""
        if self._values and (kind != self._kind or register != self._first + len(self._values)):
            self._close()
        if not self._values:
            self._first, self._kind = register, kind
        self._values.append(frames.pack(kind, raw))

    def add_error(self, code: int, register: int, error: int) -> None:
        """Add why a register could not be written (``WRITE_ERROR``) or read (``READ_ERROR``)."""
        self.add(bytes((code,)) + frames.varuint(register) + frames.varuint(error))

    def add(self, subframe: bytes) -> None:
        """Add any subframe; it is left out if the frame has no room for it."""
        self._close()
        if len(self._whole) + len(subframe) <= _MAX_BYTES:
            self._whole += subframe

    def payload(self) -> bytes:
        """Return the payload of the answer, padded to a length that a CAN FD frame can have."""
        self._close()
        return frames.padded(self._whole)

    def _close(self) -> None:
        """Add the values that are collected, as many of them as the frame has room for."""
        values, self._values = self._values, []
        while values:
            subframe = frames.header(frames.REPLY, self._kind, self._first, len(values)) + b"".join(values)
            if len(self._whole) + len(subframe) <= _MAX_BYTES:
                self._whole += subframe
                return
            values.pop()
