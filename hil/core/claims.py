"""A claim: a small record that is true while the process that wrote it lives, because the operating system says so.

A lock file is held (``flock``, on Windows ``LockFileEx``), and beside it is a JSON file with what the holder says of
itself. A process that dies loses the lock whatever way it died, so nothing is left to be cleaned up, and no process id
has to be asked after, which may be another's by then.
"""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

# A reader who looks whether a claim is held holds it for that moment.
_A_MOMENT_S = 0.3


class TakenError(Exception):
    """Somebody else holds the claim; ``holder`` is what he says of himself, empty where he has not said it yet."""

    def __init__(self, holder: Mapping[str, Any]) -> None:
        super().__init__("the claim is held")
        self.holder = holder


class Claim:
    """Holds ``folder/name.lock`` until ``release`` or the process's end, with ``record`` in ``folder/name.json``.

    ``mode`` is that of both files. Raises TakenError when another one holds it, and OSError when the folder cannot be
    written to.
    """

    def __init__(self, folder: Path, name: str, record: Mapping[str, Any], mode: int = 0o600) -> None:
        self._lock = _lock(folder, name, mode)
        self._record = folder / f"{name}.json"
        try:
            self._lock.acquire(timeout=_A_MOMENT_S, poll_interval=0.02)
        except Timeout:
            raise TakenError(_read(self._record)) from None
        try:
            write_private(self._record, json.dumps(record), mode)
        except OSError:
            self._lock.release()
            raise

    def release(self) -> None:
        """Give it up. Twice is allowed. The lock file stays: to remove one that another waits for would make two."""
        if self._lock.is_locked:
            self._record.unlink(missing_ok=True)
            self._lock.release()


def held(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of the claims in a folder that are held, by name; one whose holder has died is removed."""
    for record in sorted(folder.glob("*.json")):
        lock = _lock(folder, record.stem, 0o600)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if said := _read(record):
                yield said
            continue
        record.unlink(missing_ok=True)
        lock.release()


def write_private(path: Path, text: str, mode: int = 0o600) -> None:
    """Write a whole file at once, never readable by more than ``mode`` says. Raises OSError."""
    new = path.with_name(f".{path.name}.{os.getpid()}")
    with contextlib.suppress(FileNotFoundError):
        new.unlink()
    descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        if hasattr(os, "fchmod"):
            os.fchmod(descriptor, mode)  # whatever the umask; not by name, under which others may put a link
        file.write(text)
    new.replace(path)


def _lock(folder: Path, name: str, mode: int) -> FileLock:
    # Released by any thread, and never by a lock of another kind where there is no real one.
    return FileLock(folder / f"{name}.lock", mode=mode, thread_local=False)


def _read(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}  # its holder is about to write it, or to go
    return record if isinstance(record, dict) else {}
