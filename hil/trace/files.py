"""Which trace files there are, and whether one can be written."""

import os
from pathlib import Path

from hil.errors import BadInputError, nearest

WRITTEN = (".blf", ".asc", ".log")
"""Endings of the files that a run writes: Vector's binary and text form, and that of ``candump -L``."""


def check_trace_path(path: Path) -> None:
    """Raise BadInputError unless a trace can be written to ``path``; touches nothing."""
    folder = path.absolute().parent
    if path.suffix not in WRITTEN:
        problem = f"its name tells the format{nearest(path.suffix, WRITTEN)}"
    elif path.is_dir():
        problem = "it is a folder; name a file in it"
    elif not folder.is_dir():
        problem = f"there is no folder {folder}; make it, or choose another path"
    elif not os.access(path if path.exists() else folder, os.W_OK):
        problem = f"{'it' if path.exists() else folder} is not writable; choose another path"
    else:
        return
    raise BadInputError(f"trace {path}: {problem}")
