"""The outcomes of a batch in a folder, a line of JSON for each, that a kill at any time leaves whole.

    DIR/rows.jsonl           a row for each job that is done; of two with one key the later one counts
    DIR/campaign.json        what a campaign is, and its runs, for its report
    DIR/recordings/KEY.rrd   recordings that are kept

A row is synced to the disk before it is counted. The last member of a line is the CRC-32 of the text before it.
"""

import contextlib
import json
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

from filelock import FileLock, Timeout

from hil.addons.batch.columns import KEY
from hil.addons.batch.job import Outcome, plain
from hil.addons.batch.pool import Plan, run_plan
from hil.core.errors import BadInputError
from hil.core.outputs import whole_file

ABOUT, ROWS, RECORDINGS = "campaign.json", "rows.jsonl", "recordings"
RECORDING_SUFFIX = ".rrd"
_LOCK = "lock"
_ABOUT = {"name", "scenario", "laws", "faults", "seeds", "samples", "axes", "keep", "runs", "plan"}
_CRC = ', "crc32": '
Row = Mapping[str, Any]


class Store:
    """The outcomes in a folder, for the one process that adds to them; a context manager.

    Raises BadInputError when the folder cannot be made or written to, or is in use.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = FileLock(folder / _LOCK, timeout=0)
        with _writing(folder):
            (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
            try:
                self._lock.acquire()
            except Timeout:
                raise BadInputError(
                    f"folder {folder}: another process writes to it; wait for its end, or name another with --out"
                ) from None
            rows = folder / ROWS
            rows.touch()
            # A kill may have left a part of a row.
            os.truncate(rows, rows.read_bytes().rfind(b"\n") + 1)

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows; when this returns they are on the disk. Raises BadInputError when they cannot be written."""
        left = memoryview("".join(map(_line, rows)).encode())
        with _writing(self.folder), (self.folder / ROWS).open("ab", buffering=0) as file:
            end = file.seek(0, os.SEEK_END)
            try:
                while left:
                    left = left[file.write(left) :]
                os.fsync(file.fileno())
            except BaseException:
                file.truncate(end)
                raise

    def begin(self, about: Mapping[str, Any]) -> None:
        """Write the description of a campaign. Raises BadInputError when that cannot be written."""
        with _writing(self.folder), whole_file(self.folder / ABOUT, existing="replace") as file:
            file.write_text(json.dumps(about, indent=1), encoding="utf-8")

    def without_recording(self, key: str) -> str:
        """Return the file for a job's recording; an older one, as of a run that was killed, is removed.

        Raises BadInputError when that fails.
        """
        file = self.folder / RECORDINGS / (key + RECORDING_SUFFIX)
        with _writing(self.folder):
            file.unlink(missing_ok=True)
        return str(file)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release the folder for other processes."""
        self._lock.release()


def run_resumable(
    plan: Plan, folder: Path, workers: int | None = None, on_outcomes: Callable[[], None] = lambda: None
) -> None:
    """Do those jobs of a plan that a folder does not have the outcomes of, and add theirs.

    ``on_outcomes`` is called at least twice a second. Raises BadInputError when the folder cannot be written to or is
    in use, LinkError as ``run_plan``.
    """
    with Store(folder) as store:
        known = {key: Outcome(**row) for key, row in read_rows(folder).items()}
        with contextlib.closing(run_plan(plan, workers, known)) as done:
            for outcomes in done:
                store.append([plain(outcome) for outcome in outcomes if outcome.key not in known])
                on_outcomes()


def check_folder(folder: Path, about: Mapping[str, Any]) -> None:
    """Raise BadInputError for a folder of another campaign."""
    if folder.is_file():
        raise BadInputError(f"folder {folder}: it is a file; name a folder with --out")
    if (folder / ABOUT).exists():
        there = read_about(folder)
        for what in ("name", "scenario"):
            if there[what] != about[what]:
                raise BadInputError(
                    f"folder {folder}: its {what} is {there[what]!r}, and that of this campaign is "
                    f"{about[what]!r}; name another folder with --out"
                )


def read_about(folder: Path) -> dict[str, Any]:
    """Return the description of a folder's campaign. Raises BadInputError when it cannot be read."""
    file = folder / ABOUT
    try:
        about = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(about, dict) or not about.keys() >= _ABOUT:
            raise ValueError("it has other content")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise BadInputError(
            f"file {file}: it cannot be read ({why}); remove it if it is there, and give hil campaign with its plan "
            "once more, which writes it anew"
        ) from error
    return about


def read_rows(folder: Path, damaged: list[str] | None = None) -> dict[str, Row]:
    """Return the rows in a folder by their keys, also while a process adds to them.

    With a list ``damaged`` a damaged row is left out, and a sentence on it is added there. Raises BadInputError when
    there are no results, or a row is damaged.
    """
    file = folder / ROWS
    if not file.is_file():
        raise BadInputError(f"folder {folder}: it holds no results; give the folder of hil campaign --out")
    rows: dict[str, Row] = {}
    whole = file.read_bytes().rpartition(b"\n")[0]  # a process may be writing the last one
    for number, line in enumerate(whole.split(b"\n") if whole else (), 1):
        if (row := _row(line)) is not None:
            rows[row[KEY]] = row
            continue
        sentence = f"file {file}: line {number} is damaged; remove it, and the same command does its run again"
        if damaged is None:
            raise BadInputError(sentence)
        damaged.append(f"{sentence}; it is left out")
    return rows


def _line(row: Row) -> str:
    text = json.dumps(row)
    return f"{text[:-1]}{_CRC}{zlib.crc32(text.encode())}}}\n"


def _row(line: bytes) -> Row | None:
    """Return the row of a line without its newline; None where the line is damaged."""
    try:
        row = json.loads(line)
        text = line[: line.rindex(_CRC.encode())] + b"}"
        return row if row.pop("crc32") == zlib.crc32(text) else None
    except (ValueError, AttributeError, KeyError):
        return None


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Raise BadInputError when a write fails; it says that the earlier writes are safe."""
    try:
        yield
    except OSError as error:
        raise BadInputError(
            f"folder {folder}: it cannot be written to ({error.strerror or error}); what was written is safe: "
            "make room, or make it writable, and give the same command again"
        ) from error
