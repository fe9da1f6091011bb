"""Access to the API: a client's token has a name, and roles for groups of orders."""

import asyncio
import re
import secrets
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from hil.addons.service import logs
from hil.addons.service.logs import Rate
from hil.addons.service.messages import HOST, Action
from hil.core.errors import BadInputError, nearest
from hil.core.private_files import read_private
from hil.core.tokens import SHORTEST

Headers = Sequence[tuple[bytes, bytes]]

OWNER = "owner"
"""Name of the service's own token, which may do everything."""

_ORDERS_PER_S = 200.0  # of one token: ten clients that drive by twist
_AT_ONCE = 200.0
_READS_PER_S = 100.0
_COST_OF_LONG = 10.0  # of a request for metrics or the document, in those for the status
_FRAMES_PER_S = 2000.0
_REFRESH_S = 1.0
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,40}")


class Role(StrEnum):
    """What a token is for. Every token may read the status and give an emergency stop."""

    READ = "read"
    DRIVE = "drive"
    RECORD = "record"
    ADMINISTER = "administer"  # all of these, and change gains, which may load code, or end the service


NEEDED: Mapping[Action, Role] = {
    **dict.fromkeys(Action, Role.DRIVE),
    Action.ESTOP: Role.READ,
    Action.RECORD: Role.RECORD,
    Action.STOP_RECORDING: Role.RECORD,
    Action.GAINS: Role.ADMINISTER,
    Action.SHUTDOWN: Role.ADMINISTER,
}
"""The role that an order needs."""

UNLIMITED = frozenset({Action.ESTOP, Action.STOP, Action.DISARM})
"""Orders that may come as often as they like, because they make the robot stop."""


class Client(NamedTuple):
    """Whoever gives an order: the name and the roles of the token, and the address of the other end."""

    name: str
    roles: frozenset[Role]
    address: str = ""

    def may(self, action: Action) -> bool:
        """Return whether the roles suffice for an order."""
        needed = NEEDED[action]
        return needed in self.roles or needed is Role.READ or Role.ADMINISTER in self.roles


class Rates:
    """How fast one token may be used: orders, other requests, and frames on all its WebSockets."""

    def __init__(self) -> None:
        self.orders = Rate(_ORDERS_PER_S, _AT_ONCE)
        self.reads = Rate(_READS_PER_S, _AT_ONCE)
        self.frames = Rate(_FRAMES_PER_S, 2 * _FRAMES_PER_S)


class Access:
    """Knows the tokens. ``owner`` is the service's own; ``others`` are clients by their tokens.

    Raises BadInputError when one of the others has the service's own token: it would take the owner's place.
    """

    def __init__(self, owner: str, others: Mapping[str, Client]) -> None:
        self._owner = owner
        self._rates: dict[str, Rates] = {}
        self.replace(others)

    def replace(self, others: Mapping[str, Client]) -> None:
        """Know these other clients from now on. Raises BadInputError as the constructor, and then nothing changes."""
        owner = self._owner
        if owner in others:
            raise BadInputError(
                f"clients file: {others[owner].name!r} has the service's own token; give it one of its own"
            )
        tokens = {owner: Client(OWNER, frozenset(Role)), **others}
        self._clients = [(token.encode(), client) for token, client in tokens.items()]
        self._rates = {client.name: self._rates.get(client.name) or Rates() for client in tokens.values()}

    def client(self, headers: Headers) -> Client | None:
        """Return whose token is in the headers of a request, or None."""
        shown = [value.partition(b" ") for value in values_of(headers, b"authorization")]
        tokens = [token for scheme, _, token in shown if scheme.lower() == b"bearer"]  # HTTP's schemes have no case
        found = None
        for expected, client in self._clients:  # all of them, so that the time tells nothing
            if len(shown) == len(tokens) == 1 and secrets.compare_digest(tokens[0], expected):
                found = client
        return found

    def rates(self, client: Client) -> "Rates":
        """Return how fast a client's token may be used."""
        return self._rates.get(client.name) or Rates()  # its token may have been withdrawn a moment ago

    def is_in_time(self, client: Client, action: Action) -> bool:
        """Count an order; return False when the client's token has given too many a second."""
        return action in UNLIMITED or self.rates(client).orders.take()

    def may_read(self, client: Client, path: str) -> bool:
        """Count a request that is no order; return False when the client's token has made too many a second."""
        if client.name == OWNER:
            return True
        return self.rates(client).reads.take(1.0 if path == "/v1/status" else _COST_OF_LONG)


class ClientsFile:
    """Keeps ``Access`` as the file of the other clients says, while it changes.

    A changed file that cannot be used changes nothing, and the log says so: the tokens from before stay valid.
    Raises BadInputError when the file cannot be used at the start.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._state()
        self.others = read_clients(path)

    async def keep(self, access: Access) -> None:
        """Look once a second whether the file has changed, until cancelled."""
        while True:
            await asyncio.sleep(_REFRESH_S)
            self._refresh(access)

    def _refresh(self, access: Access) -> None:
        """Look whether the file has changed, and read it then."""
        state = self._state()
        if state == self._seen:
            return
        self._seen = state
        try:
            access.replace(read_clients(self._path))
        except BadInputError as error:
            logs.error("clients file cannot be used; the clients from before stay", why=str(error))
        else:
            logs.info("clients file was read again", path=self._path)

    def _state(self) -> tuple[int, ...] | None:
        try:
            found = self._path.stat()
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns, found.st_size, found.st_mode


TOO_MANY = f"more than {_ORDERS_PER_S:g} orders a second were given with this token; stop, disarm and estop still pass"
TOO_MANY_READS = (
    f"more than {_READS_PER_S:g} requests a second came with this token (metrics count for {_COST_OF_LONG:g}); "
    "the WebSocket sends the status by itself"
)


def read_clients(path: Path) -> dict[str, Client]:
    """Return the clients in a file, by their tokens.

    There is one a line, ``NAME ROLE[,ROLE] TOKEN``. A line that begins with # is a comment.

    Raises BadInputError for a file that others may read, and for a line that is not of this form.
    """
    clients: dict[str, Client] = {}
    for number, line in enumerate(read_private(path, "clients file").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"clients file {path}, line {number}"
        if len(words) != 3 or _NAME.fullmatch(words[0]) is None or len(words[2]) < SHORTEST:
            raise BadInputError(
                f"{where}: expected NAME ROLE[,ROLE] TOKEN: a name of letters, digits and _.-, and a token of at least "
                f"{SHORTEST} characters, as 'openssl rand -hex 32' prints one"
            )
        name, roles, token = words
        for role in roles.split(","):
            if role not in (known := [one.value for one in Role]):
                raise BadInputError(f"{where}: no role {role!r}{nearest(role, known)}")
        if token in clients or name == OWNER or name in {client.name for client in clients.values()}:
            raise BadInputError(
                f"{where}: {name!r} or its token is there already; each has a name and a token of its own"
            )
        clients[token] = Client(name, frozenset(map(Role, roles.split(","))))
    return clients


NO_TOKEN = "the header 'Authorization: Bearer TOKEN' with a valid token is missing or wrong"


def misdirected(headers: Headers, port: int) -> str | None:
    """Return a sentence if the Host header does not name this port of this machine, as after DNS rebinding; or None."""
    hosts = [f"{name}:{port}" for name in (HOST, "localhost")]
    if values_of(headers, b"host") in [[host.encode()] for host in hosts]:
        return None
    return f"this port answers for {' or '.join(hosts)} only, and the Host header names another"


def values_of(headers: Headers, name: bytes) -> list[bytes]:
    """Return the values of all headers of a name in lower case."""
    return [value for key, value in headers if key == name]
