"""Files that commands write: whole or not at all, and none that is there is replaced unless the user said so."""

import contextlib
import os
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Literal

from hil.core.errors import BadInputError

Existing = Literal["refuse", "number", "replace"]
"""What is done where a file of the wanted name is there already.

``refuse`` raises BadInputError, ``number`` takes the next free name (``run_2.rrd`` after ``run.rrd``), and ``replace``
is what ``--force`` asks for.
"""


def existing_files(*, force: bool) -> Existing:
    """Return what a command does where a file is there, by its option ``--force``."""
    return "replace" if force else "refuse"


def check_free(what: str, path: Path, existing: Existing = "refuse") -> None:
    """Raise BadInputError, which names ``what`` was to be written, when there is a file that must stay."""
    if existing == "refuse" and _is_there(path):
        raise _taken(what, path)


def free_name(path: Path) -> Path:
    """Return the path itself while nothing is there, else the first free one of run_2.rrd, run_3.rrd and so on.

    A recording's later parts have a hyphen before their number (run-2.rrd), so that the two are never confused.
    """
    return next(name for name in _names(path) if not _is_there(name))


def claim(what: str, path: Path, existing: Existing = "refuse") -> Path:
    """Reserve a file for this process to write, and return its path.

    The file is created empty now, so that of two processes that ask for the same name at once only one gets it. With
    ``replace`` nothing is created or reserved: the path is returned as it is. Raises BadInputError when the name is
    taken, and when the file cannot be created.
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
                f"{what} {name}: it cannot be written ({error.strerror}); choose a path that can be written"
            ) from error
        return name
    raise _taken(what, path)


def release(path: Path, existing: Existing = "refuse") -> None:
    """Remove a claimed file again, for nothing came of it; a file that was to be replaced is not ours to remove."""
    if existing != "replace":
        with contextlib.suppress(OSError):  # on Windows it may still be open
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def whole_file(path: Path, what: str = "file", existing: Existing = "refuse") -> Iterator[Path]:
    """Yield the path of an unfinished file, with the same suffix, that becomes ``path`` when the block ends.

    After an error of the block, on a full disk for one, nothing of it stays; a file that was to be replaced is then as
    it was. ``what`` it is to be is named by BadInputError, which is raised when a file is there that must stay, and
    when none can be created. OSError is raised when the finished file cannot take its place.
    """
    path = claim(what, path, existing)
    if existing == "replace":
        path = path.resolve()  # what a link leads to, and not the link
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
    """Write a file. Raises BadInputError as ``whole_file``, and when it cannot be written."""
    try:
        with whole_file(path, what, existing) as unfinished:
            unfinished.write_bytes(data)
    except OSError as error:
        raise BadInputError(
            f"{what} {path}: it cannot be written ({error.strerror}); name a folder that exists, has room and may be "
            "written to"
        ) from error


def _names(path: Path) -> Iterator[Path]:
    yield path
    for number in count(2):
        yield path.with_name(f"{path.stem}_{number}{path.suffix}")


def _taken(what: str, path: Path) -> BadInputError:
    return BadInputError(f"{what} {path}: it is there already; choose another name, or replace it with --force")


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()  # a link to nothing is a name that somebody has given
