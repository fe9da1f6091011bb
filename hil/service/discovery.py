"""Finds services on this machine: each has a record and a token in its user's state folder."""

import dataclasses
import secrets
import stat
import sys
from pathlib import Path

from platformdirs import user_state_path

from hil.core.errors import BadInputError
from hil.core.process_lock import LockHeldError, ProcessLock, held, write_private

_SHORTEST_TOKEN = 16


@dataclasses.dataclass(frozen=True, slots=True)
class Service:
    """A running service: its URL, its control process, what it drives, and the file with its token."""

    url: str
    pid: int
    title: str
    device: str
    token_file: str

    @property
    def port(self) -> int:
        """Port of its API."""
        return int(self.url.rpartition(":")[2])


def state_folder() -> Path:
    """Return the folder for the records of this user's services, made if missing; only this user can read it."""
    folder = user_state_path("mecanum-hil", appauthor=False) / "services"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise BadInputError(f"folder {folder}: it cannot be made ({error.strerror}); make it yourself") from error
    return folder


def announce(service: Service) -> ProcessLock:
    """Announce a service until the claim is released or this process ends. Raises BadInputError."""
    try:
        return ProcessLock(state_folder(), str(service.port), dataclasses.asdict(service))
    except LockHeldError as error:
        raise BadInputError(
            f"port {service.port}: process {error.holder.get('pid', '?')} serves there; choose another port"
        ) from None


def running() -> list[Service]:
    """Return this user's running services, sorted by port."""
    return sorted((Service(**record) for record in held(state_folder())), key=lambda service: service.port)


def own_token_file(port: int) -> Path:
    """Return the default token file of a service."""
    return state_folder() / f"{port}.token"


def make_token(path: Path) -> None:
    """Write a new token to a file that only this user may read. Raises BadInputError."""
    try:
        write_private(path, secrets.token_urlsafe(32) + "\n")
    except OSError as error:
        raise BadInputError(
            f"token file {path}: it cannot be written ({error.strerror}); name one in a folder where you may write"
        ) from error


def read_token(path: Path) -> str:
    """Return the token in a file. Raises BadInputError when it is unreadable, no token, or readable by others."""
    try:
        text = path.read_text(encoding="ascii").strip()
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not ASCII"
        raise BadInputError(
            f"token file {path}: it cannot be read ({why}); name the service's own with --token-file"
        ) from error
    if sys.platform != "win32" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInputError(
            f"token file {path}: others may read it (mode {stat.S_IMODE(mode):04o}), and could drive the robot; "
            f"chmod 600 {path}"
        )
    if len(text) < _SHORTEST_TOKEN or not text.isprintable() or " " in text:
        raise BadInputError(
            f"token file {path}: {len(text)} characters are no token; expected one line of at least {_SHORTEST_TOKEN} "
            "characters without spaces, or remove the file and one is made"
        )
    return text
