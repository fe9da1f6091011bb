"""Tokens by which our processes know each other over sockets of this machine: secrets in files of one user.

Every user of a machine can connect to its loopback sockets. So each server of ours has a token, which only those know
who may read its file. A client of the same user finds the file by the server's port.
"""

import secrets
from pathlib import Path

from platformdirs import user_state_path

from hil.core.errors import BadInputError, remedy
from hil.core.private_files import private_folder, read_private, write_private

SHORTEST = 16
"""Characters that a token has at least."""


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


def make_token(path: Path) -> None:
    """Write a new token to a file that only this user may read. Raises BadInputError."""
    try:
        write_private(path, secrets.token_urlsafe(32) + "\n")
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
