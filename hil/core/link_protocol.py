"""The part of a protocol that a link needs: framing, names and lengths of messages, and the sender of each."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal, NamedTuple

from firmware_protocol.built import BuildError
from firmware_protocol.generated.messages import LENGTHS, NAMES, SENDERS
from firmware_protocol.host_line import HostLine
from hil.core.errors import BadInputError
from hil.core.ports import Framing

STANDARD_IDS = 0x7FF
_NOTHING: Mapping[int, str] = MappingProxyType({})
_NO_LENGTHS: Mapping[int, int] = MappingProxyType({})
_BEYOND_ALL_IDS = 1 << 32

Side = Literal["HOST", "ROBOT"]


class LinkProtocol(NamedTuple):
    """The protocol of both sides of a link.

    Attributes:
        make_framing: makes the framing for a byte stream (serial, TCP); None for a protocol that only CAN buses carry.
        names: name of each message, by id.
        senders: the side that sends each id; None where either side may send any id.
        lengths: payload length of each message [bytes], by id.
        exempt_from: frames with this id or a higher one carry no control data (STEP, for example). They are exempt from
            injected faults and latency.
        delimiter: the last byte of each frame on a byte stream; None where each write is one frame.
    """

    make_framing: Callable[[], Framing] | None = None
    names: Mapping[int, str] = _NOTHING
    senders: Mapping[int, str] | None = None
    lengths: Mapping[int, int] = _NO_LENGTHS
    exempt_from: int = _BEYOND_ALL_IDS
    delimiter: bytes | None = None

    def refusal(self, number: int, length: int, sender: Side) -> str | None:
        """Return why a received CAN frame is dropped; None if it is accepted. ``sender`` is the side that sends to us.

        ``foreign``: a 29-bit id or a remote frame. ``own``: an id that only the receiving side sends. ``unknown_id``
        and ``length`` are checked for frames of the robot only: the firmware checks those of the host.
        """
        if self.senders is None:
            return None
        if number > STANDARD_IDS:
            return "foreign"
        if self.senders.get(number, sender) != sender:
            return "own"
        if sender == "HOST":
            return None
        expected = self.lengths.get(number)
        if expected is None:
            return "unknown_id"
        return None if length == expected else "length"

    def whole(self, data: bytes) -> int:
        """Return the length of the whole frames at the start of ``data`` [bytes]."""
        return len(data) if self.delimiter is None else data.rfind(self.delimiter) + len(self.delimiter)

    def pieces(self, data: bytes) -> list[bytes]:
        """Split ``data``, which must be whole frames, into one item per frame."""
        if self.delimiter is None:
            return [data] if data else []
        return [piece + self.delimiter for piece in data.split(self.delimiter)[:-1]]


def _wheel_framing() -> Framing:
    """Return the framing of our own protocol. Raises BadInputError when the host library cannot be built or loaded."""
    try:
        return HostLine()
    except BuildError as error:
        raise BadInputError(str(error)) from error


WHEEL_DBC = LinkProtocol(_wheel_framing, NAMES, SENDERS, LENGTHS, 0x300, b"\0")
"""Our own protocol. STEP, STEP_DONE and the HELLO pages carry no control data."""
