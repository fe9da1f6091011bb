"""Files and folders that only one user may use, for locks and for secrets."""

import contextlib
import errno
import os
import stat
import sys
from pathlib import Path

from hil.core.errors import BadInputError

PRIVATE = 0o600
"""Mode of a file that only its user may read and write."""


def private_folder(folder: Path) -> Path:
    """Make a folder that this user alone may use, if it is missing, and return it.

    Raises OSError when it cannot be made, is a symbolic link, belongs to another user, or may be written to by others.
    """
    for one in (*reversed(folder.parents), folder):
        if not one.exists():
            one.mkdir(mode=0o700, exist_ok=True)  # each with this mode, whatever the umask
    if sys.platform != "win32":  # where the folder of a user's data is the user's own
        status = folder.lstat()
        others_may_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
        if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or others_may_write:
            raise OSError(errno.EPERM, "it is no folder that this user alone may write to")
    return folder


def write_private(path: Path, text: str) -> None:
    """Write a file that only this user may read, and move it into place. Raises OSError."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, PRIVATE)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            if hasattr(os, "fchmod"):
                # Independent of the umask. By descriptor, because the name could become a symbolic link.
                os.fchmod(descriptor, PRIVATE)
            file.write(text)
        new.replace(path)
    except OSError:  # a full disk
        new.unlink(missing_ok=True)
        raise


def read_private(path: Path, what: str) -> str:
    """Return the text of a file with secrets, which messages call ``what``.

    Raises BadInputError when it is unreadable, or readable by others.
    """
    try:
        text = path.read_text(encoding="ascii")
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not ASCII"
        raise BadInputError(f"{what} {path}: it cannot be read ({why}); name one that you may read") from error
    if sys.platform != "win32" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInputError(
            f"{what} {path}: others may read it (mode {stat.S_IMODE(mode):04o}), and could command the robot; "
            f"chmod 600 {path}"
        )
    return text
