"""Files that a run writes: what their names must be, and whether they can be written, before anything is started."""

import errno
import os
import tempfile
from pathlib import Path

from hil.errors import BadInputError

EXPECTED_FILE = "an .rrd file made by 'hil run --record'"
OUTPUTS = {"recording": (".rrd",), "trace": (".blf", ".asc", ".log")}
"""What a run writes, and how its name may end. A trace: Vector's binary and text form, and that of ``candump -L``."""
_MAGIC = b"RRF2"
_PROBE_BYTES = 1 << 20


def check_output_path(what: str, path: Path) -> None:
    """Raise BadInputError unless one of ``OUTPUTS`` can be written to ``path``; touches nothing."""
    folder = path.absolute().parent
    *others, last = OUTPUTS[what]
    if path.suffix not in OUTPUTS[what]:
        problem = f"its name must end in {', '.join(others)}{' or ' * bool(others)}{last}, which tells its format"
    elif path.is_dir():
        problem = "it is a folder; name a file in it"
    elif not folder.is_dir():
        problem = f"there is no folder {folder}; make it, or choose another path"
    elif not os.access(path if path.exists() else folder, os.W_OK):
        problem = f"{'it' if path.exists() else folder} is not writable; choose another path, or no {what}"
    else:
        return
    raise BadInputError(f"{what} {path}: {problem}")


def why_not_written(path: Path, error: Exception) -> str:
    """Return why a file that was begun could not be written any more.

    rerun tells of its own threads and not what the system said, so this writes to the same folder, and takes it back.
    """
    if not isinstance(error, OSError):
        try:
            with tempfile.TemporaryFile(dir=path.parent) as probe:
                probe.write(bytes(_PROBE_BYTES))
        except OSError as told:
            error = told
    if not isinstance(error, OSError):
        return str(error)
    what = "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "it could not be written any more"
    return f"{what} ({error.strerror})"


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
