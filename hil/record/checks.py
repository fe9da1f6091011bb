"""Check values of a recording: a CRC-32 for each row, event and property, with which a reader compares their content.

They outlive tools that write the file again. A row or event has a 64-bit word: its number in the run, modulo 2^32, and
below it its CRC-32, XORed with the low 32 bits of 2654435761 times the number. The numbers tell what is missing.
"""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hil.record.ring import Rows

CHECK = "crc32"
"""The key of a property that holds its check value."""
WORDS = "number_crc32"
"""The column of rows and events that holds their words."""
NUMBERS = 1 << 32
"""Numbers of rows and events are stored modulo this."""

_MIXED = np.uint64(2654435761)  # odd: no two numbers give the same product
_PIECE_BYTES = 1 << 18
Words = npt.NDArray[np.uint64]


def row_crcs(t_ns: npt.NDArray[np.int64], ticks: npt.NDArray[np.int64], rows: Rows) -> Words:
    """Return the CRC-32 (that of zlib) of rows of shape (n, signals): of time [ns], tick and values, 64 bits each."""
    table = np.empty((len(rows), 2 + rows.shape[1]), "<i8")
    table[:, 0], table[:, 1] = t_ns, ticks
    table[:, 2:] = np.ascontiguousarray(rows, "<f8").view("<i8")
    each = table.view(f"V{table.itemsize * table.shape[1]}").ravel().tolist()
    return np.fromiter(map(zlib.crc32, each), np.uint64, len(each))


def numbered(numbers: npt.NDArray[np.integer[Any]], crcs: Words) -> Words:
    """Return the words of numbers and CRCs, each of shape (n,); a number without its CRC is no word."""
    low = numbers.astype(np.uint64) % np.uint64(NUMBERS)
    words: Words = low << np.uint64(32) | (crcs ^ low * _MIXED) % np.uint64(NUMBERS)
    return words


def event_check(number: int, t_ns: int, level: str, text: str) -> int:
    """Return the word of an event: the CRC-32 is over its time [ns], level and text as a JSON list."""
    crc = zlib.crc32(json.dumps([t_ns, level, text]).encode())
    return int(numbered(np.array([number]), np.array([crc], np.uint64))[0])


def property_check(name: str, texts: Mapping[str, str]) -> str:
    """Return the CRC-32, as hexadecimal digits, of a property's name and its texts by name, as JSON."""
    return f"{zlib.crc32(json.dumps([name, dict(texts)], sort_keys=True).encode()):08x}"


class Contained:
    """Counts the contents of a file of a recording for the record at its end: rows, events and properties.

    Rows and events are counted over the whole run; ``part`` has the numbers of the file's first ones.
    """

    def __init__(self, part: Mapping[str, Any]) -> None:
        self._next_row, self._next_event = (int(part.get(name, 0)) for name in ("first_row", "first_event"))
        self._properties: dict[str, None] = {}

    def add_rows(self, count: int, first: int | None = None) -> int:
        """Count these rows, and return the number of the first: ``first``, or that after the last one."""
        first = self._next_row if first is None else first
        self._next_row = first + count
        return first

    def add_event(self) -> int:
        """Count an event and return its number."""
        self._next_event += 1
        return self._next_event - 1

    def checked(self, name: str, texts: Mapping[str, str]) -> dict[str, str]:
        """Return the texts of a property with its check value."""
        self._properties[name] = None
        return {**texts, CHECK: property_check(name, texts)}

    def end(self) -> dict[str, Any]:
        """Return the counts and names for the end of the file."""
        return {"rows_until": self._next_row, "events_until": self._next_event, "holds": list(self._properties)}


class WrittenBytes:
    """Reads back, piece by piece, what was written to a file: ``count`` bytes, with their ``crc32``."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self.count = self.crc32 = 0

    def read(self, most: int | None = None) -> None:
        """Read up to the present end of the file; at most up to byte ``most`` of it."""
        while piece := self._file.read(_PIECE_BYTES if most is None else min(_PIECE_BYTES, most - self.count)):
            self.count += len(piece)
            self.crc32 = zlib.crc32(piece, self.crc32)

    def close(self) -> None:
        """Close the file."""
        self._file.close()
