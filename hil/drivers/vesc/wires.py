"""Two ways to a VESC: over CAN, or over the serial line of one VESC that forwards messages to the others."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.drivers.port import EXTENDED
from hil.drivers.vesc import frames


class Bus:
    """CAN. ``host`` is the id of this computer.

    Attributes:
        questions: messages that ask a VESC at the start, one value each, so that each answer fits into one frame.
        rounds: frames to send in turn, one item per tick: each asks one VESC for fault and status.
    """

    def __init__(self, ids: Sequence[int], host: int) -> None:
        self._host = host
        values = [frames.request_values(bit) for bit in (frames.FAULT_BIT, frames.STATUS_BIT)]
        self.questions: Sequence[bytes] = (bytes((frames.FW_VERSION,)), *values)
        self.rounds: Sequence[Sequence[Frame]] = [[self.message(vesc, request) for request in values] for vesc in ids]

    def setting(self, setting: frames.Setting, vesc: int, value: float) -> Frame:
        """Return the frame of a motor's command."""
        return Frame(EXTENDED | setting.can << 8 | vesc, setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return the frame of a message of up to 6 bytes."""
        return Frame(EXTENDED | frames.CAN_SHORT << 8 | vesc, bytes((self._host, 0)) + message)


class Line:
    """A serial line to the VESC ``near``.

    Attributes:
        questions: messages that ask a VESC at the start.
        rounds: frames to send in turn, one item per tick: each asks the near VESC and one of the others. Two answers of
            the others at once would mix on the bus between them.
    """

    def __init__(self, ids: Sequence[int], near: int) -> None:
        self._near = near
        request = frames.request_values(*frames.ALL_VALUES)
        self.questions: Sequence[bytes] = (bytes((frames.FW_VERSION,)), request)
        first = [self.message(near, request)] if near in ids else []
        self.rounds: Sequence[Sequence[Frame]] = [[*first, self.message(vesc, request)] for vesc in ids if vesc != near]

    def setting(self, setting: frames.Setting, vesc: int, value: float) -> Frame:
        """Return the message of a motor's command."""
        return self.message(vesc, bytes((setting.comm,)) + setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return the frame of a message, which the near VESC forwards if it is for another one."""
        if vesc == self._near:
            return Frame(message[0], message[1:])
        return Frame(frames.FORWARD_CAN, bytes((vesc,)) + message)


_OVERHEAD_BYTES = 6  # of a short packet: begin, length, code, checksum and end


def repeated_past_packet(commands: Sequence[Frame]) -> Sequence[Frame]:
    """Return commands for a serial line, repeated so often that they fill the longest packet.

    After a lost byte, or one that another program has sent, a VESC may wait for the rest of a packet as long as that.
    When it is complete and its checksum wrong, the VESC reads the bytes again, with old commands among them. The last
    commands that it then executes are these.
    """
    size = sum(len(frame.payload) + _OVERHEAD_BYTES for frame in commands)
    return [*commands] * (frames.LONGEST_PACKET // size + 1)
