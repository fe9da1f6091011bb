"""The outcomes of a batch in a folder: small Parquet files, one row a job, that a kill at any time leaves whole.

    DIR/plan.parquet         the jobs that the batch has
    DIR/campaign.json        what the batch is, for its report
    DIR/rows/*.parquet       one row for each job that is done; together one dataset
    DIR/rows_of_other_plans  rows of runs that the plan no longer has
    DIR/recordings/KEY.rrd   recordings that are kept

A file is written under another name, synced to the disk, and renamed. Many small files of rows are merged into one,
whose metadata names them: files that a kill leaves beside it are removed when the folder is opened.
"""

import contextlib
import itertools
import json
import shutil
import time
import uuid
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import pyarrow as pa
from filelock import FileLock, Timeout

from hil.batch.row_files import (
    REPLACES,
    UNFINISHED,
    concatenated,
    damage_of,
    joined,
    keys_of,
    merged_into,
    parted,
    read_table,
    reason,
    row_files,
    schema_of,
    size_class,
    write_bytes,
    write_parquet,
)
from hil.core.errors import BadInputError

PLAN, ABOUT, ROWS, RECORDINGS = "plan.parquet", "campaign.json", "rows", "recordings"
OTHER_ROWS = "rows_of_other_plans"
RECORDING_SUFFIX = ".rrd"
_MOST_OF_A_SIZE = 32
_LOCK = "lock"
_OURS = (ROWS, OTHER_ROWS, RECORDINGS, _LOCK, PLAN, ABOUT, "report.html")
_ABOUT = {"name", "scenario", "laws", "faults", "seeds", "samples", "axes", "keep", "by", "runs"}
_ANEW = "give hil campaign with its plan once more, which writes it anew"
_ATTEMPTS = 10
_REST, _LONGEST_REST_S = 9.0, 0.5
"""After rows were added no more are added for this many times as long as that took, but not for longer than this."""
Row = Mapping[str, Any]


class Store:
    """The outcomes in a folder, for the one process that adds to them; a context manager.

    ``schema`` has the columns of a row; what a row does not have is null.

    Raises BadInputError when the folder cannot be made or written to, has a damaged file, or is in use.

    Attributes:
        scratch: a folder for files of this process; what a kill leaves there is removed with the next one.
    """

    def __init__(self, folder: Path, schema: pa.Schema) -> None:
        self.folder = folder
        self._schema = schema
        self._rows = folder / ROWS
        self._other_rows = folder / OTHER_ROWS
        self.scratch = folder / (RECORDINGS + UNFINISHED)
        self._rested_s = 0.0
        with _writing(folder):
            (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
            self._rows.mkdir(exist_ok=True)
            self._lock = FileLock(folder / _LOCK)
            try:
                self._lock.acquire(timeout=0)
            except Timeout:
                raise BadInputError(
                    f"folder {folder}: another process writes to it; wait for its end, or name another with --out"
                ) from None
        try:
            with _writing(folder):
                self._tidy()
                self.scratch.mkdir()
            self._check_columns()
        except BaseException:
            self._lock.release()
            raise

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows; when this returns they are on the disk. Raises BadInputError when they cannot be written."""
        if rows:
            began_s = time.monotonic()
            with _writing(self.folder):
                self._write(pa.Table.from_pylist(list(rows), schema=self._schema), 0)
                self._merge()
            ended_s = time.monotonic()
            self._rested_s = ended_s + min(_REST * (ended_s - began_s), _LONGEST_REST_S)

    @property
    def is_rested(self) -> bool:
        """Whether rows may be added again without most of the time going into files; a file costs as much as a run."""
        return time.monotonic() >= self._rested_s

    def drop(self, keys: Collection[str]) -> None:
        """Remove rows with their recordings. If the process is killed meanwhile, either all of the rows stay or none.

        Raises BadInputError when the folder cannot be written to.
        """
        files = row_files(self._rows)
        if not keys or not files:
            return
        others = parted(concatenated(files), keys)[1]
        with _writing(self.folder):
            for key in keys:
                for recording in (self.folder / RECORDINGS).glob(f"{key}.*"):
                    recording.unlink()
            self._replace(files, others, max(map(size_class, files)))

    def sort(self, keys: Collection[str]) -> None:
        """Let ``rows`` hold the rows of these jobs alone: others are set aside, and come back when they are wanted.

        A kill meanwhile loses no row. Raises BadInputError when the folder cannot be written to.
        """
        files, other_files = row_files(self._rows), row_files(self._other_rows)
        here, others = concatenated(files), concatenated(other_files)
        wanted, away = parted(here, keys)
        others = parted(others, keys_of(here))[1]  # a kill may have left copies of rows that are here
        back, elsewhere = parted(others, keys)
        if not (back.num_rows or away.num_rows):
            return
        with _writing(self.folder):
            self._other_rows.mkdir(exist_ok=True)
            copies = self._replace(other_files, joined([others, away]), 0, self._other_rows)
            self._replace(files, joined([wanted, back]), max(map(size_class, files), default=0))
            self._replace([copies], joined([elsewhere, away]), 0, self._other_rows)

    def begin(self, plan: pa.Table, about: Mapping[str, Any]) -> None:
        """Write the plan and the description of the batch. Raises BadInputError when that cannot be written."""
        with _writing(self.folder):
            write_parquet(plan, self.folder / PLAN)
            write_bytes(json.dumps(about, indent=1).encode(), self.folder / ABOUT)

    def keep_recording(self, key: str, recording: Path) -> None:
        """Move a job's recording into the folder. Raises BadInputError when it cannot be written."""
        with _writing(self.folder):
            write_bytes(recording.read_bytes(), self.folder / RECORDINGS / (key + RECORDING_SUFFIX))
            recording.unlink()

    def recorded(self) -> set[str]:
        """Return the keys of the jobs whose recordings are in the folder."""
        return {path.stem for path in (self.folder / RECORDINGS).glob(f"*{RECORDING_SUFFIX}")}

    def remove_recording(self, key: str) -> None:
        """Remove a job's recording."""
        (self.folder / RECORDINGS / (key + RECORDING_SUFFIX)).unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Release the folder for other processes."""
        shutil.rmtree(self.scratch, ignore_errors=True)
        self._lock.release()

    def _tidy(self) -> None:
        """Remove what a kill has left: unfinished files, and those that were merged into another."""
        if self.scratch.exists():
            shutil.rmtree(self.scratch)
        for unfinished in [*self.folder.glob(f"*{UNFINISHED}"), *self.folder.glob(f"*/*{UNFINISHED}")]:
            unfinished.unlink()
        for rows in (self._rows, self._other_rows):
            for name in {name for file in row_files(rows) for name in merged_into(file)}:
                (rows / name).unlink(missing_ok=True)

    def _check_columns(self) -> None:
        for file in row_files(self._rows):
            there = schema_of(file)
            for name in set(there.names) & set(self._schema.names):
                if there.field(name).type != self._schema.field(name).type:
                    raise BadInputError(
                        f"folder {self.folder}: the runs there have {name} as {there.field(name).type}, and "
                        f"now it is {self._schema.field(name).type}; name another folder with --out"
                    )

    def _write(self, table: pa.Table, size: int, folder: Path | None = None) -> Path:
        path = (folder or self._rows) / f"{size}-{uuid.uuid4().hex}.parquet"
        write_parquet(table, path)
        return path

    def _merge(self) -> None:
        """Merge files of one size into one of the next, as soon as there are many."""
        for size, files in itertools.groupby(sorted(row_files(self._rows), key=size_class), size_class):
            if len(some := list(files)) >= _MOST_OF_A_SIZE:
                self._replace(some, concatenated(some), size + 1)

    def _replace(self, files: Sequence[Path], table: pa.Table, size: int, folder: Path | None = None) -> Path:
        """Write a table in place of files. Its metadata names them, so that files left by a kill are ignored."""
        names = json.dumps([file.name for file in files]).encode()
        path = self._write(table.replace_schema_metadata({REPLACES: names}), size, folder)
        for file in files:
            file.unlink()
        return path


def check_folder(folder: Path, about: Mapping[str, Any]) -> None:
    """Raise BadInputError for a folder that exists, is not empty, and is not that of this batch."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise BadInputError(f"folder {folder}: it is a file; name a folder with --out")
    if (folder / ABOUT).exists():
        there = read_about(folder)
        for what in ("name", "scenario"):
            if there[what] != about[what]:
                raise BadInputError(
                    f"folder {folder}: its {what} is {there[what]!r}, and that of this campaign is "
                    f"{about[what]!r}; name another folder with --out"
                )
        return
    strange = sorted(path.name for path in folder.iterdir() if path.name.removesuffix(UNFINISHED) not in _OURS)
    if strange:
        raise BadInputError(
            f"folder {folder}: it holds {strange[0]}, and no campaign; name an empty or a new one with --out"
        )


def read_about(folder: Path) -> dict[str, Any]:
    """Return the description of a folder's batch. Raises BadInputError when it cannot be read."""
    file = folder / ABOUT
    try:
        about = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(about, dict) or not about.keys() >= _ABOUT:
            raise ValueError("it has other content")
    except (OSError, ValueError) as error:
        raise BadInputError(
            f"file {file}: it cannot be read ({reason(error)}); remove it if it is there, and {_ANEW}"
        ) from error
    return about


def read_plan(folder: Path) -> list[dict[str, Any]]:
    """Return the planned jobs of a folder, as rows. Raises BadInputError when they cannot be read."""
    file = folder / PLAN
    if not file.is_file():
        raise BadInputError(f"file {file}: there is no such file; {_ANEW}")
    return list(read_table(file, _ANEW).to_pylist())


def read_rows(folder: Path, rows: str = ROWS, damaged: list[str] | None = None) -> pa.Table:
    """Return all rows in a folder, one for each key, also while a process adds to them.

    ``rows`` is ``OTHER_ROWS`` for those of runs that the plan no longer has. With a list ``damaged`` a damaged file is
    left out, and a sentence on it is added there.

    Raises BadInputError when there is no batch, or a file of it is damaged.
    """
    place = folder / rows
    if rows == ROWS and not place.is_dir():
        raise BadInputError(f"folder {folder}: it holds no results; give the folder of hil campaign --out")
    for _ in range(_ATTEMPTS):
        files = row_files(place)
        try:
            if damaged is not None:
                told = {file: sentence for file in files if (sentence := damage_of(file)) is not None}
                files, damaged[:] = [file for file in files if file not in told], told.values()
            merged = {name for file in files for name in merged_into(file)}
            return concatenated([file for file in files if file.name not in merged])
        except FileNotFoundError:
            continue  # a campaign under way has just merged them into another
    raise BadInputError(f"folder {folder}: its files change while they are read; try again")


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Raise BadInputError, which says that what was written is safe, when something cannot be written."""
    try:
        yield
    except OSError as error:
        raise BadInputError(
            f"folder {folder}: it cannot be written to ({error.strerror or error}); what was written is safe: "
            "make room, or make it writable, and give the same command again"
        ) from error
