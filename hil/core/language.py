"""What is spoken on a link, as far as a link has to know: framing, names, who sends what, and what is left alone."""

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


class Language(NamedTuple):
    """What the two sides of a link speak.

    Frames whose id is in ``senders`` come from that side only, and have the ``lengths`` of their ids; where ``senders``
    is None, frames with any identifier may come from either side. Frames from the id ``exempt_from`` on carry no
    control, such as STEP: conditions of the link leave them alone. Without ``make_framing`` it is for buses only. On a
    line of bytes frames end with ``delimiter``;
    where that is None, what is written at once is taken for one.
    """

    make_framing: Callable[[], Framing] | None = None
    names: Mapping[int, str] = _NOTHING
    senders: Mapping[int, str] | None = None
    lengths: Mapping[int, int] = _NO_LENGTHS
    exempt_from: int = _BEYOND_ALL_IDS
    delimiter: bytes | None = None

    def refusal(self, number: int, length: int, hears: Side) -> str | None:
        """Return why a frame on a bus is not for the side that ``hears`` the other; None where it is.

        ``own`` is what this side has sent itself. What the host sends is for the robot's firmware to count.
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
        """Return how many bytes from the start are whole frames."""
        return len(data) if self.delimiter is None else data.rfind(self.delimiter) + len(self.delimiter)

    def pieces(self, data: bytes) -> list[bytes]:
        """Return whole frames one by one."""
        if self.delimiter is None:
            return [data] if data else []
        return [piece + self.delimiter for piece in data.split(self.delimiter)[:-1]]


def _wheel_framing() -> Framing:
    """Return the framing of our own protocol. Raises BadInputError where the library that it is in was not built."""
    try:
        return HostLine()
    except BuildError as error:
        raise BadInputError(str(error)) from error


WHEEL_DBC = Language(_wheel_framing, NAMES, SENDERS, LENGTHS, 0x300, b"\0")
"""Our own protocol. STEP, STEP_DONE and the HELLO pages carry no control."""
