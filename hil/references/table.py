"""Reads numbers from a user's CSV file. Every error names the file and the line."""

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from hil.core.errors import BadInputError, apart, nearest

LARGEST_BYTES = 50_000_000
LARGEST_NUMBER = 1e6  # a larger number is in the wrong unit, or its square loses too many digits


class Format(NamedTuple):
    """The format of a table: its columns, optional columns with their defaults, and the allowed numbers of rows.

    ``others`` allows further columns, which are ignored.
    """

    columns: tuple[str, ...]
    optional: Mapping[str, float]
    fewest_rows: int
    most_rows: int
    others: bool


def read_table(directory: Path, file: str, form: Format) -> list[tuple[int, tuple[float, ...]]]:
    """Return the rows of a CSV file with a header line: each a line number, and one value for each column of ``form``.

    Empty lines and lines that begin with ``#`` are skipped. Raises BadInputError for a file that cannot be read or
    is not as ``form`` says.
    """
    name = f"reference.file = {file!r}"
    path = directory / file
    if path.suffix.lower() != ".csv":
        hint = "; REFERENCES.md says how to write a recording's poses" if path.suffix == ".rrd" else ""
        raise BadInputError(f"{name}: expected a file that ends in .csv{hint}")
    try:
        if not path.is_file():
            raise BadInputError(f"{name}: there is no file {str(path)!r}; its path starts from the scenario's folder")
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise BadInputError(
                f"{name}: {apart(size / 1e6, LARGEST_BYTES / 1e6)} MB; expected at most {LARGEST_BYTES / 1e6:g} MB"
            )
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
    numbered = [(f"{name}, line {line}", line, text.strip()) for line, text in enumerate(lines, start=1)]
    numbered = [row for row in numbered if row[2] and not row[2].startswith("#")]
    if not numbered:
        raise BadInputError(f"{name}: it is empty; expected a line with the columns {', '.join(form.columns)}")
    where, _, text = numbered.pop(0)
    header = _cells(text, where)
    _check_header(header, form, where)
    if not form.fewest_rows <= len(numbered) <= form.most_rows:
        raise BadInputError(f"{name}: {len(numbered)} rows; expected {form.fewest_rows} to {form.most_rows}")
    return [(line, _values(_cells(text, where), where, header, form)) for where, line, text in numbered]


def _cells(text: str, where: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([text], strict=True))]
    except csv.Error as error:
        raise BadInputError(f"{where}: it cannot be read as values separated by commas: {error}") from error


def _check_header(header: Sequence[str], form: Format, where: str) -> None:
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


def _values(cells: Sequence[str], where: str, header: Sequence[str], form: Format) -> tuple[float, ...]:
    """Return the values of a row's cells, in the order of the format's columns."""
    if len(cells) != len(header):
        raise BadInputError(f"{where}: {len(cells)} values; expected {len(header)}, one for each column")
    given = dict(zip(header, cells, strict=True))
    values = []
    for column in (*form.columns, *form.optional):
        cell = given.get(column, "")
        if not cell and column in form.optional:
            values.append(form.optional[column])
            continue
        try:
            values.append(math.nan if "_" in cell else float(cell))  # Python reads 1_0 as ten
        except ValueError:
            values.append(math.nan)
        if not abs(values[-1]) <= LARGEST_NUMBER:
            expected = f"expected a number between ±{LARGEST_NUMBER:.0f}"
            raise BadInputError(f"{where}: {column} = {cell!r}; {expected}")
    return tuple(values)
