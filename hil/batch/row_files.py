"""Small Parquet files of rows, which are there whole or not at all, and which another file may replace."""

import contextlib
import json
import os
import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from hil.batch.figures import KEY
from hil.core.errors import BadInputError

REPLACES = b"hil.replaces"
"""Metadata of a file: the names of those in whose place it is."""
UNFINISHED = ".unfinished"
_NAME = re.compile(r"(\d+)-[0-9a-f]{32}\.parquet")
_REDO = "remove it, and the same command does its runs again"
_NO_ROWS = pa.schema([(KEY, pa.string())]).empty_table()


def row_files(rows: Path) -> list[Path]:
    return sorted(path for path in rows.iterdir() if _NAME.fullmatch(path.name)) if rows.is_dir() else []


def concatenated(files: Sequence[Path]) -> pa.Table:
    return joined([read_table(file).replace_schema_metadata() for file in files] or [_NO_ROWS])


def joined(tables: Sequence[pa.Table]) -> pa.Table:
    return pa.concat_tables(tables, promote_options="default")


def keys_of(rows: pa.Table) -> list[str]:
    return list(rows.column(KEY).to_pylist())


def parted(rows: pa.Table, keys: Collection[str]) -> tuple[pa.Table, pa.Table]:
    """Return the rows with one of these keys, and the others."""
    is_one = pa.array([key in keys for key in keys_of(rows)], pa.bool_())
    return rows.filter(is_one), rows.filter(pc.invert(is_one))


def merged_into(file: Path) -> list[str]:
    """Return the names of the files that were merged into this one."""
    metadata = schema_of(file).metadata or {}
    return [str(name) for name in json.loads(metadata.get(REPLACES, b"[]"))]


def schema_of(file: Path) -> pa.Schema:
    with _sound(file):
        return pq.read_schema(file)


def read_table(file: Path, remedy: str = _REDO) -> pa.Table:
    with _sound(file, remedy):
        return pq.read_table(file, page_checksum_verification=True)


def damage_of(file: Path) -> str | None:
    """Return a sentence on a file that cannot be read, with the number of its rows if that is known; else None."""
    rows = "its rows are"
    try:
        with _sound(file, "remove it, and 'hil campaign' does its runs again"):
            count = pq.read_metadata(file).num_rows
            rows = "its row is" if count == 1 else f"its {count} rows are"
            pq.read_table(file, page_checksum_verification=True)
    except BadInputError as error:
        return f"{error}; {rows} left out"
    return None


@contextlib.contextmanager
def _sound(file: Path, remedy: str = _REDO) -> Iterator[None]:
    """Raise BadInputError, with the remedy, for a damaged file."""
    try:
        yield
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, ValueError) as error:
        raise BadInputError(f"file {file}: it is damaged ({reason(error)}); {remedy}") from error


def reason(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split())[:200]


def size_class(file: Path) -> int:
    """Return the size class of a file: how many times its rows were merged."""
    return int(file.name.partition("-")[0])


def write_parquet(table: pa.Table, path: Path) -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    write_bytes(sink.getvalue(), path)


def write_bytes(data: Any, path: Path) -> None:
    """Write a file so that it is there whole or not at all, whatever happens."""
    unfinished = path.with_name(path.name + UNFINISHED)
    try:
        with unfinished.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    if hasattr(os, "O_DIRECTORY"):  # elsewhere the system brings the new name to the disk
        descriptor = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
