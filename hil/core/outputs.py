"""Names of the files that commands write: a file that is there is never replaced unless the user said so."""

import contextlib
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


def _names(path: Path) -> Iterator[Path]:
    yield path
    for number in count(2):
        yield path.with_name(f"{path.stem}_{number}{path.suffix}")


def _taken(what: str, path: Path) -> BadInputError:
    return BadInputError(f"{what} {path}: it is there already; choose another name, or replace it with --force")


def _is_there(path: Path) -> bool:
    return path.exists() or path.is_symlink()  # a link to nothing is a name that somebody has given
