"""Faults of a link: a row with its random generator and its count, and the classes of the kinds.

A kind that only loses, doubles or replaces frames is a function, ``Kind.on_frames``. Each other kind is a class here.
"""

import math
import random
from collections.abc import Callable, Iterator
from typing import ClassVar, TypeAlias

from cobs import cobs

from firmware_protocol.framing import PACKED_HEADERS, Frame, crc16
from hil.core.clock import TICK_NS
from hil.core.link_protocol import STANDARD_IDS, WHEEL_DBC, LinkProtocol
from hil.faults.rows import FaultRow

DIRECTIONS = ("command", "feedback")

FrameEffect: TypeAlias = Callable[[str, list[Frame]], list[Frame]]
"""Takes a direction, "command" or "feedback", and a list of a frame's copies, which stays; returns what to pass on."""

# Response ids of diagnosis (ISO 15765-4): no supported motor controller listens to them. Some listen to the request
# ids, 7E0 to 7E7: 7E2 stops every ODrive on the bus.
_DIAGNOSTIC_IDS = range(0x7E8, 0x7F0)
# ISO 11898-1: bits of a classic frame with an 11-bit id, without stuff bits; increment and limit of the transmit error
# counter.
_BITS_OF_FRAME = 47
_ERROR_COUNTS = 8
_BUS_OFF = 256
_MOST_DATA = 8
_LONGEST_GARBAGE = 16
_DIRECTION_OF = {"HOST": "command", "ROBOT": "feedback"}


class LinkFault:
    """A row that acts on a link: on whole frames, unless it is a ``ByteFault``. A kind with ``Kind.on_frames`` has no
    class of its own.

    Attributes:
        cuts: whether the link is lost while it is in force.
        delays: whether it only delays frames, by ``delay_ns``.
        holds: whether it holds a frame, with the probability ``value``, until the next one has overtaken it.
        remembers: whether it remembers frames from before its window, to use them in it.
        applied: number of times that it had an effect.
        is_of_one_message: whether it acts only on frames of one message.
        header: the bytes before the payload of each frame of its message, packed; empty if it acts on all.
    """

    cuts: ClassVar[bool] = False
    delays: ClassVar[bool] = False
    holds: ClassVar[bool] = False
    remembers: ClassVar[bool] = False

    def __init__(
        self, row: FaultRow, chance: random.Random, protocol: LinkProtocol, effect: FrameEffect | None = None
    ) -> None:
        self.row = row
        self.chance = chance
        self.applied = 0
        self._protocol = protocol
        self._effect = effect
        self._direction = row.target if row.target in DIRECTIONS else None
        self._message = None if row.target in (*DIRECTIONS, "link") else row.target
        self.is_of_one_message = self._message is not None
        self.header = b""
        if self._message is not None and protocol.senders is not None:
            number = next(number for number, name in protocol.names.items() if name == self._message)
            self._direction = _DIRECTION_OF[protocol.senders[number]]
            self.header = PACKED_HEADERS[number, protocol.lengths[number]]

    def acts_on(self, direction: str) -> bool:
        """Return whether the row acts on any frame of this direction."""
        return self._direction in (None, direction)

    def concerns(self, direction: str, number: int | None) -> bool:
        """Return whether the row acts on frames of this direction and id. The id None is unknown: of no message."""
        if self._message is not None:
            return number is not None and self._protocol.names.get(number) == self._message
        return self._direction in (None, direction)

    def is_at_work(self, t_ns: int) -> bool:
        """Return whether the row has to get the frames of this time: to act on them, or to remember them."""
        return self.row.is_in_force(t_ns) or (self.remembers and t_ns < self.row.start_ns)

    def remember(self, direction: str, frame: Frame) -> None:
        """Remember a frame from before the window."""

    def changed(self, direction: str, frames: list[Frame]) -> list[Frame]:
        """Apply the row, in force, to a frame and its copies; return the frames in order, none if they are lost."""
        if self._effect is None:
            return frames
        changed = self._effect(direction, frames)
        self.applied += changed != frames
        return changed

    def delay_ns(self) -> int:
        """Return the delay of a frame by a row that ``delays``, in force: whole ticks, like robot time in lockstep."""
        raise NotImplementedError


class Delay(LinkFault):
    """The kind ``delay``."""

    delays = True

    def __init__(self, row: FaultRow, chance: random.Random, protocol: LinkProtocol) -> None:
        super().__init__(row, chance, protocol)
        self._delay_ns = -(-round(row.value * 1e9) // TICK_NS) * TICK_NS

    def delay_ns(self) -> int:
        if self._delay_ns > 0:
            self.applied += 1
        return self._delay_ns


class Jitter(LinkFault):
    """The kind ``jitter``."""

    delays = True

    def delay_ns(self) -> int:
        delay_ns = -(-round(self.row.value * self.chance.random() * 1e9) // TICK_NS) * TICK_NS
        if delay_ns > 0:
            self.applied += 1
        return delay_ns


class Reorder(LinkFault):
    """The kind ``reorder``; the direction of the link keeps what it holds (``hil.wire.direction``)."""

    holds = True


class Freeze(LinkFault):
    """The kind ``freeze``: each frame is replaced by the newest of its id from before the window."""

    remembers = True

    def __init__(self, row: FaultRow, chance: random.Random, protocol: LinkProtocol) -> None:
        super().__init__(row, chance, protocol)
        self._newest: dict[tuple[str, int], Frame] = {}

    def remember(self, direction: str, frame: Frame) -> None:
        self._newest[direction, frame.id] = frame

    def changed(self, direction: str, frames: list[Frame]) -> list[Frame]:
        old = self._newest.get((direction, frames[0].id))
        self.applied += old is not None
        return frames if old is None else [old] * len(frames)


class Disconnect(LinkFault):
    """The kind ``disconnect``."""

    cuts = True


class ErrorCounter:
    """The transmit error counter of a CAN controller, of which ``destroyed`` frames were destroyed so far."""

    def __init__(self) -> None:
        self.destroyed = 0
        self._count = 0

    def failed(self) -> bool:
        """Count a destroyed frame; return whether the controller is bus-off then. It recovers at once."""
        self.destroyed += 1
        self._count += _ERROR_COUNTS
        if self._count < _BUS_OFF:
            return False
        self._count = 0
        return True

    def succeeded(self) -> None:
        """Count a frame that arrived whole."""
        self._count = max(0, self._count - 1)


class ByteFault(LinkFault):
    """A row that acts on the wire itself: on the bytes of a serial line, or on a CAN bus as its controllers see it.
    ``is_sender``: whether it is another sender, on a bus a node of its own.
    """

    is_sender: ClassVar[bool] = False

    def on_line(self, frame: bytes) -> bytes:
        """Return the bytes of an encoded frame as they arrive over a serial line."""
        return frame

    def on_bus(self, frame: Frame, sender: ErrorCounter) -> Frame | None:
        """Return a frame as it arrives over a bus; None if its sender's controller went bus-off over it."""
        return frame

    def sent_on_line(self, t_ns: int) -> Iterator[bytes]:
        """Yield what another sender puts on a serial line by now, in the scenario's time."""
        yield from ()

    def sent_on_bus(self, t_ns: int) -> Iterator[Frame]:
        """Yield the frames of another sender on a bus by now, in the scenario's time."""
        yield from ()


class BitErrors(ByteFault):
    """The kind ``bit_errors``."""

    def on_line(self, frame: bytes) -> bytes:
        """Make each bit wrong independently of the others: gaps between wrong bits have a geometric distribution."""
        spoilt = bytearray(frame)
        scale = 1.0 / math.log1p(-self.row.value)
        place = -1
        while (place := place + 1 + int(math.log1p(-self.chance.random()) * scale)) < 8 * len(frame):
            spoilt[place // 8] ^= 1 << place % 8
        self.applied += spoilt != frame
        return bytes(spoilt)

    def on_bus(self, frame: Frame, sender: ErrorCounter) -> Frame | None:
        """Send a frame until it arrives whole."""
        whole = (1.0 - self.row.value) ** (_BITS_OF_FRAME + 8 * len(frame.payload))
        while self.chance.random() >= whole:
            self.applied += 1
            if sender.failed():
                return None
        sender.succeeded()
        return frame


class Truncation(ByteFault):
    """The kind ``truncation``."""

    def on_line(self, frame: bytes) -> bytes:
        return frame[: self.chance.randrange(1, len(frame))] if len(frame) > 1 and self._strikes() else frame

    def on_bus(self, frame: Frame, sender: ErrorCounter) -> Frame | None:
        if not frame.payload or not self._strikes():
            return frame
        return Frame(frame.id, frame.payload[: self.chance.randrange(len(frame.payload))])

    def _strikes(self) -> bool:
        if self.chance.random() >= self.row.value:
            return False
        self.applied += 1
        return True


class Babble(ByteFault):
    """The kind ``babble``."""

    is_sender = True

    def sent_on_line(self, t_ns: int) -> Iterator[bytes]:
        """Yield random bytes, and every other time a frame with a foreign id if the protocol is our own."""
        for number in self._due(t_ns):
            if number % 2 or self._protocol is not WHEEL_DBC:
                yield self.chance.randbytes(self.chance.randint(1, _LONGEST_GARBAGE))
            else:
                body = self._foreign_id().to_bytes(2, "little") + self.chance.randbytes(self.chance.randint(1, 9))
                yield cobs.encode(body + crc16(body).to_bytes(2, "little")) + b"\0"

    def sent_on_bus(self, t_ns: int) -> Iterator[Frame]:
        for _ in self._due(t_ns):
            data = self.chance.randbytes(self.chance.randint(0, _MOST_DATA))
            yield Frame(self._foreign_id(), data)

    def _due(self, t_ns: int) -> range:
        """Count what is sent now to keep the rate since the window began; return the numbers of these.

        The first of the window has number 1. After the window nothing more is sent, even if some are missing.
        """
        first, row = self.applied, self.row
        if row.is_in_force(t_ns):
            self.applied = max(first, int((t_ns - row.start_ns) * 1e-9 * row.value))
        return range(first + 1, self.applied + 1)

    def _foreign_id(self) -> int:
        if self._protocol.senders is None:
            return self.chance.choice(_DIAGNOSTIC_IDS)
        while (number := self.chance.randrange(STANDARD_IDS + 1)) in self._protocol.senders:
            pass
        return number
