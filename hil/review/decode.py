"""Decoding of a recording, in a process of its own: ``python -m hil.review.decode RUN.rrd [SIGNALS]``.

rerun's reader aborts its whole process on some damaged files; ``hil.review.reader`` starts this one and outlives it.
The answer on standard output is one line of JSON (``Decoded``), then the values as float64, signal by signal; SIGNALS
is a JSON list of those that are wanted.
"""

import functools
import gc
import itertools
import json
import operator
import os
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt

from hil.errors import BadInputError
from hil.review.contents import Contents, DamagedError, Series, Wanted, json_property, why_nothing
from hil.review.plausibility import CLOCK, check_plausible
from hil.telemetry.environment import refuse_pandas
from hil.telemetry.files import check_is_recording, has_end, later_parts
from hil.telemetry.names import (
    OVERLAY_PROPERTY,
    PART_PROPERTY,
    RECORDER_PROPERTY,
    RUN_PROPERTY,
    SIGNALS_PATH,
    SIGNALS_PROPERTY,
    SUMMARY_PROPERTY,
)

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun.chunk import LazyChunkStream, RrdReader

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE = 0
_COPY_BYTES = 1 << 20
_GROWN_ROWS = 1 << 16
_PROPERTIES = "/__properties/"
_ROW_ID = "rerun.controls.RowId"


class Decoded(TypedDict):
    """What the answer's first line holds; ``signals`` names the rows of the table after it, ``held`` all there are."""

    signals: list[str]
    held: list[str]
    rows: int
    events: list[tuple[float, str, str]]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None
    rows_missing: int
    goes_on: bool
    parts: list[str]
    notes: list[str]


def decode(path: Path, wanted: Wanted = None) -> tuple[Decoded, dict[str, Series]]:
    """Return what a recording and its later parts hold, and its signals by name. Raises DamagedError."""
    parts, notes = _parts(path, wanted)
    first, last = parts[0][1], parts[-1][1]
    told = [contents.json(PART_PROPERTY) or {} for _, contents in parts]
    spans, missing = _spans([one.get("first_row") for one in told], [_length(contents) for _, contents in parts])
    event_spans, events_missing = _spans(
        [one.get("first_event") for one in told], [len(contents.events) for _, contents in parts]
    )
    for count, what in ((missing, "rows"), (events_missing, "events")):
        if count:
            notes.append(f"{count} {what} between its parts were lost")
    signals = {
        name: np.concatenate([c.signals[name][:n] for (_, c), n in zip(parts, spans, strict=True)])
        if len(parts) > 1
        else series
        for name, series in first.signals.items()
    }
    recorder = last.json(RECORDER_PROPERTY)
    notes.extend(note for part in parts if (note := _cut(*part, is_last=part is parts[-1])))
    next_part = (recorder or {}).get("next_part")
    if next_part is not None:
        notes.append(f"the run went on in part {next_part}, which is not read here")
    decoded = Decoded(
        signals=list(signals),
        held=[name for names in (first.json(SIGNALS_PROPERTY) or {}).values() for name in names],
        rows=len(next(iter(signals.values()), ())),
        events=[event for (_, c), n in zip(parts, event_spans, strict=True) for event in c.events[:n]],
        properties=first.properties.get(RUN_PROPERTY, {}),
        summary=last.json(SUMMARY_PROPERTY),
        rows_dropped=None if recorder is None else recorder.get("rows_dropped"),
        rows_missing=missing,
        goes_on=next_part is not None,
        parts=[str(one) for one, _ in parts],
        notes=notes,
    )
    return decoded, signals


def _cut(path: Path, contents: Contents, *, is_last: bool) -> str | None:
    """Say what a file without its end has lost, as far as it tells; None when that is nothing, or is in the next."""
    why = "the recorder was killed or could not write it, or the file was cut"
    if contents.json(RECORDER_PROPERTY) is None:
        cut = f", with its last {contents.cut_bytes} bytes, which were cut short," if contents.cut_bytes else ""
        return f"{path.name} has no end: {why}, and what came after{cut} is lost" if is_last else None
    if contents.cut_bytes is None:
        return None
    cut = f", and its last {contents.cut_bytes} bytes, which were cut short, are left out" if contents.cut_bytes else ""
    return f"{path.name} has no index at its end: {why}{cut}; all that the run recorded is before that"


def _parts(path: Path, wanted: Wanted) -> tuple[list[tuple[Path, Contents]], list[str]]:
    """Read a file, and those after it that are of the same run; say which of these could not be read."""
    first = _read(path, wanted)
    parts, notes = [(path, first)], []
    part = first.json(PART_PROPERTY)
    if part is not None and _is_later_part(part, first):
        notes.append(_alone(path, part))
    for other in later_parts(path) if part is not None and part["number"] == 1 else ():
        try:
            check_is_recording(other)
            contents = _read(other, wanted)
        except (DamagedError, BadInputError) as error:
            notes.append(f"{other.name}, by its name a part of it, is left out: {error}")
            continue
        later = contents.json(PART_PROPERTY)
        if later is None or part is None or later["recording_id"] != part["recording_id"]:
            continue
        if later["number"] != int(other.stem.rpartition("-")[2]):
            notes.append(f"{other.name} is left out: it is part {later['number']} of the run, by what it says itself")
            continue
        parts.append((other, contents))
    return parts, notes


def _is_later_part(part: dict[str, Any], contents: Contents) -> bool:
    """Whether a file is one of the later parts alone; parts that rerun has merged say what the last of them said."""
    in_part = (contents.json(RECORDER_PROPERTY) or {}).get("rows_in_part")
    return bool(part["number"] > 1 and (in_part is None or not contents.signals or _length(contents) <= in_part))


def _alone(path: Path, part: dict[str, Any]) -> str:
    """Say that a file is a part of a run, and where by its name the others are."""
    number = part["number"]
    told = f"{path.name} is part {number} of its run, from row {part['first_row']} on, and read alone"
    stem = path.stem.removesuffix(f"-{number}")
    if stem == path.stem:
        return f"{told}; the others are not known by its name"
    first = path.with_name(stem + path.suffix)
    if first.exists():
        return f"{told}; review {first.name} for the whole run"
    others = ", ".join(other.name for other in later_parts(first) if other.name != path.name)
    return f"{told}; {first.name}, with which the run began, is not beside it{', but ' * bool(others)}{others}"


def _length(contents: Contents) -> int:
    return len(next(iter(contents.signals.values()), ()))


def _spans(starts: list[int | None], lengths: list[int]) -> tuple[list[int], int]:
    """Return how many rows (or events) to take of each part, by the numbers that they begin with, and how many lack.

    What a recorder had written that was killed before it could say so is in the next part too. Recordings of before do
    not say with which event a part begins.
    """
    taken = list(lengths)
    missing = 0
    for i, (start, after) in enumerate(itertools.pairwise(starts)):
        if start is not None and after is not None:
            missing += max(0, after - start - lengths[i])
            taken[i] = min(lengths[i], after - start)
    return taken, missing


def _read(path: Path, wanted: Wanted) -> Contents:
    if check_is_recording(path) == ".mcap":
        from hil.review.decode_mcap import decode_mcap

        return decode_mcap(path, wanted)
    contents = _decode_rrd(path, None if wanted is None else CLOCK.union(wanted))
    check_plausible(contents.signals)
    if wanted is None:
        return contents
    return contents._replace(signals={name: series for name, series in contents.signals.items() if name in wanted})


class _Part(NamedTuple):
    """A piece of an entity: row ids (n, 2) in the order of writing, ticks (n,), values (n, signals)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    values: Series


class _Pieces:
    """What was read of an entity so far, in one array that grows: pieces put together later would be there twice."""

    def __init__(self, width: int) -> None:
        self._row_ids: list[npt.NDArray[np.uint64]] = []
        self._ticks: list[npt.NDArray[np.int64]] = []
        self._values = np.empty((0, width))
        self._rows = 0

    def append(self, row_ids: npt.NDArray[np.uint64], ticks: npt.NDArray[np.int64], values: Series) -> None:
        """Take the next piece, as of ``_Part``."""
        self._row_ids.append(row_ids)
        self._ticks.append(ticks)
        start, self._rows = self._rows, self._rows + len(values)
        if self._rows > len(self._values):
            self._values.resize((self._rows + _GROWN_ROWS, self._values.shape[1]), refcheck=False)
        self._values[start : self._rows] = values

    def in_order(self) -> _Part:
        """Return all in the order of writing; takes the pieces away, to save memory."""
        row_ids, ticks = np.concatenate(self._row_ids), np.concatenate(self._ticks)
        self._row_ids.clear()
        self._ticks.clear()
        values = self._values[: self._rows]
        upper, lower = row_ids.T
        if ((upper[1:] > upper[:-1]) | ((upper[1:] == upper[:-1]) & (lower[1:] > lower[:-1]))).all():
            return _Part(row_ids, ticks, values)
        order = np.lexsort((lower, upper))
        return _Part(row_ids[order], ticks[order], values[order])


class _Entities:
    """The entities of a file, of which those that hold signals are kept."""

    def __init__(self, wanted: Wanted) -> None:
        self.wanted = wanted
        self.pieces: dict[str, _Pieces] = {}
        self.properties: dict[str, dict[str, str]] = {}
        self.told: dict[str, bytes] = {}  # the row id of each property's newest word
        self.events: list[tuple[bytes, tuple[float, str, str]]] = []  # with their row ids

    def held(self) -> dict[str, list[str]] | None:
        """Which signals each entity holds, or None while that was not read."""
        return json_property(self.properties, SIGNALS_PROPERTY)


def _decode_rrd(path: Path, wanted: Wanted) -> Contents:
    import rerun.chunk as rrc

    entities = _Entities(wanted)
    with _whole_messages(path) as (readable, cut_bytes), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "has no footer": so it is, after a kill
        try:
            stream = _indexed(rrc.RrdReader(readable))
            held: dict[str, list[str]] | None = None
            early: list[pa.RecordBatch] = []  # rerun's own tools may put the rows before what says whose they are
            for chunk in stream().filter(content=["/__properties/**", "/events", SIGNALS_PATH]):
                held = held or entities.held()
                if held is None and chunk.entity_path == SIGNALS_PATH:
                    early.append(chunk.to_record_batch())
                else:
                    _take(chunk.entity_path, chunk.to_record_batch(), entities, held)
            held = entities.held()
            while early:
                _take(SIGNALS_PATH, early.pop(0), entities, held)
            if held is None:
                if OVERLAY_PROPERTY in entities.properties:
                    raise DamagedError("an overlay of two runs")
                raise DamagedError(why_nothing(_programs(readable), cut_bytes))
            # What was received live, and files of before, have their signals where they are drawn.
            drawn = [path for path, names in held.items() if path != SIGNALS_PATH and _columns(names, wanted)]
            if drawn:
                for chunk in stream().filter(content=drawn):
                    _take(chunk.entity_path, chunk.to_record_batch(), entities, held)
        except (RuntimeError, ValueError, OSError) as error:
            if cut_bytes is not None and not _holds_recording(readable):
                raise DamagedError(why_nothing(_programs(readable), cut_bytes)) from error
            what = str(error).removeprefix(f"Failed to read RRD file at {readable}: ")
            raise DamagedError(f"damaged: {what}") from error
    events = [event for _, event in sorted(entities.events, key=operator.itemgetter(0))]
    return Contents(_signals(held, entities), events, entities.properties, cut_bytes)


def _indexed(reader: "RrdReader") -> "Callable[[], LazyChunkStream]":
    """Return what streams chunks: by the file's index, so that only the wanted are read, or all of a file without."""
    try:
        return reader.store().stream
    except (RuntimeError, ValueError, OSError):
        return reader.stream


def _holds_recording(path: Path) -> bool:
    """Whether rerun finds a recording in a file, and not only the layout of its views, or nothing."""
    import rerun.chunk as rrc

    try:
        return bool(rrc.RrdReader(path).recordings())
    except (RuntimeError, ValueError, OSError):
        return path.stat().st_size > _HEADER_BYTES


def _programs(path: Path) -> set[str]:
    """Return the names of the programs that made what is in a file, none when it does not come to say."""
    import rerun.chunk as rrc

    try:
        reader = rrc.RrdReader(path)
        return {store.application_id for store in (*reader.recordings(), *reader.blueprints())}
    except (RuntimeError, ValueError, OSError):
        return set()


def _columns(names: list[str], wanted: Wanted) -> list[int]:
    return [i for i, name in enumerate(names) if wanted is None or name in wanted]


def _take(entity: str, batch: "pa.RecordBatch", entities: _Entities, held: dict[str, list[str]] | None) -> None:
    columns = {name: batch.column(name) for name in batch.schema.names}
    if entity.startswith(_PROPERTIES):
        row_id = columns[_ROW_ID][-1].as_py()
        texts = entities.properties.setdefault(entity.removeprefix(_PROPERTIES), {})
        if row_id < entities.told.setdefault(entity, row_id):
            return
        entities.told[entity] = row_id
        for name, column in columns.items():
            if str(column.type) == "list<item: string>" and (words := column[-1].as_py()):
                texts[name] = words[0]
    elif {"TextLog:text", "TextLog:level", "t"} <= columns.keys():
        times = columns["t"].cast("int64").to_pylist()
        others = (columns[name].to_pylist() for name in (_ROW_ID, "TextLog:level", "TextLog:text"))
        written = zip(times, *others, strict=True)
        entities.events.extend((row_id, (t_ns / 1e9, level[0], text[0])) for t_ns, row_id, level, text in written)
    elif {"Scalars:scalars", "tick"} <= columns.keys():
        names = (held or {}).get(entity, [])
        ids = columns[_ROW_ID]
        row_ids = np.frombuffer(ids.buffers()[1], ">u8", count=2 * len(ids), offset=16 * ids.offset)
        values = columns["Scalars:scalars"].flatten().to_numpy()
        if len(values) != len(batch) * len(names):
            raise DamagedError(
                f"damaged: {entity} has {len(values)} values for {len(batch)} rows of {len(names)} signals"
            )
        wanted = _columns(names, entities.wanted)
        pieces = entities.pieces.setdefault(entity, _Pieces(len(wanted)))
        pieces.append(
            row_ids.astype(np.uint64).reshape(len(batch), 2),
            columns["tick"].to_numpy().copy(),
            values.reshape(len(batch), -1)[:, wanted],
        )


def _signals(held: dict[str, list[str]], entities: _Entities) -> dict[str, Series]:
    """Put the entities' parts in order and side by side."""
    joined: dict[str, tuple[list[str], _Part]] = {}
    for path, names in held.items():
        kept = [names[i] for i in _columns(names, entities.wanted)]
        if kept:
            pieces = entities.pieces.get(path)
            joined[path] = kept, _nothing(len(kept)) if pieces is None else pieces.in_order()
    ticks = [part.ticks for _, part in joined.values()]
    if not all(np.array_equal(one, ticks[0]) for one in ticks):
        # After a kill the last rows may have reached some entities only; after a repair any may lack some.
        common = functools.reduce(np.intersect1d, ticks)
        joined = {path: (names, _only(part, common)) for path, (names, part) in joined.items()}
    return {name: part.values[:, i] for names, part in joined.values() for i, name in enumerate(names)}


def _only(part: _Part, ticks: npt.NDArray[np.int64]) -> _Part:
    rows = np.isin(part.ticks, ticks)
    return _Part(part.row_ids[rows], part.ticks[rows], part.values[rows])


def _nothing(width: int) -> _Part:
    return _Part(np.empty((0, 2), np.uint64), np.empty(0, np.int64), np.empty((0, width)))


@contextmanager
def _whole_messages(path: Path) -> Iterator[tuple[Path, int | None]]:
    """Yield the file, or, if its last message was cut short, a temporary copy without that message.

    With it comes how many bytes were left out, as of ``Contents``.

    ``hil.review.reader`` says where temporary files go, and takes the copy away when rerun aborts this process.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        has_index = has_end(path, ".rrd")
        end = _end_of_messages(file, size, has_index=has_index)
        if end == size:
            yield path, None if has_index else 0
            return
        with tempfile.TemporaryDirectory() as directory:
            copy = Path(directory) / "whole.rrd"
            with copy.open("wb") as target:
                file.seek(0)
                for start in range(0, end, _COPY_BYTES):
                    target.write(file.read(min(_COPY_BYTES, end - start)))
            yield copy, size - end


def _end_of_messages(file: BinaryIO, size: int, *, has_index: bool) -> int:
    """Return where the last whole message ends; the size of the file when nothing was cut."""
    end = _HEADER_BYTES
    while True:
        file.seek(end)
        header = file.read(_MESSAGE.size)
        if len(header) < _MESSAGE.size:
            return min(end, size)
        kind, length = _MESSAGE.unpack(header)
        if end + _MESSAGE.size + length > size:
            return end
        end += _MESSAGE.size + length
        if kind == _END_MESSAGE:
            return size if has_index else end  # what follows the index is not a message


def main() -> int:
    """Write the answer; 1, with the reason alone in it, when the file cannot be read."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not get into the answer
    refuse_pandas()
    with output:
        try:
            decoded, signals = decode(Path(sys.argv[1]), json.loads(sys.argv[2]) if len(sys.argv) > 2 else None)
        except DamagedError as damage:
            output.write(json.dumps({"damage": str(damage)}).encode() + b"\n")
            return 1
        except ImportError as error:
            output.write(json.dumps({"missing": str(error)}).encode() + b"\n")
            return 1
        output.write(json.dumps(decoded).encode() + b"\n")
        for name in decoded["signals"]:
            output.write(np.ascontiguousarray(signals[name]).data)
    gc.freeze()  # else the interpreter's end goes through all modules once more, 0.08 s
    return 0


if __name__ == "__main__":
    sys.exit(main())
