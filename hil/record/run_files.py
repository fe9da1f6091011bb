"""The files of a recording: a new one begins when the current one is long enough, cannot be written, or was removed.

Rows stay in the ring until they are safe in a file, so the next file begins where the last one ended. While no file can
be written, the newest half of the ring is kept for later; older rows are lost, and counted.
"""

import errno
import os
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from hil.core.errors import remedy
from hil.core.outputs import release
from hil.record import viewing
from hil.record.files import (
    ROOM_BYTES,
    NoRoomError,
    Rotation,
    check_quota,
    check_writable,
    has_end,
    numbered_path,
    why_not_written,
)
from hil.record.ring import MOST_FILES, RingReader, Rows

if TYPE_CHECKING:
    from hil.record.mcap_file import McapFile
    from hil.record.stream import Stream

BATCH_ROWS = 1000
Record = dict[str, Any]
_FIRST_BACK_OFF_S = 0.5
_LONGEST_BACK_OFF_S = 8.0
_LOOK_EVERY_S = 0.5  # after the room in the folder


class RefusedError(Exception):
    """The recorder cannot do what its config asks for; the text is a sentence for the user."""


RunFile: TypeAlias = "McapFile | Stream"


class RunFiles:
    """Writes the rows in the ring and the events to the file that ``config`` names, then to the files that follow it.

    Raises RefusedError when the first file of a run cannot be opened.

    Attributes:
        trouble: the newest reason why a file could not be written; failing: why nothing can be written at present.
        summary_trouble: why the run's summary is in none of the files. Each is None if there is no reason.
    """

    def __init__(self, config: Record, ring: RingReader) -> None:
        self.trouble: str | None = None
        self.failing: str | None = None
        self.summary_trouble: str | None = None
        self._config = config
        self._path = Path(config["path"])
        self._rotation = Rotation(*config["rotate"])
        self._is_held = False  # because the quota is used up; the file stays open
        self._look_s = 0.0
        self._ring = ring
        self._t_column = config["signals"].index("loop.t_s")
        self._events: list[tuple[float, str, str]] = []
        self._file: RunFile | None = None
        self._file_path = self._path
        self._identity: tuple[int, int] | None = None
        self._begun_s: float | None = None
        # Files that could not be written are kept and never closed: rerun may wait forever to close one on a full disk.
        # If a file was opened only in part, rerun's error holds it.
        self._abandoned: list[object] = []
        self._next_try_s = self._back_off_s = 0.0
        try:
            self._open()
        except (RuntimeError, OSError) as error:
            if not config["restarts"]:
                reason, helps = getattr(error, "strerror", None) or error, "choose a path that can be written"
                helps = remedy(error, helps) if isinstance(error, OSError) else helps
                raise RefusedError(f"recording {self._path}: {reason}; {helps}") from error
            self._give_up(error)

    def event(self, t_s: float, level: str, text: str) -> None:
        """Take a line of the event log; it is written with the next rows, or by ``check``."""
        self._events.append((t_s, level, text))

    def check(self) -> None:
        """Write waiting events, look after the room, and begin a new file if the current one was removed."""
        if time.monotonic() >= self._look_s:
            self._look_s = time.monotonic() + _LOOK_EVERY_S
            self._look_after_room()
        if self._events or (self._file is not None and _identity(self._file_path) != self._identity):
            self._write(lambda _file: None)

    def write_until(self, stop: int) -> None:
        """Write the rows of the ring before ``stop``, and release those that are safe."""
        while (start := self._ring.tail) < stop:
            rows = self._of_one_file(self._ring.rows(start, min(stop, start + BATCH_ROWS)))
            end = start + len(rows)
            if self._write(lambda file, rows=rows, start=start: file.rows(rows, start)):  # type: ignore[misc]
                self._ring.release(end)
                if (size_bytes := self._rotation.size_bytes) is not None and _size_bytes(self._file_path) >= size_bytes:
                    self._end()
            elif self._ring.head - start > self._ring.capacity // 2:
                self._ring.give_up(end)
            else:
                return

    def finish(self, summary: Record | None) -> None:
        """Write all rows in the ring and close the file; with a summary, rows that cannot be written now are lost."""
        self._is_held = False  # the last rows belong to the others
        self._next_try_s = 0.0
        self.write_until(self._ring.head)
        if self._ring.tail < self._ring.head:  # the file failed at the last rows: try the next one
            self._next_try_s = 0.0
            self.write_until(self._ring.head)
        if summary is None:
            # The run may go on: rows that came meanwhile are left for the process that replaces this one.
            self._finish_file(None)
            return
        self._ring.give_up(self._ring.head)
        if not self._finish_file(summary) and not self._finish_file(summary):  # the second try writes a new file
            self.summary_trouble = f"its summary could not be written: {self.trouble}"

    def _look_after_room(self) -> None:
        """Write nothing while the quota is used up; rows wait in the ring meanwhile."""
        try:
            check_quota(self._file_path.parent, self._config["quota_bytes"])
        except NoRoomError as error:
            self._is_held = True
            self.failing = self.trouble = why_not_written(self._file_path, error)
        except OSError:
            pass  # a disk that cannot be read, or written, is known by writing
        else:
            self._is_held = False

    def _finish_file(self, summary: Record | None, next_number: int | None = None) -> bool:
        """Write the end of the file and close it; False when that could not be written."""
        self._next_try_s = 0.0
        if not self._write(lambda file: file.finish(summary, self._counts(next_number))):
            return False
        self._write(lambda file: file.close(), flush=False)
        if not has_end(self._file_path, self._file_path.suffix):
            trouble = f"the index at the end of {self._file_path.name} could not be written"
            self.trouble = trouble if self.trouble is None else f"{self.trouble}; {trouble}"
        return True

    def _counts(self, next_number: int | None) -> dict[str, int]:
        ring = self._ring
        kept = ring.files()
        gone = [kept[number].rows for number in kept if not numbered_path(self._path, number).exists()]
        written = ring.saved - sum(gone)
        counts = {
            "rows_written": written,
            "rows_dropped": ring.dropped,
            "rows_lost": ring.tail - written,
            "rows_in_part": kept[max(kept)].rows,
            "rows_until": ring.tail,
        }
        return counts if next_number is None else {**counts, "next_part": next_number}

    def _write(self, write: Callable[[RunFile], None], *, flush: bool = True) -> bool:
        """Write waiting events to the file, then call ``write`` with it; False when that failed.

        Without a file the next one is opened first, unless the pause after the last failure is not over.
        """
        if self._is_held or (self._file is None and time.monotonic() < self._next_try_s):
            return False
        try:
            file = self._file or self._open()
            for event in self._events:
                file.event(*event)
            write(file)
            if flush:
                file.flush()
                self._check_there()
        except (RuntimeError, OSError) as error:
            self._give_up(error)
            return False
        self.failing = None
        self._ring.add_lines_saved(len(self._events))
        self._events.clear()
        return True

    def _open(self) -> RunFile:
        number = self._next_number()
        path = numbered_path(self._path, number)
        if number > 1:
            path.parent.mkdir(parents=True, exist_ok=True)
        check_quota(path.parent, self._config["quota_bytes"])
        if number > 1 and shutil.disk_usage(path.parent).free < ROOM_BYTES:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        # rerun may wait for ever for a file of which it cannot write the beginning.
        if os.access(path.parent, os.W_OK):
            check_writable(path.parent)
        part = {
            "recording_id": self._config["recording_id"],
            "number": number,
            "first_row": self._ring.tail,
            "first_event": self._ring.lines_saved,
        }
        # The run has made the first file. A later one must be new: two processes may want the same name at the same
        # time.
        if number > 1:
            path.open("xb").close()
        try:
            self._file = file = _open_file(path, self._config, part)
        except (RuntimeError, OSError):
            release(path)
            raise
        self._ring.begin_file(number)
        self._identity = _identity(path)
        self._file_path = path
        return file

    def _next_number(self) -> int:
        """Return the number of the next file; a number whose file exists is skipped: that file is another run's."""
        number = self._ring.file_number + 1
        while number > 1 and numbered_path(self._path, number).exists():
            number += 1
        return number

    def _give_up(self, error: Exception) -> None:
        """Stop writing to the file; the next one is tried after a pause, which doubles with each failure."""
        self.trouble = why_not_written(numbered_path(self._path, max(1, self._ring.file_number)), error)
        self.failing = self.trouble
        if isinstance(error, RuntimeError):
            self._abandoned.append(error)
        if self._file is not None:
            self._abandoned.append(self._file)
            self._file = None
            self._back_off_s = _FIRST_BACK_OFF_S
        self._next_try_s = time.monotonic() + self._back_off_s
        self._back_off_s = min(max(2 * self._back_off_s, _FIRST_BACK_OFF_S), _LONGEST_BACK_OFF_S)

    def _check_there(self) -> None:
        """Raise FileNotFoundError, and count the file's rows as lost, when it has been removed."""
        if _identity(self._file_path) != self._identity:
            self._ring.lose_file()
            raise FileNotFoundError(errno.ENOENT, f"{self._file_path.name} was removed")

    def _of_one_file(self, rows: Rows) -> Rows:
        """Close the file if its duration is over before these rows; return as many of them as one file may have."""
        duration_s = self._rotation.duration_s
        if duration_s is None:
            return rows
        t_s = rows[:, self._t_column]
        if self._file is not None and self._begun_s is not None and t_s[0] - self._begun_s >= duration_s:
            self._end()
        if self._file is None or self._begun_s is None:
            self._begun_s = float(t_s[0])
        return rows[: max(1, int(np.searchsorted(t_s - self._begun_s, duration_s)))]

    def _end(self) -> None:
        """Close the file, unless ``MOST_FILES`` is reached; the next rows open the next file."""
        if self._ring.file_number < MOST_FILES:
            self._finish_file(None, self._next_number())
            self._file = None
            self._next_try_s = self._back_off_s = 0.0


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _size_bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _open_file(path: Path, config: Record, part: Mapping[str, Any]) -> RunFile:
    columns = {name: config[name] for name in ("signals", "properties")}
    if path.suffix == ".mcap":
        from hil.record.mcap_file import McapFile

        frames = viewing.part("frames", config["viewer"])
        return McapFile(path, int(config["zero_unix_ns"]), part=part, make_frames=frames, **columns)
    # Only here, and for live viewers: a machine for which there is no rerun records to .mcap.
    import rerun as rr

    from hil.record.stream import Stream

    rr.set_strict_mode(True)
    identity = {"recording_id": config["recording_id"], "part": part}
    drawing = viewing.part("drawing", config["viewer"])
    return Stream(rr.FileSink(path), path=path, make_drawing=drawing, **identity, **columns)
