"""A lock that one process of a user holds until it ends, with a record that describes the holder.

The lock is a file that the operating system locks, and releases however the process ends; the record is a JSON file
next to it. Both are in a ``private_folder``, where no other user can remove or hold the lock or replace it by a link.
"""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from hil.core.private_files import PRIVATE, write_private

# Longer than ``held`` keeps each lock when it tests whether it is free.
_TIMEOUT_S = 0.3


class LockHeldError(Exception):
    """Another process holds the lock. ``holder`` is its record, or empty if it has not written one yet."""

    def __init__(self, holder: Mapping[str, Any]) -> None:
        super().__init__("another process holds the lock")
        self.holder = holder


class ProcessLock:
    """Holds ``folder/name.lock`` until ``release`` or the process's end, and writes ``record`` to ``folder/name.json``.

    ``folder`` is a ``private_folder``. Raises LockHeldError when another process holds the lock, and OSError when the
    folder is not writable.
    """

    def __init__(self, folder: Path, name: str, record: Mapping[str, Any]) -> None:
        self._lock = _lock(folder, name)
        self._record = folder / f"{name}.json"
        try:
            self._lock.acquire(timeout=_TIMEOUT_S, poll_interval=0.02)
        except Timeout:
            raise LockHeldError(_read(self._record)) from None
        try:
            write_private(self._record, json.dumps(record))
        except OSError:
            self._lock.release()
            raise

    def release(self) -> None:
        """Release the lock. Calling twice is allowed. The lock file stays: another process may be waiting for it."""
        if self._lock.is_locked:
            self._record.unlink(missing_ok=True)
            self._lock.release()


def held(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the records of the held locks in a folder, sorted by name; remove records whose holder has ended."""
    for record in sorted(folder.glob("*.json")):
        lock = _lock(folder, record.stem)
        try:
            lock.acquire(blocking=False)
        except Timeout:
            if found := _read(record):
                yield found
            continue
        record.unlink(missing_ok=True)
        lock.release()


def _lock(folder: Path, name: str) -> FileLock:
    # thread_local=False: any thread may release the lock.
    return FileLock(folder / f"{name}.lock", mode=PRIVATE, thread_local=False)


def _read(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}  # the holder has not written it yet, or is just removing it
    return record if isinstance(record, dict) else {}
