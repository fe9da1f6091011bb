"""The hash of a session: every frame of both directions, in order; equal on every transport when the frames are."""

import hashlib
import struct

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import HelloRequest

_HEADER = struct.Struct("<HB")


class WireHash:
    """Takes frames as they are sent and received, but HELLO: how often that is asked depends on the wall clock."""

    def __init__(self) -> None:
        self._sent = hashlib.sha256()
        self._received = hashlib.sha256()

    def sent(self, frame: Frame) -> None:
        """Take a frame that was sent."""
        _take(self._sent, frame)

    def received(self, frame: Frame) -> None:
        """Take a frame that was received."""
        _take(self._received, frame)

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return hashlib.sha256(self._sent.digest() + self._received.digest()).hexdigest()


def _take(digest: "hashlib._Hash", frame: Frame) -> None:
    if frame.id < HelloRequest.ID:
        digest.update(_HEADER.pack(frame.id, len(frame.payload)) + frame.payload)
