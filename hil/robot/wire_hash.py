"""The hash of a session: all frames of each direction, in order. Equal frames give equal hashes on every transport."""

import hashlib
import struct
from collections.abc import Callable
from typing import Any

from firmware_protocol.framing import Frame

_WIDE_HEADER = struct.Struct("<IH")
_AT_ONCE = 64  # pieces; hashing each by itself would take longer per tick

Pack = Callable[[list[Any]], bytes]
"""Converts the pieces that were given to a ``WireHash`` to bytes."""


class WireHash:
    """Hashes what is sent and received; ``pack_sent`` and ``pack_received`` convert lists of pieces to bytes.

    The caller leaves out frames whose number depends on the wall clock, such as HELLO.

    Attributes:
        sent, received: add a piece of one direction. This is cheap: ``keep_up`` hashes the pieces later.
    """

    def __init__(self, pack_sent: Pack, pack_received: Pack) -> None:
        self._sent = _Way(pack_sent)
        self._received = _Way(pack_received)
        self.sent = self._sent.waiting.append
        self.received = self._received.waiting.append

    def keep_up(self) -> None:
        """Hash the waiting pieces if there are 64 or more; to be called regularly, once per tick for example."""
        if len(self._received.waiting) >= _AT_ONCE or len(self._sent.waiting) >= _AT_ONCE:
            self._sent.fold()
            self._received.fold()

    def hexdigest(self) -> str:
        """Return the hash so far."""
        return hashlib.sha256(self._sent.digest() + self._received.digest()).hexdigest()


def pack_wide(frames: list[Frame]) -> bytes:
    """Pack frames of third-party motor controllers for the hash: 32-bit ids and payloads of any length."""
    pack = _WIDE_HEADER.pack
    return b"".join([pack(number, len(payload)) + payload for number, payload in frames])


class _Way:
    """The hash of one direction."""

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
