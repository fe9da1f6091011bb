"""The hash of a session: every frame of both directions, in order; equal on every transport when the frames are."""

import hashlib
import struct
from collections.abc import Callable
from typing import Any

from firmware_protocol.framing import Frame

_WIDE_HEADER = struct.Struct("<IH")
_AT_ONCE = 64  # pieces; a call for each would cost a tick more than what it does with them

Pack = Callable[[list[Any]], bytes]
"""Makes bytes of what a ``WireHash`` was given."""


class WireHash:
    """Takes what is sent and received; ``pack_sent`` and ``pack_received`` make bytes of it, some at once.

    What depends on the wall clock, as how often HELLO is asked, its user leaves out.

    Attributes:
        sent, received: each takes a piece of its direction, which costs next to nothing; ``keep_up`` works on them.
    """

    def __init__(self, pack_sent: Pack, pack_received: Pack) -> None:
        self._sent = _Way(pack_sent)
        self._received = _Way(pack_received)
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


def pack_wide(frames: list[Frame]) -> bytes:
    """Return frames of others for the hash: ids of 32 bits, and payloads of a serial line."""
    pack = _WIDE_HEADER.pack
    return b"".join([pack(number, len(payload)) + payload for number, payload in frames])


class _Way:
    """What went one way."""

    def __init__(self, pack: Pack) -> None:
        self._hash = hashlib.sha256()
        self._pack = pack
        self.waiting: list[Any] = []

    def fold(self) -> None:
        self._hash.update(self._pack(self.waiting))
        self.waiting.clear()

    def digest(self) -> bytes:
        self.fold()
        return self._hash.digest()
