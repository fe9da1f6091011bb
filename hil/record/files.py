"""Output files of a run: their names, checks that they can be written, when they continue, and their quota."""

import contextlib
import errno
import os
import re
import tempfile
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import BadInputError, apart
from hil.core.outputs import Existing, check_free, free_name

EXPECTED_FILE = "an .rrd or .mcap file made by 'hil run --record'"
OUTPUTS = {
    "recording": (".rrd", ".mcap"),
    "trace": (".blf", ".asc", ".log"),
    "page": (".html",),
    "export": (".csv", ".parquet"),
    "urdf": (".urdf",),
}
"""The kinds of output file, each with its extensions. A trace has Vector's formats, or that of ``candump -L``."""
_MAGICS = {".rrd": b"RRF2", ".mcap": b"\x89MCAP0\r\n"}
_ENDS = {".rrd": (b"RRF2FOOT", 4), ".mcap": (b"\x89MCAP0\r\n", 0)}  # and the bytes after it
_BEGINNING_BYTES = 1 << 18  # larger than what a recording writes first
_PROBE_BYTES = 1 << 20
ROOM_BYTES = 16 << 20
"""A new part of a recording is begun on a disk that has this much room."""
_SMALLEST_BYTES = 1_000_000


def check_output_path(what: str, path: Path, existing: Existing = "refuse") -> None:
    """Raise BadInputError unless this file can be written. Nothing is made or changed.

    ``what`` is the kind of file, a key of ``OUTPUTS``; ``existing`` says what to do if the file exists. A file that is
    named like a later part of another recording (``RUN-2.rrd``) is never replaced.
    """
    folder = path.absolute().parent
    *others, last = OUTPUTS[what]
    if path.suffix not in OUTPUTS[what]:
        problem = f"its name must end in {', '.join(others)}{' or ' * bool(others)}{last}, which tells its format"
    elif not str(path).isprintable():
        raise BadInputError(
            f"{what} {str(path)!r}: its name has a character that cannot be printed; choose another name"
        )
    elif path.is_dir():
        problem = "it is a folder; name a file in it"
    elif path.is_fifo() or path.is_socket():
        problem = "it is a pipe or a socket; name a file"
    elif existing != "number" and (first := _first_file(path)) is not None:
        problem = f"by its name it is a later part of {first.name}; choose another name, or remove it before"
    elif not folder.is_dir():
        problem = f"there is no folder {folder}; make it, or choose another path"
    elif existing == "replace" and path.exists() and not os.access(path, os.W_OK):
        problem = f"it is not writable; choose another path, or no {what}"
    elif not os.access(folder, os.W_OK) and not (existing == "replace" and path.exists()):
        problem = f"{folder} is not writable; choose another path, or no {what}"
    else:
        check_free(what, path, existing)
        return
    raise BadInputError(f"{what} {path}: {problem}")


def _first_file(path: Path) -> Path | None:
    """Return the recording of which an existing file is a later part by its name, and so must not be replaced."""
    name = re.fullmatch(r"(.+)-([1-9]\d*)", path.stem)
    if name is None or int(name[2]) < 2 or path.suffix not in _MAGICS or not path.exists():
        return None
    first = path.with_name(name[1] + path.suffix)
    return first if first.exists() else None


class NoRoomError(OSError):
    """A quota is used up. Its ``strerror`` is a sentence for the user, with the remedy."""


def check_quota(folder: Path, quota_bytes: int | None) -> None:
    """Raise NoRoomError when the files ``.rrd`` and ``.mcap`` in a folder take more than a quota; None is no limit."""
    if quota_bytes is None:
        return
    used_bytes = 0
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(tuple(_MAGICS)) and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(FileNotFoundError):  # removed meanwhile
                    used_bytes += entry.stat(follow_symlinks=False).st_size
    if used_bytes > quota_bytes:
        quota_gb = quota_bytes / 1e9
        raise NoRoomError(
            errno.EDQUOT,
            f"the recordings in {folder} take {apart(used_bytes / 1e9, quota_gb)} GB, and {quota_gb:g} GB are allowed; "
            "remove some, or allow more",
        )


def check_writable(folder: Path, size_bytes: int = _BEGINNING_BYTES) -> None:
    """Raise OSError unless a file of this size can be written in the folder; the trial file is removed."""
    with tempfile.TemporaryFile(dir=folder) as probe:
        probe.write(bytes(size_bytes))


def why_not_written(path: Path, error: Exception) -> str:
    """Return as text why writing to an open file failed.

    rerun's errors lack the system's reason. For them this tries to write in the same folder, which gives the reason.
    """
    if not isinstance(error, OSError):
        try:
            check_writable(path.parent, _PROBE_BYTES)
        except OSError as reason:
            error = reason
    if not isinstance(error, OSError):
        return str(error)
    if isinstance(error, NoRoomError):
        return error.strerror or str(error)
    what = "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else "it could not be written any more"
    return f"{what} ({error.strerror})"


def check_is_recording(path: Path) -> str:
    """Return the format of a recording, ``.rrd`` or ``.mcap``, by its first bytes.

    Raises BadInputError for a file that cannot be read or begins with other bytes.
    """
    try:
        with path.open("rb") as file:
            start = file.read(max(map(len, _MAGICS.values())))
    except OSError as error:
        hint = f"; there is {parts[0]}, a later part of it" if (parts := later_files(path)) else ""
        raise BadInputError(f"{path}: {error.strerror}; expected {EXPECTED_FILE}{hint}") from error
    if not start:
        raise BadInputError(f"{path}: the file is empty; expected {EXPECTED_FILE}")
    for kind, magic in _MAGICS.items():
        if start.startswith(magic):
            return kind
    raise BadInputError(f"{path}: not a recording; expected {EXPECTED_FILE}")


def numbered_path(path: Path, number: int) -> Path:
    """Return the file of a recording's part: RUN.rrd is the first, RUN-2.rrd the second."""
    return path if number == 1 else path.with_name(f"{path.stem}-{number}{path.suffix}")


def has_end(path: Path, kind: str) -> bool:
    """Whether a recording ends with the index of its format, ``.rrd`` or ``.mcap``."""
    end, following = _ENDS[kind]
    try:
        with path.open("rb") as file:
            file.seek(-len(end) - following, os.SEEK_END)
            return file.read(len(end)) == end
    except OSError:
        return False


def later_files(path: Path) -> list[Path]:
    """Return the files beside a recording that by their names are later parts of it, in order."""
    name = re.compile(rf"{re.escape(path.stem)}-([1-9]\d*){re.escape(path.suffix)}")
    others = path.parent.iterdir() if path.parent.is_dir() else ()
    found = {int(match[1]): other for other in others if (match := name.fullmatch(other.name))}
    return [found[number] for number in sorted(found) if number > 1]


RUNS = Path("runs")
"""The folder of recordings for which no other is named."""


def make_folder(folder: Path, remedy: str) -> None:
    """Make a folder of recordings, if it is missing. Raises BadInputError, whose message ends with ``remedy``."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise BadInputError(
            f"recording folder {folder.absolute()}: it cannot be made ({error.strerror}); {remedy}"
        ) from error


def new_in_runs(name: str, suffix: str, remedy: str, folder: Path = RUNS) -> Path:
    """Return the path of a new file ``runs/NAME-TIMESUFFIX``; the folder is made if missing.

    Raises BadInputError, whose message ends with ``remedy``, when the folder cannot be made.
    """
    make_folder(folder, remedy)
    return free_name(folder / f"{name}-{datetime.now():%Y%m%d-%H%M%S-%f}{suffix}")  # noqa: DTZ005 - the user's own time


class Rotation(NamedTuple):
    """When a recording continues in the next file: at a size, or after a scenario time."""

    size_bytes: int | None = None
    duration_s: float | None = None


def rotation(text: str) -> Rotation:
    """Read a rotation as a user writes it: ``1GB``, ``10min``, or ``none``.

    Raises BadInputError for anything else, and for parts of less than 1 MB or 1 s.
    """
    sizes, times = {"kb": 1e3, "mb": 1e6, "gb": 1e9}, {"s": 1.0, "min": 60.0, "h": 3600.0}
    if text == "none":
        return Rotation()
    match = re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([a-z]+)\s*", text.lower())
    if match is None or match[2] not in sizes | times:
        raise BadInputError(f"rotate {text!r}: expected a size or a time, as in 1GB or 10min, or none")
    most = float(match[1]) * (sizes | times)[match[2]]
    if most < (_SMALLEST_BYTES if match[2] in sizes else 1.0):
        raise BadInputError(f"rotate {text!r}: expected at least 1MB or 1s for a part")
    return Rotation(size_bytes=round(most)) if match[2] in sizes else Rotation(duration_s=most)
