"""Finds the kind of link that a URL names. Parsing a URL gives a frozen value and opens nothing.

The address ends at the first ``?``, and the CAN interface at the first ``/``. Every later slash belongs to the channel;
it may be written as %2F too. ``%XX`` stands for one byte of UTF-8 in an address and in a value. So ``?`` is written
%3F, ``%`` is written %25 and, in a value, ``&`` is written %26.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from hil.core.errors import BadInputError
from hil.core.extensions import Extensions
from hil.core.link_protocol import WHEEL_DBC, LinkProtocol
from hil.wire import link
from hil.wire.link import DEFAULT_BAUD, Line, LinkUrl, Pair, unchanged


@dataclass(frozen=True, slots=True)
class MemoryUrl(LinkUrl):
    """Both sides in one process."""

    example: ClassVar[str] = "memory:"
    forms: ClassVar[Mapping[str, str]] = {
        "memory:": "both sides in one process; the bytes are the same as on a serial line"
    }
    wire = None
    is_within_process = True
    is_direct = True

    @classmethod
    def read(cls, address: str, settings: Mapping[str, str], baud: int) -> "MemoryUrl":
        if address:
            raise BadInputError("memory: takes no address; write memory:")
        return cls()

    def __str__(self) -> str:
        return "memory:"

    def open_pair(self, line: Line = unchanged, *, lockstep: bool, protocol: LinkProtocol = WHEEL_DBC) -> Pair:
        from hil.wire.framed import StreamLink
        from hil.wire.robot_end import CanWire, SerialWire
        from hil.wire.streams import memory_bus, memory_pair

        if protocol.make_framing is None:
            bus, other = memory_bus()
            return Pair(bus, CanWire(other))
        host, robot = memory_pair()
        return Pair(StreamLink(line(host), protocol), SerialWire(robot))


LINKS = Extensions("hil.links")
"""The kinds of links by the scheme of their URLs."""


def link_forms() -> dict[str, str]:
    """Return every form of link URL with its purpose; for another package's kind, with its origin."""
    forms: dict[str, str] = {}
    for scheme in LINKS.shipped:
        forms |= LINKS.load(scheme, scheme).forms
    others = {f"{scheme}:": f"from the package {package} ({line})" for scheme, package, line in LINKS.lines()}
    return forms | others


def parse_link(url: str, *, baud: int = DEFAULT_BAUD) -> LinkUrl:
    """Parse a link URL; ``baud`` is the speed of a serial line whose URL gives none.

    Raises BadInputError with the URL, the wrong part and the remedy.
    """
    try:
        scheme, colon, rest = url.partition(":")
        kind = _kind(url, scheme, is_complete=bool(colon))
        address, settings = link.split(rest, scheme, kind.settings)
        return kind.read(address, settings, baud)
    except BadInputError as error:
        raise BadInputError(f"link {url!r}: {error}") from None


def _kind(url: str, scheme: str, *, is_complete: bool) -> type[LinkUrl]:
    if re.match(r"/dev/|COM[0-9]|\\\\", url):
        raise BadInputError(f"the kind of link is missing; for a serial port write serial:{url}")
    if scheme not in LINKS:
        raise BadInputError(f"{LINKS.unknown(scheme, f'unknown kind of link {scheme!r}')}; an example: {link.EXAMPLE}")
    named = f"the kind of link {scheme!r}"
    if not is_complete:
        example = LINKS.load(scheme, named).example if LINKS.is_shipped(scheme) else f"{scheme}:"
        raise BadInputError(f"the colon is missing; write {example}")
    kind: Any = LINKS.load(scheme, named)
    if not (isinstance(kind, type) and issubclass(kind, LinkUrl)):
        raise BadInputError(f"{named} is {kind!r}; expected a subclass of hil.wire.link.LinkUrl")
    return kind
