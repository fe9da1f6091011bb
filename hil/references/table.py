"""Reads numbers from a user's CSV file. Every error names the file and the line."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import BadInputError, nearest

LARGEST_BYTES = 50_000_000
LARGEST_NUMBER = 1e6
"""A larger number is in the wrong unit, or its square loses too many digits."""


class Row(NamedTuple):
    """A row of a table: its line number in the file, and one value for each column of the format."""

    line: int
    values: tuple[float, ...]


class Format(NamedTuple):
    """What a table must have: its columns, optional columns with their defaults, and the number of rows.

    ``others`` allows further columns, which are ignored.
    """

    columns: tuple[str, ...]
    optional: Mapping[str, float]
    fewest_rows: int
    most_rows: int
    others: bool


def read_table(directory: Path, file: str, form: Format) -> list[Row]:
    """Return the rows of a CSV file with a header line; empty lines and lines that begin with ``#`` are skipped.

    Raises BadInputError, with one sentence, for anything that is wrong with the file.
    """
    name = f"reference.file = {file!r}"
    path = directory / file
    if path.suffix.lower() != ".csv":
        hint = f"; write its poses first: hil review {file} --trajectory FILE.csv" if path.suffix == ".rrd" else ""
        raise BadInputError(f"{name}: expected a file that ends in .csv{hint}")
    try:
        if not path.is_file():
            raise BadInputError(f"{name}: there is no file {str(path)!r}; its path starts from the scenario's folder")
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise BadInputError(f"{name}: {size / 1e6:.0f} MB; expected at most {LARGEST_BYTES / 1e6:.0f} MB")
        lines = path.read_text("utf-8-sig").splitlines()
    except OSError as error:
        raise BadInputError(f"{name}: {str(path)!r} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise BadInputError(
            f"{name}: {str(path)!r} is not UTF-8 (byte 0x{error.object[error.start]:02X} at offset "
            f"{error.start}); save it as UTF-8"
        ) from error
    except ValueError as error:  # a zero byte in the path
        raise BadInputError(f"{name}: {str(path)!r} cannot be read: {error}") from error
    numbered = [(number, text) for number, text in enumerate(lines, start=1) if not _is_comment(text)]
    if not numbered:
        raise BadInputError(f"{name}: it is empty; expected a line with the columns {', '.join(form.columns)}")
    header = [cell.strip() for cell in _cells(numbered[0][1], f"{name}, line {numbered[0][0]}")]
    places = _places(header, form, f"{name}, line {numbered[0][0]}")
    count = len(numbered) - 1
    if not form.fewest_rows <= count <= form.most_rows:
        raise BadInputError(f"{name}: {count} rows; expected {form.fewest_rows} to {form.most_rows}")
    return [Row(line, _values(text, f"{name}, line {line}", header, places, form)) for line, text in numbered[1:]]


def _is_comment(text: str) -> bool:
    return not text.strip() or text.lstrip().startswith("#")


def _cells(text: str, where: str) -> list[str]:
    try:
        return next(csv.reader([text], strict=True))
    except csv.Error as error:
        raise BadInputError(f"{where}: it cannot be read as values separated by commas: {error}") from error


def _places(header: Sequence[str], form: Format, where: str) -> list[int | None]:
    """Return the index of each column in a row, None for an optional column that is absent."""
    known = (*form.columns, *form.optional)
    for column in form.columns:
        if column not in header:
            raise BadInputError(
                f"{where}: there is no column {column!r} among {', '.join(header)!r}; "
                f"expected {', '.join(form.columns)}, separated by commas"
            )
    for place, column in enumerate(header):
        if column in known and column in header[:place]:
            raise BadInputError(f"{where}: the column {column!r} is there twice; leave one out")
        if column not in known and not form.others:
            raise BadInputError(f"{where}: unknown column {column!r}{nearest(column, known)}")
    return [header.index(column) if column in header else None for column in known]


def _values(
    text: str, where: str, header: Sequence[str], places: Sequence[int | None], form: Format
) -> tuple[float, ...]:
    cells = _cells(text, where)
    if len(cells) != len(header):
        raise BadInputError(f"{where}: {len(cells)} values; expected {len(header)}, one for each column")
    defaults = (*(None for _ in form.columns), *form.optional.values())
    values = []
    for place, default in zip(places, defaults, strict=True):
        cell = cells[place].strip() if place is not None else ""
        if default is not None and not cell:
            values.append(default)
            continue
        try:
            value = float(cell)
        except ValueError:
            value = math.nan
        if not abs(value) <= LARGEST_NUMBER:
            raise BadInputError(
                f"{where}: {header[place or 0]} = {cell!r}; expected a number between ±{LARGEST_NUMBER:.0f}"
            )
        values.append(value)
    return tuple(values)
