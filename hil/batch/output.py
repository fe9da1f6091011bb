"""What all batches write: the folder for results, older results in it, files that cannot be written, and tables."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from hil.core.errors import BadInputError
from hil.core.outputs import Existing


def prepare_folder(folder: Path, older: Callable[[Path], Sequence[Path]], what: str, existing: Existing) -> None:
    """Make a folder for results of ``what``; ``older`` lists the files of earlier ones in it.

    Raises BadInputError when it cannot be made or written to, or has older results that must stay.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise BadInputError(
            f"--out {folder}: it cannot be written to ({error.strerror}); name a folder that you may write to"
        ) from error
    if existing == "refuse" and (files := older(folder)):
        raise BadInputError(
            f"--out {folder}: it has {files[0].name} of an earlier {what}; name another folder, or replace its "
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


def markdown_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows, the first of which is the head, as a table for a page in Markdown."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n" for row in rows]
    return "".join([lines[0], "|---" * len(rows[0]) + "|\n", *lines[1:]])
