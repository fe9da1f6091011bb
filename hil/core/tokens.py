"""Tokens by which our processes know each other over sockets of this machine: secrets in files of one user.

Every user of a machine can connect to its loopback sockets. So each of our servers has a token in a file that only its
own user can read. A client of that user finds the file by the server's port.

One state folder may serve several machines, or several network namespaces of one, as where containers share a home. A
port is one of a namespace. So each token begins with a mark of where its server runs, and a server judges only those
with its own mark.
"""

import functools
import hashlib
import platform
import secrets
import socket
from collections.abc import Collection
from pathlib import Path

from platformdirs import user_state_path

from hil.core.errors import BadInputError, remedy
from hil.core.private_files import private_folder, read_private, write_private

SHORTEST = 16
"""Characters that a token has at least."""
_ANSWER_S = 1.0


def state_folder(kind: str) -> Path:
    """Return the folder for this user's servers of a kind, made if missing; only this user can write to it.

    Raises BadInputError when it cannot be used.
    """
    folder = user_state_path("mecanum-hil", appauthor=False) / kind
    try:
        return private_folder(folder)
    except OSError as error:
        raise BadInputError(
            f"folder {folder}: it cannot be used ({error.strerror}); "
            + remedy(error, "make it yourself, with mode 0700")
        ) from error


def token_file(kind: str, port: int) -> Path:
    """Return the file with the token of this user's server of a kind at a port; raises as ``state_folder``."""
    return state_folder(kind) / f"{port}.token"


def clear_tokens(kind: str, kept: Collection[int] = ()) -> None:
    """Remove the tokens that killed servers of a kind have left: those of here and of ports where nobody listens.

    A token of another machine or network namespace stays: whether its server lives cannot be known here. ``kept`` are
    ports that are left alone, as of a service whose API is being started again. A server listens before it makes its
    token. Raises as ``state_folder``.
    """
    for path in state_folder(kind).glob("*.token"):
        if path.stem.isdecimal() and (port := int(path.stem)) not in kept and _is_ours(path) and not _listens(port):
            path.unlink(missing_ok=True)


def is_of_elsewhere(path: Path) -> bool:
    """Return whether a token is there that was made on another machine or in another network namespace."""
    return path.exists() and not _is_ours(path)


def _is_ours(path: Path) -> bool:
    try:
        return path.read_text(encoding="ascii").startswith(_mark())
    except (OSError, ValueError):  # it is gone, or no token
        return False


@functools.cache
def _mark() -> str:
    """Return the beginning of all tokens that are made on this machine and in this network namespace."""
    try:
        namespace = str(Path("/proc/self/ns/net").readlink())
    except OSError:  # not Linux
        namespace = ""
    return hashlib.sha256(f"{platform.node()}/{namespace}".encode()).hexdigest()[:8] + "."


def _listens(port: int) -> bool:
    """Return whether a server may be at a port: False only where the system refuses the connection."""
    try:
        socket.create_connection(("127.0.0.1", port), _ANSWER_S).close()
    except ConnectionRefusedError:
        return False
    except OSError:  # it is busy
        pass
    return True


def make_token(path: Path) -> None:
    """Write a new token to a file that only this user may read. Raises BadInputError."""
    try:
        write_private(path, f"{_mark()}{secrets.token_urlsafe(32)}\n")
    except OSError as error:
        raise BadInputError(
            f"token file {path}: it cannot be written ({error.strerror}); "
            + remedy(error, "name one in a folder where you may write")
        ) from error


def read_token(path: Path) -> str:
    """Return the token in a file. Raises BadInputError as ``read_private``, and when that is no token."""
    text = read_private(path, "token file").strip()
    if len(text) < SHORTEST or not text.isprintable() or " " in text:
        raise BadInputError(
            f"token file {path}: {len(text)} characters are no token; expected one line of at least {SHORTEST} "
            "characters without spaces, or remove the file and one is made"
        )
    return text
