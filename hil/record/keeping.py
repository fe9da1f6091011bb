"""How much a folder of recordings may hold, how long, and what gives way when there is no room."""

import contextlib
import errno
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import apart

_SUFFIXES = (".rrd", ".mcap")
_MOST_OF_A_PART_BYTES = 1_000_000_000
_PARTS = 8  # that a quota has room for at least, so that little is removed at once
ROOM_BYTES = 16 << 20
"""A new part of a recording is begun on a disk that has this much room."""
_SPARE_BYTES = 2 * ROOM_BYTES


class _File(NamedTuple):
    written_s: float
    size_bytes: int
    path: Path


class NoRoomError(OSError):
    """A quota is used up. Its ``strerror`` is a sentence for the user, with the remedy."""


class Keeping(NamedTuple):
    """What the folder of a recording may hold. Only files ``.rrd`` and ``.mcap`` in the folder itself count.

    Attributes:
        quota_bytes: of all of them together; None for no limit.
        age_s: those last written longer ago are removed; None for never.
        newest: whether the oldest are removed when quota or disk are full. Otherwise nothing more is recorded then.
    """

    quota_bytes: int | None = None
    age_s: float | None = None
    newest: bool = False

    @property
    def removes(self) -> bool:
        """Whether older recordings, or older parts of this one, may be removed."""
        return self.newest or self.age_s is not None

    def part_bytes(self, rotate_bytes: int | None) -> int | None:
        """Return the size at which a recording continues in the next file: where the oldest give way, there is one."""
        if not self.newest:
            return rotate_bytes
        sizes = (rotate_bytes, _MOST_OF_A_PART_BYTES, None if self.quota_bytes is None else self.quota_bytes // _PARTS)
        return min(size for size in sizes if size is not None)

    def make_room(self, current: Path) -> None:
        """Remove what is too old from the folder of the file ``current``, and what has to give way; never that file.

        Raises NoRoomError when the quota is used up all the same, and OSError when a file cannot be removed.
        """
        if self == Keeping():
            return
        folder = current.parent
        files = sorted(_files(folder))
        others = [one for one in files if one.path.name != current.name]
        used = sum(one.size_bytes for one in files)
        oldest_s = -1.0 if self.age_s is None else time.time() - self.age_s
        for one in others:
            is_over = self._is_over(used) or shutil.disk_usage(folder).free < _SPARE_BYTES
            if one.written_s >= oldest_s and not (self.newest and is_over):
                break
            one.path.unlink(missing_ok=True)
            used -= one.size_bytes
        if self._is_over(used):
            assert self.quota_bytes is not None
            quota_gb = self.quota_bytes / 1e9
            raise NoRoomError(
                errno.EDQUOT,
                f"the recordings in {folder} take {apart(used / 1e9, quota_gb)} GB, and {quota_gb:g} GB are allowed; "
                "remove some, or allow more",
            )

    def _is_over(self, used_bytes: int) -> bool:
        return self.quota_bytes is not None and used_bytes > self.quota_bytes


def _files(folder: Path) -> Iterator[_File]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(_SUFFIXES) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(FileNotFoundError):  # removed meanwhile
                    status = entry.stat(follow_symlinks=False)
                    yield _File(status.st_mtime, status.st_size, folder / entry.name)
