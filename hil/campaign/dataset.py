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
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from hil.errors import BadInputError

KEY = "key"
PLAN, ABOUT, ROWS, RECORDINGS = "plan.parquet", "campaign.json", "rows", "recordings"
_REPLACES = b"hil.replaces"
_MOST_OF_A_SIZE = 32
_NAME = re.compile(r"(\d+)-[0-9a-f]{32}\.parquet")
_UNFINISHED = ".unfinished"


class Dataset:
    """The results in a folder, for the one campaign that adds to them; a context manager.

    ``schema`` has the columns of a row; what a row does not have is null.

    Raises BadInputError when the folder cannot be made or written to, holds something else, or is in use.
    """

    def __init__(self, folder: Path, schema: pa.Schema) -> None:
        self.folder = folder
        self._schema = schema
        self._rows = folder / ROWS
        with contextlib.ExitStack() as resources:
            with writing(folder):
                (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
                self._rows.mkdir(exist_ok=True)
                lock = FileLock(folder / "lock")
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

    def keys(self) -> set[str]:
        """Return the keys of the runs that are done."""
        return {key for part in self._parts() for key in pq.read_table(part, columns=[KEY]).column(KEY).to_pylist()}

    def append(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add rows; when this returns they are on the disk. Raises BadInputError when they cannot be written."""
        if rows:
            with writing(self.folder):
                self._write(pa.Table.from_pylist(list(rows), schema=self._schema), 0)
                self._merge()

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
        for part in self._parts():
            for name in replaced_by(part):
                (self._rows / name).unlink(missing_ok=True)

    def _check_columns(self) -> None:
        for part in self._parts():
            there = pq.read_schema(part)
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
            sizes.setdefault(int(part.name.partition("-")[0]), []).append(part)
        for size, parts in sorted(sizes.items()):
            if len(parts) >= _MOST_OF_A_SIZE:
                table = pa.concat_tables([pq.read_table(part) for part in parts], promote_options="default")
                names = json.dumps([part.name for part in parts]).encode()
                self._write(table.replace_schema_metadata({_REPLACES: names}), size + 1)
                for part in parts:
                    part.unlink()


def read_rows(folder: Path) -> pa.Table:
    """Return all rows in a campaign's folder, one for each key. Raises BadInputError when there is none."""
    rows = folder / ROWS
    if not rows.is_dir():
        raise BadInputError(f"campaign folder {folder}: it holds no campaign; give the folder of hil campaign --out")
    parts = sorted(path for path in rows.iterdir() if _NAME.fullmatch(path.name))
    gone = {name for part in parts for name in replaced_by(part)}
    tables = [pq.read_table(part).replace_schema_metadata() for part in parts if part.name not in gone]
    return pa.concat_tables(tables, promote_options="default") if tables else pa.table({KEY: pa.array([], pa.string())})


def replaced_by(part: Path) -> list[str]:
    """Return the names of the files that were put into this one."""
    metadata = pq.read_schema(part).metadata or {}
    return [str(name) for name in json.loads(metadata.get(_REPLACES, b"[]"))]


@contextlib.contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Say of what cannot be written what became of the campaign. Raises BadInputError."""
    try:
        yield
    except OSError as error:
        raise BadInputError(
            f"campaign folder {folder}: it cannot be written to ({error.strerror or error}); what was written is safe: "
            "make room, or may it be written to, and give the same command again"
        ) from error


def _write_parquet(table: pa.Table, path: Path) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
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
