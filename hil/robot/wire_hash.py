"""The hash of a session: all frames of each direction, in order. Equal frames give equal hashes on every transport."""

import hashlib
import struct

from firmware_protocol.framing import Frame

_HEADER = struct.Struct("<IH")  # 32-bit ids, and payloads of any length


class WireHash:
    """Hashes the frames that are sent to motor controllers of other makers, and those that are received.

    The caller leaves out frames whose number depends on the wall clock.
    """

    def __init__(self) -> None:
        self._sent, self._received = hashlib.sha256(), hashlib.sha256()

    def sent(self, frame: Frame) -> None:
        """Add a frame that was sent."""
        self._sent.update(_HEADER.pack(frame.id, len(frame.payload)) + frame.payload)

    def received(self, frame: Frame) -> None:
        """Add a frame that was received."""
        self._received.update(_HEADER.pack(frame.id, len(frame.payload)) + frame.payload)

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return hashlib.sha256(self._sent.digest() + self._received.digest()).hexdigest()
