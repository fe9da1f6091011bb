"""Who may use the API, and for what: clients are known by their token, which has a name and roles."""

import re
import secrets
import time
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import BadInputError, nearest
from hil.core.private_files import read_private
from hil.core.tokens import SHORTEST
from hil.service import logs
from hil.service.messages import Action

Headers = Sequence[tuple[bytes, bytes]]

OWNER = "owner"
"""Name of the service's own token, which may do everything."""

_ORDERS_PER_S = 200.0  # of one token: ten clients that drive by twist
_AT_ONCE = 200.0
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


class Access:
    """Knows the tokens. ``owner`` is the service's own; ``others`` are clients by their tokens.

    Raises BadInputError when one of the others has the service's own token: it would take the owner's place.
    """

    def __init__(self, owner: str, others: Mapping[str, Client]) -> None:
        self._owner = owner
        self._left: dict[str, float] = {}
        self._filled_s = time.monotonic()
        self.replace(others)

    def replace(self, others: Mapping[str, Client]) -> None:
        """Know these other clients from now on. Raises BadInputError as the constructor, and then nothing changes."""
        owner = self._owner
        if owner in others:
            raise BadInputError(
                f"clients file: {others[owner].name!r} has the service's own token; give it one of its own"
            )
        tokens = {owner: Client(OWNER, frozenset(Role)), **others}
        self._clients = [(f"Bearer {token}".encode(), client) for token, client in tokens.items()]
        self._left = {client.name: self._left.get(client.name, _AT_ONCE) for client in tokens.values()}

    def client(self, headers: Headers) -> Client | None:
        """Return whose token is in the headers of a request, or None."""
        shown = values_of(headers, b"authorization")
        found = None
        for expected, client in self._clients:  # all of them, so that the time tells nothing
            if len(shown) == 1 and secrets.compare_digest(shown[0], expected):
                found = client
        return found

    def is_known(self, headers: Headers) -> bool:
        """Return whether the headers of a request have a token."""
        return self.client(headers) is not None

    def is_in_time(self, client: Client, action: Action) -> bool:
        """Count an order; return False when the client's token has given too many a second."""
        if action in UNLIMITED:
            return True
        now_s = time.monotonic()
        more, self._filled_s = (now_s - self._filled_s) * _ORDERS_PER_S, now_s
        self._left = {name: min(_AT_ONCE, left + more) for name, left in self._left.items()}
        if self._left[client.name] < 1.0:
            return False
        self._left[client.name] -= 1.0
        return True


class ClientsFile:
    """Keeps ``Access`` as the file of the other clients says, while it changes.

    A changed file that cannot be used changes nothing, and the log says so: the tokens from before stay valid.
    Raises BadInputError when the file cannot be used at the start.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._state()
        self.others = read_clients(path)

    def refresh(self, access: Access) -> None:
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


def values_of(headers: Headers, name: bytes) -> list[bytes]:
    """Return the values of all headers of a name in lower case."""
    return [value for key, value in headers if key == name]
