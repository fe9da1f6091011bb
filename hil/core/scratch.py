"""Temporary folders."""

import contextlib
import tempfile
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def scratch_folder(what: str) -> Iterator[Path]:
    """Yield a new temporary folder that this user alone may use, and remove it afterwards; ``what`` is in its name.

    A process that is killed leaves it behind. Raises OSError when no folder can be made.
    """
    with tempfile.TemporaryDirectory(prefix=f"mecanum-hil-{what}-", ignore_cleanup_errors=True) as folder:
        yield Path(folder).absolute()
