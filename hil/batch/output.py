"""Files of all batches: the folder for results, older results in it, and results that cannot be written."""

import contextlib
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.outputs import Existing


def make_folder(folder: Path) -> None:
    """Make a folder for results. Raises BadInputError when it cannot be made or written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInputError(
            f"--out {folder}: it cannot be written to ({error.strerror}); name a folder that you may write to"
        ) from error


def check_older(folder: Path, older: Sequence[Path], what: str, existing: Existing) -> None:
    """Raise BadInputError when a folder has ``older`` results of ``what`` that must stay."""
    if older and existing == "refuse":
        raise BadInputError(
            f"--out {folder}: it has {older[0].name} of an earlier {what}; name another folder, or replace its "
            "results with --force"
        )


def remove(older: Sequence[Path]) -> None:
    """Remove older results. Raises BadInputError when one cannot be removed."""
    for file in older:
        try:
            file.unlink()
        except OSError as error:
            raise BadInputError(
                f"file {file}: this older result cannot be removed ({error.strerror}); name another folder"
            ) from error


@contextlib.contextmanager
def deferred(errors: list[BadInputError]) -> Iterator[None]:
    """Put a BadInputError into the list ``errors``, so that one file that cannot be written stops no other."""
    try:
        yield
    except BadInputError as error:
        errors.append(error)
