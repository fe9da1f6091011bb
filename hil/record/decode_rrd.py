"""Decodes an .rrd recording, as ``hil.record.stream`` or rerun's own tools write it, also one without its end."""

import contextlib
import functools
import os
import struct
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.record.checks import WORDS, Words, WrittenBytes, event_check, numbered, row_crcs
from hil.record.contents import (
    NO_INDEX,
    Contents,
    DamagedError,
    NumberedEvent,
    Properties,
    Selection,
    Series,
    json_property,
    numbered_events,
    numbered_rows,
    why_nothing,
)
from hil.record.files import has_end
from hil.record.properties import EVENTS_PATH, JOURNAL_PATH, OVERLAY_PROPERTY, SIGNALS_PATH, SIGNALS_PROPERTY

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun.chunk import Chunk, LazyChunkStream, RrdReader

    Columns = dict[str, pa.Array]

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE, _STORE_MESSAGE = 0, 1
_COPY_BYTES = 1 << 20
_GROWN_ROWS = 1 << 14  # room for further rows when an array of ``_Pieces`` grows
_PROPERTIES = "/__properties/"
_ROW_ID = "rerun.controls.RowId"
_TEXTS = "list<item: string>"
_OTHER_BYTES = (
    "its bytes are not those that its recorder wrote: another program has written it again, or a part that only a "
    "viewer shows is damaged"
)


class _Piece(NamedTuple):
    """Rows of an entity: rerun's row ids (n, 2), ascending in order of writing, ticks, CRC-32 (n,), values (n, m)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    crcs: Words
    values: Series

    def select(self, rows: slice | npt.NDArray[Any]) -> "_Piece":
        return _Piece(self.row_ids[rows], self.ticks[rows], self.crcs[rows], self.values[rows])


class _Pieces:
    """The rows read so far of an entity, in arrays that grow, because joining pieces later takes twice the memory."""

    def __init__(self, width: int) -> None:
        ticks, crcs = np.empty(0, np.int64), np.empty(0, np.uint64)
        self._grown = _Piece(np.empty((0, 2), np.uint64), ticks, crcs, np.empty((0, width)))
        self._rows = 0

    def append(self, piece: _Piece) -> None:
        """Add a copy of the next piece."""
        start, self._rows = self._rows, self._rows + len(piece.values)
        for grown, own in zip(self._grown, piece, strict=True):
            if self._rows > len(grown):
                grown.resize((self._rows + _GROWN_ROWS, *grown.shape[1:]), refcheck=False)
            grown[start : self._rows] = own

    def in_order(self) -> _Piece:
        """Return all rows in the order of writing."""
        read = self._grown.select(slice(self._rows))
        return read.select(_order(read.row_ids))


def _order(row_ids: npt.NDArray[np.uint64]) -> slice | npt.NDArray[np.intp]:
    """Return the index that sorts row ids of shape (n, 2) in ascending order."""
    upper, lower = row_ids.T
    if ((upper[1:] > upper[:-1]) | ((upper[1:] == upper[:-1]) & (lower[1:] > lower[:-1]))).all():
        return slice(None)
    return np.lexsort((lower, upper))


class _Entities:
    """The contents read from a file: first the properties and the events, then the rows of each entity with signals.

    rerun's tools may write columns of one row apart, in several chunks: its row id tells what belongs together.
    """

    def __init__(self) -> None:
        self.names: dict[str, list[str]] = {}  # of the signals of each entity
        self.columns: dict[str, list[int]] = {}  # of the selected ones
        self.pieces: dict[str, _Pieces] = {}
        self.words: list[tuple[npt.NDArray[np.uint64], Words]] = []  # row ids (n, 2) and check values (n,)
        self.properties: dict[str, dict[bytes, dict[str, str]]] = {}  # by name and row id
        self.events: dict[bytes, dict[str, Any]] = {}  # by row id
        self.senseless: list[str] = []  # why chunks were left out

    def add(self, chunk: "Chunk") -> None:
        """Add a chunk, or note that it makes no sense."""
        entity, batch = chunk.entity_path, chunk.to_record_batch()
        columns = {name: batch.column(name) for name in batch.schema.names}
        try:
            if entity.startswith(_PROPERTIES):
                self._add_property(entity.removeprefix(_PROPERTIES), columns)
            elif entity in (EVENTS_PATH, JOURNAL_PATH):
                self._add_events(columns)
            else:
                self._add_rows(entity, columns)
        except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
            self.senseless.append(f"{entity} has {str(error).partition(chr(10))[0] or type(error).__name__}")

    def _add_property(self, name: str, columns: "Columns") -> None:
        texts = self.properties.setdefault(name, {})
        row_ids = [one.as_py() for one in columns[_ROW_ID]]
        for key, column in columns.items():
            if str(column.type) == _TEXTS:
                for row_id, words in zip(row_ids, column.to_pylist(), strict=True):
                    texts.setdefault(row_id, {}).update({key: words[0]} if words else {})

    def _add_events(self, columns: "Columns") -> None:
        row_ids = [one.as_py() for one in columns[_ROW_ID]]
        for row_id, t_ns in zip(row_ids, columns["t"].cast("int64").to_pylist(), strict=True):
            self.events.setdefault(row_id, {})["t_ns"] = t_ns
        for part, name in {"level": "TextLog:level", "text": "TextLog:text", "word": WORDS}.items():
            if name in columns:
                for row_id, [content] in zip(row_ids, columns[name].to_pylist(), strict=True):
                    self.events[row_id][part] = content

    def _add_rows(self, entity: str, columns: "Columns") -> None:
        ids, names = columns[_ROW_ID], self.names.get(entity, [])
        count = len(ids)
        row_ids = np.frombuffer(ids.buffers()[1], ">u8", count=2 * count, offset=16 * ids.offset).reshape(count, 2)
        if "Scalars:scalars" in columns and "tick" in columns:
            values = columns["Scalars:scalars"].flatten().to_numpy()
            if len(values) != count * len(names):
                raise ValueError(f"{len(values)} values for {count} rows of {len(names)} signals")
            table, ticks, crcs = values.reshape(count, -1), columns["tick"].to_numpy(), np.zeros(count, np.uint64)
            if entity == SIGNALS_PATH:
                crcs = row_crcs(columns["t"].cast("int64").to_numpy(), ticks, table)
            self.pieces[entity].append(_Piece(row_ids, ticks, crcs, table[:, self.columns[entity]]))
        if WORDS in columns and entity == SIGNALS_PATH:
            stored = columns[WORDS].flatten().to_numpy()
            if len(stored) != count:
                raise ValueError(f"{len(stored)} check values for {count} rows")
            self.words.append((row_ids.astype(np.uint64), stored))

    def newest(self) -> Properties:
        """Return the newest texts of each property."""
        properties = Properties()
        for name, texts in self.properties.items():
            properties.read(name, texts[max(texts)])
        return properties

    def find_signals(self, selection: Selection) -> list[str] | None:
        """Take the names of the signals from their property; return the entities to read, None without the property.

        Raises DamagedError for a file without rows: an overlay of two runs, or a live view that was saved.
        """
        if OVERLAY_PROPERTY in self.properties:
            raise DamagedError("an overlay of two runs")
        texts = [own for _, own in sorted(self.properties.get(SIGNALS_PROPERTY, {}).items()) if "json" in own]
        held = json_property({SIGNALS_PROPERTY: texts[-1]}, SIGNALS_PROPERTY) if texts else None
        if held == {}:
            raise DamagedError("a live view that was saved, without its rows")
        for entity, names in (held or {}).items():
            columns = [i for i, name in enumerate(names) if selection is None or name in selection]
            if columns or entity == SIGNALS_PATH:
                self.names[entity], self.columns[entity] = names, columns
                self.pieces[entity] = _Pieces(len(columns))
        return None if held is None else list(self.pieces)

    def signals(self) -> dict[str, Series]:
        """Return the signals of all entities, in the ticks that all have: for recordings without check values.

        Such versions wrote one entity for each plot. After a kill or a repair some entities may lack rows.
        """
        rows = {entity: pieces.in_order() for entity, pieces in self.pieces.items()}
        if rows:
            ticks = functools.reduce(np.intersect1d, [one.ticks for one in rows.values()])
            rows = {entity: one.select(np.isin(one.ticks, ticks)) for entity, one in rows.items()}
        return {
            self.names[entity][column]: one.values[:, i]
            for entity, one in rows.items()
            for i, column in enumerate(self.columns[entity])
        }

    def numbered_events(self) -> tuple[list[NumberedEvent], int]:
        """Return the events in the order of writing, and the number of those left out: incomplete or damaged."""
        found: list[NumberedEvent] = []
        for _, event in sorted(self.events.items()):
            if not {"t_ns", "level", "text"} <= event.keys():
                continue
            word, number = event.get("word"), None
            if word is not None:
                number = word >> 32
                if event_check(number, event["t_ns"], event["level"], event["text"]) != word:
                    continue
            found.append((number, (event["t_ns"] / 1e9, event["level"], event["text"])))
        return found, len(self.events) - len(found)


def decode_rrd(path: Path, selection: Selection) -> Contents:
    """Return the contents of an .rrd file; of one that was cut off, those before the cut. Raises DamagedError.

    A file whose index is damaged is read without it: every row is in the messages before it. A message that rerun
    cannot read is left out.
    """
    is_whole = has_end(path, ".rrd")
    try:
        contents = _decoded(path, selection, has_index=is_whole)
        if not contents.damage or not is_whole:
            return contents
    except DamagedError as damage:
        first, contents = damage, None
    if is_whole:
        with contextlib.suppress(DamagedError):
            without = _decoded(path, selection, has_index=False)
            if not without.damage:
                return without._replace(cut_bytes=None, damage=(NO_INDEX,))
    if contents is None:
        contents = _rescued(path, selection, first, has_index=is_whole)
    return contents


def _decoded(path: Path, selection: Selection, *, has_index: bool) -> Contents:
    import rerun.chunk as rrc

    entities = _Entities()
    with _whole_messages(path, has_index=has_index) as (readable, cut_bytes), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "has no footer": it has none after a kill
        try:
            stream = _indexed(rrc.RrdReader(readable))
            for chunk in stream().filter(content=["/__properties/**", EVENTS_PATH, JOURNAL_PATH]):
                entities.add(chunk)
            if (found := entities.find_signals(selection)) is None:
                raise DamagedError(why_nothing(_stores(readable)[1], cut_bytes))
            for chunk in stream().filter(content=found):
                entities.add(chunk)
        except (RuntimeError, ValueError, OSError) as error:
            holds_recording, programs = _stores(readable)
            if cut_bytes is not None and not holds_recording:
                raise DamagedError(why_nothing(programs, cut_bytes)) from error
            what = str(error).removeprefix(f"Failed to read RRD file at {readable}: ")
            raise DamagedError(f"damaged: {what}") from error
    return _compared(path, entities, cut_bytes)


def _compared(path: Path, entities: _Entities, cut_bytes: int | None) -> Contents:
    """Return the contents that match their check values, with sentences on the missing ones."""
    properties = entities.newest()
    damage = properties.damage()
    if entities.senseless:
        senseless = f"{len(entities.senseless)} of its messages make no sense"
        if not properties.has_checks:  # nothing would tell what is missing
            raise DamagedError(f"damaged: {senseless}: {entities.senseless[0]}")
        damage.insert(0, f"{senseless} and are left out")
    read, differ = entities.numbered_events()
    events, lost_events, of_events = numbered_events(read, properties, differ)
    damage += of_events
    if not properties.has_checks or SIGNALS_PATH not in entities.names:
        old = "a version without check values recorded it: damage that changes its values cannot be noticed"
        return Contents(entities.signals(), events, properties, cut_bytes, tuple(damage), remarks=(old,))
    names = [entities.names[SIGNALS_PATH][i] for i in entities.columns[SIGNALS_PATH]]
    written = entities.pieces[SIGNALS_PATH].in_order()
    stored, whole = _whole_rows(written, entities.words)
    rows = numbered_rows(stored, whole.values, names, properties)
    damage += rows.damage
    if (more := max(0, len(written.ticks) - len(stored) - rows.lost)) > 0:  # at the end, where no number is missing
        damage.append(f"{more} rows differ from their check values and are left out")
    if not damage and not _has_its_bytes(path, properties):
        rows.remarks.append(_OTHER_BYTES)
    told = tuple(damage), rows.lost + more, lost_events, rows.numbers, tuple(rows.remarks)
    return Contents(rows.signals, events, properties, cut_bytes, *told)


def _whole_rows(rows: _Piece, words: list[tuple[npt.NDArray[np.uint64], Words]]) -> tuple[Words, _Piece]:
    """Return numbers and contents of the rows that agree with their check values (``words``), found by row id."""
    ids = np.concatenate([np.empty((0, 2), np.uint64), *(one for one, _ in words)])
    stored = np.concatenate([np.empty(0, np.uint64), *(one for _, one in words)])
    order = _order(ids)
    ids, stored = ids[order], stored[order]
    if not np.array_equal(ids, rows.row_ids):
        pair = np.dtype([("upper", np.uint64), ("lower", np.uint64)])
        own, others = (np.ascontiguousarray(one).view(pair).ravel() for one in (rows.row_ids, ids))
        _, here, there = np.intersect1d(own, others, return_indices=True)
        rows, stored = rows.select(here), stored[there]
    numbers = stored >> np.uint64(32)
    whole = numbered(numbers, rows.crcs) == stored
    return (numbers, rows) if whole.all() else (numbers[whole], rows.select(whole))


def _has_its_bytes(path: Path, properties: Properties) -> bool:
    """Whether the file has the bytes that its recorder wrote before its end, or none are known."""
    end = properties.end
    if "bytes" not in end:
        return True
    written = WrittenBytes(path)
    written.read(end["bytes"])
    written.close()
    return (written.count, written.crc32) == (end["bytes"], end["crc32"])


def _rescued(path: Path, selection: Selection, damage: DamagedError, *, has_index: bool) -> Contents:
    """Return the contents of the messages that rerun can read. Raises ``damage`` if these make no recording."""
    with path.open("rb") as file, tempfile.TemporaryDirectory() as directory:
        copy = Path(directory) / "part.rrd"
        messages = list(_messages(file))
        # rerun reads nothing of a store before the message that introduces it.
        stores = [(0, _HEADER_BYTES), *(span for kind, span in messages if kind == _STORE_MESSAGE)]
        spans = [span for kind, span in messages if kind not in (_STORE_MESSAGE, _END_MESSAGE)]

        def write(chosen: list[tuple[int, int]]) -> None:
            with copy.open("wb") as target:
                for begin, end in stores + chosen:
                    file.seek(begin)
                    target.write(file.read(end - begin))

        def readable(chosen: list[tuple[int, int]]) -> list[tuple[int, int]]:
            write(chosen)
            if not chosen or _is_readable(copy):
                return chosen
            half = len(chosen) // 2
            return readable(chosen[:half]) + readable(chosen[half:]) if half else []

        whole = readable(spans)
        write(whole)
        try:
            contents = _decoded(copy, selection, has_index=False)
        except DamagedError:
            raise damage from None
    left = f"{len(spans) - len(whole)} of its {len(spans)} messages cannot be read"
    cut_bytes = None if has_index else contents.cut_bytes
    return contents._replace(cut_bytes=cut_bytes, damage=(left, *contents.damage), remarks=())


def _is_readable(path: Path) -> bool:
    import rerun.chunk as rrc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            for chunk in rrc.RrdReader(path).stream():
                chunk.to_record_batch()
        except (RuntimeError, ValueError, OSError):
            return False
    return True


def _indexed(reader: "RrdReader") -> "Callable[[], LazyChunkStream]":
    """Return the function that streams chunks: with an index only the wanted ones, without one the whole file."""
    try:
        return reader.store().stream
    except (RuntimeError, ValueError, OSError):
        return reader.stream


def _stores(path: Path) -> tuple[bool, set[str]]:
    """Return whether rerun finds a recording in a file, and the names of the programs that made the file's content.

    A blueprint (a layout of views) alone is not a recording. A file that rerun cannot read counts as a recording, of no
    known program, if it is longer than its header.
    """
    import rerun.chunk as rrc

    try:
        reader = rrc.RrdReader(path)
        recordings = reader.recordings()
        return bool(recordings), {store.application_id for store in (*recordings, *reader.blueprints())}
    except (RuntimeError, ValueError, OSError):
        return path.stat().st_size > _HEADER_BYTES, set()


@contextmanager
def _whole_messages(path: Path, *, has_index: bool) -> Iterator[tuple[Path, int | None]]:
    """Yield the path to read, and how many bytes were left out (``Contents.cut_bytes``).

    If the last message was cut short, it is a temporary copy without that message; without ``has_index`` everything
    after the messages is left out too. ``hil.record.reader`` removes the copy if rerun aborts this process.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
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


def _messages(file: BinaryIO) -> Iterator[tuple[int, tuple[int, int]]]:
    """Yield the kind of each whole message, and where it begins and ends. The last is that of the index, if it came."""
    size = file.seek(0, os.SEEK_END)
    begin, kind = _HEADER_BYTES, None
    while kind != _END_MESSAGE and begin + _MESSAGE.size <= size:
        file.seek(begin)
        kind, length = _MESSAGE.unpack(file.read(_MESSAGE.size))
        end = begin + _MESSAGE.size + length
        if end > size:
            return
        yield kind, (begin, end)
        begin = end


def _end_of_messages(file: BinaryIO, size: int, *, has_index: bool) -> int:
    """Return where the last whole message ends; the size of the file when nothing was cut."""
    kind, (_, end) = [(None, (0, min(_HEADER_BYTES, size))), *_messages(file)][-1]
    return size if has_index and kind == _END_MESSAGE else end  # what follows the index is not a message
