"""How a VESC's messages get to it: over CAN as one more node, or over the serial line of one that passes them on."""

from collections.abc import Sequence

from firmware_protocol.framing import Frame
from hil.drivers.port import EXTENDED
from hil.drivers.vesc import frames


class Bus:
    """CAN, where ``host`` is our id.

    Attributes:
        questions: to ask a VESC at the start; the values one by one, as each answer then fits into one frame.
        rounds: what to ask tick by tick: fault and status of one of them each.
    """

    def __init__(self, ids: Sequence[int], host: int) -> None:
        self._host = host
        values = [frames.values_wanted(bit) for bit in (frames.FAULT_BIT, frames.STATUS_BIT)]
        self.questions: Sequence[bytes] = (bytes((frames.FW_VERSION,)), *values)
        self.rounds: Sequence[Sequence[Frame]] = [[self.message(vesc, wanted) for wanted in values] for vesc in ids]

    def setting(self, setting: frames.Setting, vesc: int, value: float) -> Frame:
        """Return the frame of a motor's command."""
        return Frame(EXTENDED | setting.can << 8 | vesc, setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return the frame of a message of up to 6 bytes."""
        return Frame(EXTENDED | frames.CAN_SHORT << 8 | vesc, bytes((self._host, 0)) + message)


class Line:
    """A serial line to the VESC ``near``.

    Attributes:
        questions: to ask a VESC at the start.
        rounds: what to ask tick by tick: the near one, and one of those behind it, as the parts of two answers on the
            bus between them would mix.
    """

    def __init__(self, ids: Sequence[int], near: int) -> None:
        self._near = near
        wanted = frames.values_wanted(*frames.ALL_VALUES)
        self.questions: Sequence[bytes] = (bytes((frames.FW_VERSION,)), wanted)
        first = [self.message(near, wanted)] if near in ids else []
        self.rounds: Sequence[Sequence[Frame]] = [[*first, self.message(vesc, wanted)] for vesc in ids if vesc != near]

    def setting(self, setting: frames.Setting, vesc: int, value: float) -> Frame:
        """Return the message of a motor's command."""
        return self.message(vesc, bytes((setting.comm,)) + setting.counts(value))

    def message(self, vesc: int, message: bytes) -> Frame:
        """Return a message, to be passed on where it is not for the near one."""
        if vesc == self._near:
            return Frame(message[0], message[1:])
        return Frame(frames.FORWARD_CAN, bytes((vesc,)) + message)


_AROUND_BYTES = 6  # of a short packet: begin, length, code, checksum and end


def past_any_rest(commands: Sequence[Frame]) -> Sequence[Frame]:
    """Return commands of a serial line so often that the last of them are done whatever a VESC's reader waits for.

    After a byte that was lost, or that another program has sent, it may wait for the rest of the longest packet. Then
    it reads anew what it held, with commands of long ago in it, and right behind those it reads these.
    """
    size = sum(len(frame.payload) + _AROUND_BYTES for frame in commands)
    return [*commands] * (frames.LONGEST_PACKET // size + 1)
