"""The contents of a recording's file, in either format, and checks that they are plausible and all that was written."""

import json
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.record.checks import CHECK, property_check
from hil.record.properties import APPLICATION, OF_A_RUN, PART_PROPERTY, RECORDER_PROPERTY, SIGNALS_PROPERTY

Series = npt.NDArray[np.float64]
Selection = Collection[str] | None
"""Names of the signals to read; None for all."""

Numbers = npt.NDArray[np.int64]
Event = tuple[float, str, str]
"""Time [s], level and text."""
NumberedEvent = tuple[int | None, Event]
"""The number of an event in the run, None in older recordings, and the event."""

NO_INDEX = "its index cannot be read; every row was read without it"
CUT_BEFORE_ROWS = "cut before its first rows"


class DamagedError(Exception):
    """The file cannot be read as a recording of a run; the text says what is wrong with it."""


class Contents(NamedTuple):
    """What was read from one file.

    Attributes:
        signals: by name, each of shape (rows,). events: in the order of writing. properties: the texts of each.
        cut_bytes: None for a file with a proper end; otherwise how many bytes of a message that was cut short are left
            out at its end.
        damage: a sentence for each piece that is damaged or missing; remarks: other sentences on the file.
        lost_rows, lost_events: how many these pieces had, as far as that is known.
        numbers: the number of each row in the run, ascending; None in older recordings.
    """

    signals: dict[str, Series]
    events: list[Event]
    properties: "Properties"
    cut_bytes: int | None
    damage: tuple[str, ...] = ()
    lost_rows: int = 0
    lost_events: int = 0
    numbers: Numbers | None = None
    remarks: tuple[str, ...] = ()


class Properties(dict[str, dict[str, str]]):
    """Properties of a file by name. One that differs from its check value is in ``damaged``, and left out.

    ``has_checks``: whether any property has a check value: then all of them must have one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.has_checks = False
        self.damaged: set[str] = set()
        self._unchecked: set[str] = set()

    @property
    def part(self) -> dict[str, Any]:
        """Which part of the run the file is; empty if that is not known."""
        return json_property(self, PART_PROPERTY) or {}

    @property
    def end(self) -> dict[str, Any]:
        """What the recorder wrote at the file's end; empty if it did not."""
        return json_property(self, RECORDER_PROPERTY) or {}

    def read(self, name: str, texts: Mapping[str, str]) -> None:
        """Add a property as it was read from the file; the newest of one name is kept."""
        own = {key: text for key, text in texts.items() if key != CHECK}
        self.damaged.discard(name)
        if CHECK in texts:
            self.has_checks = True
            if property_check(name, own) != texts[CHECK]:
                self.damaged.add(name)
                self.pop(name, None)
                return
        elif name in OF_A_RUN:
            self._unchecked.add(name)
        self[name] = own

    def damage(self) -> list[str]:
        """Return a sentence for each property that is damaged or missing. Raises DamagedError for ``signals``."""
        if self.has_checks:
            self.damaged |= self._unchecked
            for name in self._unchecked:
                self.pop(name, None)
        if SIGNALS_PROPERTY in self.damaged:
            raise DamagedError("damaged: its property 'signals' differs from its check value")
        missing = [name for name in self.end.get("holds", ()) if name not in self and name not in self.damaged]
        return [
            *(f"its property {name!r} differs from its check value and is left out" for name in sorted(self.damaged)),
            *(f"its property {name!r} is missing" for name in missing),
        ]


class NumberedRows(NamedTuple):
    """The rows of a file, each once, in their order.

    Attributes:
        signals: by name, and the numbers of the rows in the run, each of shape (n,).
        last_s: the time of the last one [s]; -inf if there is none, NaN if it is not known.
        lost: how many rows the file lacks; damage: sentences on these, remarks if the recorder itself lost as many.
    """

    signals: dict[str, Series]
    numbers: Numbers
    last_s: float
    lost: int
    damage: list[str]
    remarks: list[str]


def numbered_rows(
    stored: npt.NDArray[np.unsignedinteger[Any]], values: Series, names: Collection[str], properties: Properties
) -> NumberedRows:
    """Return the rows with their numbers ``stored`` modulo 2^32 (n,), and their values (n, m) of the named signals."""
    first = properties.part.get("first_row", 0)
    near: Numbers = first + (stored.astype(np.int64) - first).astype(np.int32).astype(np.int64)  # to that of this part
    numbers, places = np.unique(near, return_index=True)
    signals = {name: values[places, i] for i, name in enumerate(names)}
    t_s = signals.get("loop.t_s", np.full(len(numbers), np.nan))
    return NumberedRows(signals, numbers, t_s[-1] if len(t_s) else -np.inf, *_lost_rows(numbers, properties, t_s))


_TOLD_GAPS = 8


def _gaps(numbers: Numbers, properties: Properties, what: str) -> list[tuple[int, int]]:
    """Return which numbers of rows or events (``what``) a file lacks: the first and the last of each gap.

    ``numbers`` has shape (n,) and ascends. A file begins with the first one of its part, or before it if it was merged
    from several parts, and it ends as its recorder says.
    """
    begin, end = properties.part.get(f"first_{what}", 0), properties.end.get(f"{what}s_until", 0)
    begin, end = (min(begin, numbers[0]), max(end, numbers[-1] + 1)) if len(numbers) else (begin, end)
    edges = np.concatenate([[begin - 1], numbers, [end]])
    places = np.flatnonzero(np.diff(edges) > 1)
    return [(int(edges[place]) + 1, int(edges[place + 1]) - 1) for place in places]


def _lost_rows(numbers: Numbers, properties: Properties, t_s: Series) -> tuple[int, list[str], list[str]]:
    """Return how many rows a file lacks, and sentences on each gap, of at most eight: damage, and remarks.

    A gap is a remark if the recorder itself lost as many rows. ``t_s`` has the times [s] of the rows that are there.
    """
    found = _gaps(numbers, properties, "row")
    lost = sum(last - first + 1 for first, last in found)
    end, begin = properties.end, properties.part.get("first_row", 0)
    was_told = lost > 0 and end.get("rows_until", 0) - begin - end.get("rows_in_part", 0) == lost
    what = "were lost when the run was recorded" if was_told else "cannot be read and are left out"
    words = []
    for first, last in found[:_TOLD_GAPS]:
        place = int(np.searchsorted(numbers, first))
        after = f"after t = {t_s[place - 1]:.6g} s" if place else ""
        before = f"before t = {t_s[place]:.6g} s" if place < len(t_s) else ""
        where = " and ".join(filter(None, (after, before)))
        rows = f"1 row ({first})" if first == last else f"{last - first + 1} rows ({first} to {last})"
        words.append(f"{rows}{', ' * bool(where)}{where}, {what}")
    if more := found[_TOLD_GAPS:]:
        words.append(f"{sum(last - first + 1 for first, last in more)} rows in {len(more)} more places {what}")
    return (lost, [], words) if was_told else (lost, words, [])


def numbered_events(
    read: list[NumberedEvent], properties: Properties, differ: int = 0
) -> tuple[list[Event], int, list[str]]:
    """Return the events in their order, each once, how many are damaged or missing, and the sentence on these.

    ``differ`` is how many were read that differ from their check values.
    """
    by_number = {number: event for number, event in read if number is not None}
    numbers = np.array(sorted(by_number), np.int64)
    missing = sum(last - first + 1 for first, last in _gaps(numbers, properties, "event"))
    events = [by_number[number] for number in numbers] if missing or by_number else [event for _, event in read]
    lost = max(missing, differ)
    words = f"{lost} event{'s' * (lost > 1)} cannot be read and {'are' if lost > 1 else 'is'} left out"
    return events, lost, [words] * (lost > 0)


def why_nothing(programs: Collection[str], cut_bytes: int | None) -> str:
    """Return the reason why a file holds no run, by the programs named in it and by whether it was cut."""
    if APPLICATION in programs:
        return "damaged: it does not say what its signals are" if cut_bytes is None else CUT_BEFORE_ROWS
    if programs or cut_bytes is None:
        return "a recording of another program"
    return "cut off so early that its program is not known"


def json_property(properties: dict[str, dict[str, str]], name: str) -> dict[str, Any] | None:
    """Return a property that holds a JSON object, None if it is missing. Raises DamagedError for other content."""
    texts = properties.get(name)
    if texts is None:
        return None
    try:
        value = json.loads(texts["json"])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise DamagedError(f"damaged: its property {name!r} is not readable")
    return value
