"""Costly results are made once for all processes of a session, by the first that asks for them."""

import functools
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from filelock import FileLock

Made = TypeVar("Made")
_folders: list[Path] = []


def share(folder: Path) -> None:
    """Take the folder that all processes of the session have; tests/conftest.py says which."""
    _folders[:] = [folder / "once"]
    _folders[0].mkdir(exist_ok=True)


def made(name: str, make: Callable[[Path], Made]) -> Made:
    """Return the result of ``make``, which puts its files into the given folder; the result has to be picklable."""
    folder = _folders[0] / name
    result = folder / "made.pickle"
    with FileLock(f"{folder}.lock"):
        if not result.exists():
            folder.mkdir(exist_ok=True)
            result.write_bytes(pickle.dumps(make(folder)))
    return _loaded(result)  # type: ignore[return-value]


@functools.cache
def _loaded(result: Path) -> object:
    return pickle.loads(result.read_bytes())
