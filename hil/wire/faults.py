"""Faults of a link: the scenario's time, a row with its random generator and count, and the faults of a CAN bus."""

import random
from collections.abc import Sequence

from firmware_protocol.framing import PACKED_HEADERS, Frame
from hil.core.clock import TICK_NS
from hil.core.errors import LinkError
from hil.core.link_protocol import STANDARD_IDS, WHEEL_DBC, LinkProtocol
from hil.core.ports import Clock, Link
from hil.faults.kind import FaultRow, generators
from hil.faults.kinds import DIRECTIONS, find

BYTE_KINDS = ("bit_errors", "truncation", "babble")
"""The kinds that act on the bytes of a serial line (``line_faults``), or on a bus (``BusFaults``)."""

# Response ids of diagnosis (ISO 15765-4): no supported motor controller listens to them. Some listen to the request
# ids, 7E0 to 7E7: 7E2 stops every ODrive on the bus.
_STRANGERS = range(0x7E8, 0x7F0)
# ISO 11898-1: bits of a classic frame with an 11-bit id, without stuff bits; increment and limit of the transmit error
# counter.
_BITS_OF_FRAME = 47
_ERROR_COUNTS = 8
_BUS_OFF = 256
_MOST_DATA = 8
_DIRECTION_OF = {"HOST": "command", "ROBOT": "feedback"}


class ScenarioTime:
    """The scenario's time [ns] on a clock, from the first ACTIVE tick; it is None before ``begin``.

    Attributes:
        offset_ns: the clock's time when the scenario's is 0; 0 before ``begin``.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._origin_ns: int | None = None
        self.offset_ns = 0

    def begin(self, origin_ns: int) -> None:
        """Set the clock time at which the scenario's time began."""
        self._origin_ns = self.offset_ns = origin_ns

    def now_ns(self) -> int | None:
        """Return the scenario's time, or None before it has begun."""
        return self.at(self._clock.now_ns())

    def at(self, clock_ns: int) -> int | None:
        """Return the scenario's time at a time of the clock, or None before it has begun."""
        return None if self._origin_ns is None else clock_ns - self._origin_ns


class LinkFault:
    """A row that acts on a link, with its own random generator.

    Attributes:
        applied: number of times that it had an effect.
        delays: whether it only delays frames.
        is_of_one_message: whether it acts only on frames of one message.
        header: the bytes before the payload of each frame of its message, packed; empty if it acts on all.
    """

    def __init__(self, row: FaultRow, chance: random.Random, protocol: LinkProtocol) -> None:
        self._names = protocol.names
        self.kind = row.kind
        self.row = row
        self.chance = chance
        self.applied = 0
        self._direction = row.target if row.target in DIRECTIONS else None
        self._message = None if row.target in (*DIRECTIONS, "link") else row.target
        self.is_of_one_message = self._message is not None
        self.header = b""
        self.delays = row.kind in ("delay", "jitter")
        self._is_jitter, self._value, self._random = row.kind == "jitter", row.value, chance.random
        self._delay_ns = -(-round(row.value * 1e9) // TICK_NS) * TICK_NS if self.delays else 0
        if self._message is not None and protocol.senders is not None:
            number = next(number for number, name in protocol.names.items() if name == self._message)
            self._direction = _DIRECTION_OF[protocol.senders[number]]
            self.header = PACKED_HEADERS[number, protocol.lengths[number]]
        make = find(row.kind, row.target).on_frames
        self._effect = None if make is None else make(row, chance)
        self._newest: dict[tuple[str, int], Frame] = {}  # frames that freeze repeats, by direction and id

    def concerns(self, direction: str, number: int | None) -> bool:
        """Whether the row acts on frames of this direction and id. The id None is unknown, and of no message."""
        if self._message is not None:
            return number is not None and self._names.get(number) == self._message
        return self._direction in (None, direction)

    def is_at_work(self, t_ns: int) -> bool:
        """Whether the row acts on frames at this time, or takes note of them; ``freeze`` does so before its window."""
        return self.row.is_in_force(t_ns) or (self.kind == "freeze" and t_ns < self.row.start_ns)

    def acts_on(self, direction: str) -> bool:
        """Whether the row acts on any frame of this direction."""
        return self._direction in (None, direction)

    def strikes(self) -> bool:
        """Decide at random whether a frame is hit, and count it."""
        if self.chance.random() >= self.row.value:
            return False
        self.applied += 1
        return True

    def note(self, direction: str, frame: Frame) -> None:
        """Keep the newest frame of its id before the window, which ``freeze`` then repeats."""
        self._newest[direction, frame.id] = frame

    def changed(self, direction: str, frames: list[Frame]) -> list[Frame]:
        """Apply the row, in force, to a frame and its copies; return the frames in order, none if they are lost."""
        if self.kind == "freeze":
            old = self._newest.get((direction, frames[0].id))
            self.applied += old is not None
            return frames if old is None else [old] * len(frames)
        if self._effect is None:
            return frames
        changed = self._effect(direction, frames)
        self.applied += changed != frames
        return changed

    def delay_ns(self) -> int:
        """Return the delay of a frame by a row that ``delays``, in force: whole ticks, like robot time in lockstep."""
        delay_ns = self._delay_ns
        if self._is_jitter:
            delay_ns = -(-round(self._value * self._random() * 1e9) // TICK_NS) * TICK_NS
        if delay_ns > 0:
            self.applied += 1
        return delay_ns

    def due(self, t_ns: int) -> range:
        """Count the frames that a babble sends now to keep its rate since its window began; return their numbers.

        The first frame of the window has number 1. After the window nothing more is sent, even if frames are missing.
        """
        first, row = self.applied, self.row
        if row.is_in_force(t_ns):
            self.applied = max(first, int((t_ns - row.start_ns) * 1e-9 * row.value))
        return range(first + 1, self.applied + 1)


def link_faults(rows: Sequence[FaultRow], seed: int, protocol: LinkProtocol = WHEEL_DBC) -> list[LinkFault]:
    """Return the rows, each with a random generator and a count."""
    return [LinkFault(row, chance, protocol) for row, chance in zip(rows, generators(rows, seed), strict=True)]


def foreign_id(fault: LinkFault, protocol: LinkProtocol) -> int:
    """Return an 11-bit id that the protocol does not use."""
    if protocol.senders is None:
        return fault.chance.choice(_STRANGERS)
    while (number := fault.chance.randrange(STANDARD_IDS + 1)) in protocol.senders:
        pass
    return number


class BusFaults:
    """Bit errors, truncation and babble on a CAN bus, as the bus's controllers would see them.

    A destroyed frame takes no time here; on a bus it and its error frame take some 0.15 ms at 1 Mbit/s. ``babbler`` is
    the node that babbles; None if no row needs one.

    Attributes:
        rejected: number of destroyed or cut frames, by the causes of ``Link.rejected``.
    """

    def __init__(self, faults: Sequence[LinkFault], babbler: Link | None, protocol: LinkProtocol = WHEEL_DBC) -> None:
        self._faults = [fault for fault in faults if fault.kind != "babble"]
        self._babbles = [fault for fault in faults if fault.kind == "babble"]
        self._babbler = babbler
        self._protocol = protocol
        self._errors = dict.fromkeys(DIRECTIONS, 0)  # the transmit error counter of each end
        self.rejected = {"error_bit": 0, "error_bus_off": 0, "length": 0}

    def sent(self, frame: Frame, t_ns: int) -> Frame:
        """Return a command as it arrives at the robot. Raises LinkError if it put the host's controller bus-off."""
        passed = self._passed(frame, "command", t_ns)
        if passed is None:
            self.rejected["error_bus_off"] += 1
            raise LinkError("the CAN controller is bus-off: the fault bit_errors destroyed too many frames in a row")
        return passed

    def arrives(self, frame: Frame, t_ns: int) -> bool:
        """Whether a frame of the robot arrives undamaged."""
        passed = self._passed(frame, "feedback", t_ns)
        is_short = passed is not None and len(passed.payload) < len(frame.payload)
        self.rejected["length"] += is_short
        return passed is not None and not is_short

    def babble(self, t_ns: int | None) -> None:
        """Let the babbling node send the frames that its rate demands by now, in the scenario's time."""
        if t_ns is None or self._babbler is None:
            return
        for fault in self._babbles:
            for _ in fault.due(t_ns):
                data = fault.chance.randbytes(fault.chance.randint(0, _MOST_DATA))
                self._babbler.send(Frame(foreign_id(fault, self._protocol), data))
        while self._babbler.receive(0) is not None:
            pass  # it receives every frame, and ignores them

    def reopen(self) -> None:
        """Reopen the babbling node's end of the bus."""
        if self._babbler is not None:
            self._babbler.reopen()

    def close(self) -> None:
        """Close the babbling node's end of the bus."""
        if self._babbler is not None:
            self._babbler.close()

    def _passed(self, frame: Frame, direction: str, t_ns: int) -> Frame | None:
        """Return the frame as it arrives, or None when its sender went bus-off over it."""
        for fault in self._faults:
            if not (fault.row.is_in_force(t_ns) and fault.concerns(direction, frame.id)):
                continue
            if fault.kind == "truncation":
                if frame.payload and fault.strikes():
                    frame = Frame(frame.id, frame.payload[: fault.chance.randrange(len(frame.payload))])
            elif not self._comes_through(fault, direction, len(frame.payload)):
                return None
        return frame

    def _comes_through(self, fault: LinkFault, direction: str, length: int) -> bool:
        """Send a frame until it arrives intact; return False if its sender went bus-off. Each failure is counted."""
        whole = (1.0 - fault.row.value) ** (_BITS_OF_FRAME + 8 * length)
        while fault.chance.random() >= whole:
            fault.applied += 1
            self.rejected["error_bit"] += 1
            self._errors[direction] += _ERROR_COUNTS
            if self._errors[direction] >= _BUS_OFF:
                self._errors[direction] = 0  # it recovers, but the frame is lost
                return False
        self._errors[direction] = max(0, self._errors[direction] - 1)
        return True
