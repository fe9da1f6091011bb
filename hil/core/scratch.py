"""Temporary folders that do not outlive their process: what one that was killed has left, the next one removes."""

import contextlib
import functools
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

_PREFIX = "mecanum-hil-scratch-"


@contextlib.contextmanager
def scratch_folder(what: str) -> Iterator[Path]:
    """Yield a new temporary folder that this user alone may use, and remove it afterwards; ``what`` is in its name.

    The process holds a lock on the folder itself, which the operating system releases however the process ends. So a
    folder without a holder is one that a killed process has left. The first folder of a process removes all of these.
    Windows locks no folders: there a killed process leaves its own behind.

    Raises OSError when no folder can be made.
    """
    _remove_left()
    folder, holder = _made(what)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if holder is not None:
            os.close(holder)


@functools.cache
def _remove_left() -> None:
    """Remove the folders of processes of this user that were killed; one that cannot be removed stays."""
    for folder in left_folders():
        remove_left(folder)


def left_folders() -> list[Path]:
    """Return the folders of processes of this user that were killed; none on Windows, which cannot tell."""
    if sys.platform == "win32":
        return []
    with os.scandir(tempfile.gettempdir()) as entries:
        folders = [Path(entry.path) for entry in entries if entry.name.startswith(_PREFIX)]
    return [folder for folder in folders if _is_free(folder)]


def remove_left(folder: Path) -> None:
    """Remove one of ``left_folders``, unless a process holds it by now."""
    if sys.platform != "win32" and (holder := _hold(folder)) is not None:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(holder)


def _made(what: str) -> tuple[Path, int | None]:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{what}-")).absolute()
        if sys.platform == "win32":
            return folder, None
        # Another process may have found it before it was held, and is removing it.
        if (holder := _hold(folder)) is not None:
            if folder.exists():
                return folder, holder
            os.close(holder)


if sys.platform != "win32":
    import fcntl

    def _is_free(folder: Path) -> bool:
        if (holder := _hold(folder)) is None:
            return False
        os.close(holder)
        return True

    def _hold(folder: Path) -> int | None:
        """Lock a folder of this user, and return the descriptor that holds it; None when that is not possible."""
        try:
            # Of another user's link or folder at this name nothing may be removed.
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
        except OSError:
            return None
        try:
            if os.fstat(descriptor).st_uid == os.getuid():
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return descriptor
        except OSError:  # a living process holds it
            pass
        os.close(descriptor)
        return None
