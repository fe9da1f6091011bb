"""The hash of a session: every frame of both directions, in order; equal on every transport when the frames are."""

import hashlib
import struct

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import HelloRequest

_HEADER = struct.Struct("<HB")
_AT_ONCE = 64  # frames; a call for each would cost a tick more than what it does with them


class WireHash:
    """Takes frames as they are sent and received, but HELLO: how often that is asked depends on the wall clock.

    Attributes:
        sent, received: each takes a frame of its direction, which costs next to nothing; ``keep_up`` works on them.
    """

    def __init__(self) -> None:
        self._sent = _Way()
        self._received = _Way()
        self.sent = self._sent.waiting.append
        self.received = self._received.waiting.append

    def keep_up(self) -> None:
        """Hash what is waiting, if that is much; to be called now and then, as once a tick."""
        if len(self._received.waiting) >= _AT_ONCE or len(self._sent.waiting) >= _AT_ONCE:
            self._sent.fold()
            self._received.fold()

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return hashlib.sha256(self._sent.digest() + self._received.digest()).hexdigest()


class _Way:
    """The frames of one direction."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self.waiting: list[Frame] = []

    def fold(self) -> None:
        pack, first_hello = _HEADER.pack, HelloRequest.ID
        pieces = [pack(number, len(payload)) + payload for number, payload in self.waiting if number < first_hello]
        self._hash.update(b"".join(pieces))
        self.waiting.clear()

    def digest(self) -> bytes:
        self.fold()
        return self._hash.digest()
