"""Checks of a recording's path, before anything is started."""

import os
from pathlib import Path

from hil.errors import BadInputError

EXPECTED_FILE = "an .rrd file made by 'hil run --record'"
_MAGIC = b"RRF2"


def check_recording_path(path: Path) -> None:
    """Raise BadInputError unless a recording can be written to ``path``; touches nothing."""
    directory = path.absolute().parent
    if path.suffix != ".rrd":
        problem = "its name must end in .rrd, by which viewers know it"
    elif path.is_dir():
        problem = "it is a directory; name a file in it"
    elif not directory.is_dir():
        problem = f"there is no directory {directory}; make it, or choose another path"
    elif not os.access(path if path.exists() else directory, os.W_OK):
        problem = f"{'it' if path.exists() else directory} is not writable; choose another path, or no recording"
    else:
        return
    raise BadInputError(f"recording {path}: {problem}")


def check_is_recording(path: Path) -> None:
    """Raise BadInputError unless the path is a file that begins like a recording."""
    try:
        with path.open("rb") as file:
            start = file.read(len(_MAGIC))
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}; expected {EXPECTED_FILE}") from error
    if not start:
        raise BadInputError(f"{path}: the file is empty; expected {EXPECTED_FILE}")
    if start != _MAGIC:
        raise BadInputError(f"{path}: not a recording; expected {EXPECTED_FILE}")
