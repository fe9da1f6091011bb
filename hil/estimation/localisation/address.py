"""Where pose fixes are received, and where a stream is sent: udp://HOST:PORT."""

import ipaddress
from urllib.parse import urlsplit

from hil.core.errors import BadInputError

LOOPBACK = "127.0.0.1"
_EXPECTED = 'expected "simulated" or udp://127.0.0.1:PORT with a port from 1 to 65535'


def parse_address(address: str, named: str = "estimator.fix", expected: str = _EXPECTED) -> tuple[str, int]:
    """Return host and port of ``udp://HOST:PORT``; without a host it is 127.0.0.1.

    An address of another network has to be given as such, in numbers: whoever can send there can tell the robot where
    it is. Raises BadInputError for anything else, in which ``named`` is where the address was given.
    """
    refusal = f"{named} = {address!r}"
    try:
        parts = urlsplit(address)
        host, port = parts.hostname or LOOPBACK, parts.port
    except ValueError:
        raise BadInputError(f"{refusal}: no address; {expected}") from None
    extra = parts.path or parts.query or parts.fragment or parts.username
    if parts.scheme != "udp" or not parts.netloc or extra or port is None or port == 0:
        raise BadInputError(f"{refusal}: no address; {expected}")
    try:
        return str(ipaddress.IPv4Address(LOOPBACK if host == "localhost" else host)), port
    except ValueError:
        raise BadInputError(
            f"{refusal}: {host!r} is no IPv4 address in numbers; expected 127.0.0.1, or that of a network card"
        ) from None
