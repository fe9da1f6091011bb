"""The hash of a session: every frame of both directions, in order; equal on every transport when the frames are."""

import hashlib
import struct

from firmware_protocol.framing import Frame
from firmware_protocol.generated.messages import HelloRequest

_HEADER, _WIDE_HEADER = struct.Struct("<HB"), struct.Struct("<IH")
_BEYOND_ALL_IDS = 1 << 32
_AT_ONCE = 64  # frames; a call for each would cost a tick more than what it does with them


class WireHash:
    """Takes frames as they are sent and received, but HELLO: how often that is asked depends on the wall clock.

    ``wide`` is for the frames of others: ids of 32 bits, payloads of a serial line, and none of them HELLO.

    Attributes:
        sent, received: each takes a frame of its direction, which costs next to nothing; ``keep_up`` works on them.
    """

    def __init__(self, *, wide: bool = False) -> None:
        self._sent = _Way(wide)
        self._received = _Way(wide)
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

    def __init__(self, wide: bool) -> None:
        self._hash = hashlib.sha256()
        self._pack = (_WIDE_HEADER if wide else _HEADER).pack
        self._first_left_out = _BEYOND_ALL_IDS if wide else HelloRequest.ID
        self.waiting: list[Frame] = []

    def fold(self) -> None:
        pack, end = self._pack, self._first_left_out
        pieces = [pack(number, len(payload)) + payload for number, payload in self.waiting if number < end]
        self._hash.update(b"".join(pieces))
        self.waiting.clear()

    def digest(self) -> bytes:
        self.fold()
        return self._hash.digest()
