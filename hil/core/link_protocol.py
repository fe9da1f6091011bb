"""What a link knows of the protocol on it: framing, names and lengths of messages, and which side sends each."""

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
        make_framing: makes the framing for a line of bytes; None for a protocol of buses only.
        names: of messages, by id.
        senders: the side that sends each id; None where either side may send any id.
        lengths: of the payload, by id [bytes].
        exempt_from: frames from this id on carry no control, such as STEP. Faults and latency leave them alone.
        delimiter: the last byte of each frame on a line of bytes; None where each write is one frame.
    """

    make_framing: Callable[[], Framing] | None = None
    names: Mapping[int, str] = _NOTHING
    senders: Mapping[int, str] | None = None
    lengths: Mapping[int, int] = _NO_LENGTHS
    exempt_from: int = _BEYOND_ALL_IDS
    delimiter: bytes | None = None

    def refusal(self, number: int, length: int, hears: Side) -> str | None:
        """Return why the side that ``hears`` drops a frame of a bus; None where it takes the frame.

        ``own`` stands for a frame that this side has sent itself. Frames of the host are checked by the firmware.
        """
        if self.senders is None:
            return None
        if number > STANDARD_IDS:
            return "foreign"
        if self.senders.get(number, hears) != hears:
            return "own"
        if hears == "HOST":
            return None
        expected = self.lengths.get(number)
        if expected is None:
            return "unknown_id"
        return None if length == expected else "length"

    def whole(self, data: bytes) -> int:
        """Return the number of bytes from the start that are whole frames."""
        return len(data) if self.delimiter is None else data.rfind(self.delimiter) + len(self.delimiter)

    def pieces(self, data: bytes) -> list[bytes]:
        """Split whole frames into single ones."""
        if self.delimiter is None:
            return [data] if data else []
        return [piece + self.delimiter for piece in data.split(self.delimiter)[:-1]]


def _wheel_framing() -> Framing:
    """Return the framing of our own protocol. Raises BadInputError where the host library cannot be loaded."""
    try:
        return HostLine()
    except BuildError as error:
        raise BadInputError(str(error)) from error


WHEEL_DBC = LinkProtocol(_wheel_framing, NAMES, SENDERS, LENGTHS, 0x300, b"\0")
"""Our own protocol. STEP, STEP_DONE and the HELLO pages carry no control."""
