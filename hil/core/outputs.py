"""Output files: they are written completely or not at all, and replace an existing file only with ``--force``."""

import contextlib
import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Literal

from hil.core.errors import BadInputError, remedy

Existing = Literal["refuse", "number", "replace"]
"""What to do when the file exists already: raise BadInputError, use the next free name (``run_2.rrd`` after
``run.rrd``), or replace the file (``--force``)."""


def existing_files(*, force: bool) -> Existing:
    """Return what a command does with an existing file, given its option ``--force``."""
    return "replace" if force else "refuse"


def check_free(what: str, path: Path, existing: Existing = "refuse") -> None:
    """Raise BadInputError when the file exists and must not be replaced. ``what`` names the output in the message."""
    if existing == "refuse" and _is_there(path):
        raise _exists_already(what, path)


def free_name(path: Path) -> Path:
    """Return the path if no file has it, else the first free one of run_2.rrd, run_3.rrd and so on.

    The later parts of one recording have a hyphen (run-2.rrd), so that the two cannot be confused.
    """
    return next(name for name in _names(path) if not _is_there(name))


def claim(what: str, path: Path, existing: Existing = "refuse") -> Path:
    """Reserve a file for this process to write, and return its path.

    The file is created empty, so that only one of two processes gets the name. With ``replace`` nothing is created, and
    the path is returned unchanged. Raises BadInputError when the file exists (``refuse``) or cannot be created.
    """
    if existing == "replace":
        return path
    for name in _names(path) if existing == "number" else (path,):
        try:
            name.open("xb").close()
        except FileExistsError:
            continue
        except OSError as error:
            raise BadInputError(
                f"{what} {name}: it cannot be written ({error.strerror}); "
                + remedy(error, "choose a path that can be written")
            ) from error
        return name
    raise _exists_already(what, path)


def release(path: Path, existing: Existing = "refuse") -> None:
    """Remove a claimed file that was not written. With ``replace`` nothing is removed: the file is the user's."""
    if existing != "replace":
        with contextlib.suppress(OSError):  # on Windows it may still be open
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_file(path: Path, what: str = "file", existing: Existing = "refuse") -> Iterator[Path]:
    """Yield the path of a temporary file with the same suffix, and rename it to ``path`` when the block ends.

    After an error in the block (a full disk, for example) the temporary file is removed, and an existing file is
    unchanged. Raises BadInputError, which names ``what``, when the file exists and must not be replaced, or cannot be
    created; OSError when the rename fails.
    """
    path = claim(what, path, existing)
    if existing == "replace":
        path = path.resolve()  # replace the target of a symbolic link, not the link
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        yield unfinished
        unfinished.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)
        release(path, existing)
        raise


def write_whole(path: Path, data: bytes, what: str = "file", existing: Existing = "refuse") -> None:
    """Write a file completely or not at all. Raises BadInputError as ``whole_file`` does, and when writing fails."""
    try:
        with whole_file(path, what, existing) as unfinished:
            unfinished.write_bytes(data)
    except OSError as error:
        raise BadInputError(
            f"{what} {path}: it cannot be written ({error.strerror}); choose a folder that exists, is writable and has "
            "free space"
        ) from error


def _names(path: Path) -> Iterator[Path]:
    yield path
    for number in count(2):
        yield path.with_name(f"{path.stem}_{number}{path.suffix}")


def _exists_already(what: str, path: Path) -> BadInputError:
    return BadInputError(f"{what} {path}: the file exists already; choose another name, or replace it with --force")


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()  # exists() is false for a broken symbolic link
