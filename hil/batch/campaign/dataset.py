"""The results of a campaign: a folder of small Parquet files, one row a run, that a kill at any time leaves whole.

    DIR/plan.parquet         the runs that the campaign has: key, axes, law, fault, seed
    DIR/campaign.json        what the campaign is, for its report
    DIR/rows/*.parquet       one row for each run that is done; together one dataset
    DIR/recordings/KEY.rrd   recordings that are kept

A file is written under another name, brought to the disk, and renamed. Whenever there are many small files of rows they
are put into one, whose metadata names them: those that a kill left beside it are removed when the folder is opened.
"""

import contextlib
import json
import os
import re
import uuid
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from hil.core.errors import BadInputError

KEY = "key"
PLAN, ABOUT, ROWS, RECORDINGS = "plan.parquet", "campaign.json", "rows", "recordings"
_REPLACES = b"hil.replaces"
_MOST_OF_A_SIZE = 32
_NAME = re.compile(r"(\d+)-[0-9a-f]{32}\.parquet")
_UNFINISHED = ".unfinished"
_LOCK = "lock"
_FOLDERS, _FILES = (ROWS, RECORDINGS), (_LOCK, PLAN, ABOUT, "report.html")
_ABOUT = {"name", "scenario", "laws", "faults", "seeds", "samples", "axes", "keep", "by", "runs"}
_ANEW = "give hil campaign with its plan once more, which writes it anew"
_ATTEMPTS = 10
_NO_ROWS = pa.schema([(KEY, pa.string())]).empty_table()


class Dataset:
    """The results in a folder, for the one campaign that adds to them; a context manager.

    ``schema`` has the columns of a row; what a row does not have is null.

    Raises BadInputError when the folder cannot be made or written to, has a damaged file, or is in use.
    """

    def __init__(self, folder: Path, schema: pa.Schema) -> None:
        self.folder = folder
        self._schema = schema
        self._rows = folder / ROWS
        with contextlib.ExitStack() as resources:
            with writing(folder):
                (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
                self._rows.mkdir(exist_ok=True)
                lock = FileLock(folder / _LOCK)
                try:
                    resources.enter_context(lock.acquire(timeout=0))
                except Timeout:
                    raise BadInputError(
                        f"campaign folder {folder}: another campaign writes to it; wait for its end, or name another "
                        "with --out"
                    ) from None
                self._tidy()
            self._check_columns()
            self._resources = resources.pop_all()

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows; when this returns they are on the disk. Raises BadInputError when they cannot be written."""
        if rows:
            with writing(self.folder):
                self._write(pa.Table.from_pylist(list(rows), schema=self._schema), 0)
                self._merge()

    def drop(self, keys: Collection[str]) -> None:
        """Remove rows with their recordings; a kill meanwhile leaves all of the rows or none.

        Raises BadInputError when that cannot be written.
        """
        parts = self._parts()
        if not keys or not parts:
            return
        table = pa.concat_tables([_read(part) for part in parts], promote_options="default")
        others = table.filter(pa.array([key not in keys for key in table.column(KEY).to_pylist()], pa.bool_()))
        with writing(self.folder):
            for key in keys:
                for recording in (self.folder / RECORDINGS).glob(f"{key}.*"):
                    recording.unlink()
            self._replace(parts, others, max(map(_size, parts)))

    def begin(self, plan: pa.Table, about: Mapping[str, Any]) -> None:
        """Say what the campaign is now. Raises BadInputError when that cannot be written."""
        with writing(self.folder):
            _write_parquet(plan, self.folder / PLAN)
            _write_bytes(json.dumps(about, indent=1).encode(), self.folder / ABOUT)

    def keep_recording(self, name: str, data: bytes) -> None:
        """Write a recording. Raises BadInputError when it cannot be written."""
        with writing(self.folder):
            _write_bytes(data, self.folder / RECORDINGS / name)

    def close(self) -> None:
        """Let another campaign have the folder."""
        self._resources.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _parts(self) -> list[Path]:
        return sorted(path for path in self._rows.iterdir() if _NAME.fullmatch(path.name))

    def _tidy(self) -> None:
        """Remove what a kill has left: files that were not finished, and those that were put into another."""
        for unfinished in [*self.folder.glob(f"*{_UNFINISHED}"), *self.folder.glob(f"*/*{_UNFINISHED}")]:
            unfinished.unlink()
        for name in {name for part in self._parts() for name in replaced_by(part)}:
            (self._rows / name).unlink(missing_ok=True)

    def _check_columns(self) -> None:
        for part in self._parts():
            there = _schema(part)
            for name in set(there.names) & set(self._schema.names):
                if there.field(name).type != self._schema.field(name).type:
                    raise BadInputError(
                        f"campaign folder {self.folder}: the runs there have {name} as {there.field(name).type}, and "
                        f"now it is {self._schema.field(name).type}; name another folder with --out"
                    )

    def _write(self, table: pa.Table, size: int) -> None:
        _write_parquet(table, self._rows / f"{size}-{uuid.uuid4().hex}.parquet")

    def _merge(self) -> None:
        """Put files of one size into one of the next, as soon as there are many."""
        sizes: dict[int, list[Path]] = {}
        for part in self._parts():
            sizes.setdefault(_size(part), []).append(part)
        for size, parts in sorted(sizes.items()):
            if len(parts) >= _MOST_OF_A_SIZE:
                table = pa.concat_tables([_read(part) for part in parts], promote_options="default")
                self._replace(parts, table, size + 1)

    def _replace(self, parts: Sequence[Path], table: pa.Table, size: int) -> None:
        """Write a table in place of files, which may go when it is there: its metadata says so."""
        names = json.dumps([part.name for part in parts]).encode()
        self._write(table.replace_schema_metadata({_REPLACES: names}), size)
        for part in parts:
            part.unlink()


def check_folder(folder: Path, about: Mapping[str, Any]) -> None:
    """Raise BadInputError for a folder that is there and is not that of this campaign, or of none yet."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise BadInputError(f"campaign folder {folder}: it is a file; name a folder with --out")
    if (folder / ABOUT).exists():
        there = read_about(folder)
        for what in ("name", "scenario"):
            if there[what] != about[what]:
                raise BadInputError(
                    f"campaign folder {folder}: its {what} is {there[what]!r}, and that of this campaign is "
                    f"{about[what]!r}; name another folder with --out"
                )
        return
    strange = sorted(
        path.name for path in folder.iterdir() if path.name.removesuffix(_UNFINISHED) not in (*_FOLDERS, *_FILES)
    )
    if strange:
        raise BadInputError(
            f"campaign folder {folder}: it holds {strange[0]}, and no campaign; name an empty or a new one with --out"
        )


def read_about(folder: Path) -> dict[str, Any]:
    """Return what a campaign's folder says of it. Raises BadInputError when it cannot be read."""
    file = folder / ABOUT
    try:
        about = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(about, dict) or not about.keys() >= _ABOUT:
            raise ValueError("it says something else")
    except (OSError, ValueError) as error:
        raise BadInputError(
            f"campaign file {file}: it cannot be read ({_why(error)}); remove it if it is there, and {_ANEW}"
        ) from error
    return about


def read_plan(folder: Path) -> list[dict[str, Any]]:
    """Return the runs that a campaign's folder says that there are. Raises BadInputError when it cannot be read."""
    return list(_read(folder / PLAN, anew=True).to_pylist())


def read_rows(folder: Path) -> pa.Table:
    """Return all rows in a campaign's folder, one for each key.

    Raises BadInputError when there is none, or a file of it is damaged.
    """
    rows = folder / ROWS
    if not rows.is_dir():
        raise BadInputError(f"campaign folder {folder}: it holds no campaign; give the folder of hil campaign --out")
    for _ in range(_ATTEMPTS):
        parts = sorted(path for path in rows.iterdir() if _NAME.fullmatch(path.name))
        try:
            gone = {name for part in parts for name in replaced_by(part)}
            tables = [_read(part).replace_schema_metadata() for part in parts if part.name not in gone]
        except FileNotFoundError:
            continue  # a campaign under way has put them into another
        return pa.concat_tables(tables, promote_options="default") if tables else _NO_ROWS
    raise BadInputError(f"campaign folder {folder}: its files change while they are read; try again")


def replaced_by(part: Path) -> list[str]:
    """Return the names of the files that were put into this one."""
    metadata = _schema(part).metadata or {}
    return [str(name) for name in json.loads(metadata.get(_REPLACES, b"[]"))]


def _schema(part: Path) -> pa.Schema:
    with _sound(part):
        return pq.read_schema(part)


def _read(part: Path, *, anew: bool = False) -> pa.Table:
    with _sound(part, anew=anew):
        return pq.read_table(part, page_checksum_verification=True)


@contextlib.contextmanager
def _sound(part: Path, *, anew: bool = False) -> Iterator[None]:
    """Say of a file that is not what was written what to do. Raises BadInputError."""
    try:
        yield
    except FileNotFoundError:
        if anew:
            raise BadInputError(f"campaign file {part}: there is no such file; {_ANEW}") from None
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        remedy = _ANEW if anew else "remove it, and the same command does its runs again"
        raise BadInputError(f"campaign file {part}: it is damaged ({_why(error)}); {remedy}") from error


def _why(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())[:200]


def _size(part: Path) -> int:
    """Return the size of a part: how many times it was put into one with others."""
    return int(part.name.partition("-")[0])


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Say of what cannot be written what became of the campaign. Raises BadInputError."""
    try:
        yield
    except OSError as error:
        raise BadInputError(
            f"campaign folder {folder}: it cannot be written to ({error.strerror or error}); what was written is safe: "
            "make room, or make it writable, and give the same command again"
        ) from error


def _write_parquet(table: pa.Table, path: Path) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    _write_bytes(sink.getvalue(), path)


def _write_bytes(data: Any, path: Path) -> None:
    """Write a file so that it is there whole or not at all, whatever happens."""
    unfinished = path.with_name(path.name + _UNFINISHED)
    try:
        with unfinished.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Bring a new name to the disk; where folders cannot be opened, as on Windows, the system does it."""
    if hasattr(os, "O_DIRECTORY"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
