"""A file that is written whole or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.outputs import Existing, claim, release


@contextlib.contextmanager
def whole_file(path: Path, what: str = "file", existing: Existing = "refuse") -> Iterator[Path]:
    """Give the path of an unfinished file, with the same suffix, that becomes ``path`` when the block ends.

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
