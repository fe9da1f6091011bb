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
from hil.record.files import has_end
from hil.record.properties import OVERLAY_PROPERTY, SIGNALS_PATH, SIGNALS_PROPERTY
from hil.review.contents import (
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

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun.chunk import LazyChunkStream, RrdReader

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE, _STORE_MESSAGE = 0, 1
_COPY_BYTES = 1 << 20
_GROWN_ROWS = 1 << 14
_PROPERTIES = "/__properties/"
_ROW_ID = "rerun.controls.RowId"
_TEXTS = "list<item: string>"
_TIME = "loop.t_s"
_OTHER_BYTES = (
    "its bytes are not those that its recorder wrote: another program has written it again, or a part that only a "
    "viewer shows is damaged"
)


class _Piece(NamedTuple):
    """Rows of an entity: row ids (n, 2), which ascend in the order of writing, ticks and CRC-32 (n,), values (n, m)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    crcs: Words
    values: Series

    def select(self, rows: slice | npt.NDArray[Any]) -> "_Piece":
        """Return the selected rows."""
        return _Piece(self.row_ids[rows], self.ticks[rows], self.crcs[rows], self.values[rows])

    def from_first(self, ticks: npt.NDArray[np.int64]) -> "_Piece":
        """Return it from the first of these ticks on, without values before its own first.

        A signal received live has an entity only from its first value on.
        """
        missing = ticks if not len(self.ticks) else ticks[ticks < self.ticks[0]]
        if not len(missing):
            return self
        nothing = np.full((len(missing), self.values.shape[1]), np.nan)
        ids = np.zeros((len(missing), 2), np.uint64)
        crcs = np.append(np.zeros(len(missing), np.uint64), self.crcs)
        own = (np.append(missing, self.ticks), crcs, np.append(nothing, self.values, axis=0))
        return _Piece(np.append(ids, self.row_ids, axis=0), *own)


class _Pieces:
    """The rows read so far of an entity, in arrays that grow, because joining pieces later takes twice the memory."""

    def __init__(self, width: int) -> None:
        self._grown = _nothing(width)
        self.rows = 0

    def append(self, piece: _Piece) -> None:
        """Add a copy of the next piece."""
        start, self.rows = self.rows, self.rows + len(piece.values)
        for grown, own in zip(self._grown, piece, strict=True):
            if self.rows > len(grown):
                grown.resize((self.rows + _GROWN_ROWS, *grown.shape[1:]), refcheck=False)
            grown[start : self.rows] = own

    def in_order(self) -> _Piece:
        """Return all rows in the order of writing."""
        read = self._grown.select(slice(self.rows))
        return read.select(_order(read.row_ids))


def _order(row_ids: npt.NDArray[np.uint64]) -> slice | npt.NDArray[np.intp]:
    """Return the places that bring row ids of shape (n, 2) into ascending order."""
    upper, lower = row_ids.T
    if ((upper[1:] > upper[:-1]) | ((upper[1:] == upper[:-1]) & (lower[1:] > lower[:-1]))).all():
        return slice(None)
    return np.lexsort((lower, upper))


class _Entities:
    """The contents read from a file: the rows of the entities that hold signals, the properties and the events.

    rerun's tools may write columns of one row apart, in several chunks: its row id tells what belongs together.
    """

    def __init__(self, selection: Selection) -> None:
        self.selection = selection
        self.pieces: dict[str, _Pieces] = {}
        self.words: list[tuple[npt.NDArray[np.uint64], Words]] = []  # row ids (n, 2) and words (n,)
        self.properties: dict[str, dict[bytes, dict[str, str]]] = {}  # by name and row id
        self.events: dict[bytes, dict[str, Any]] = {}  # by row id
        self.senseless: list[str] = []

    def rows(self, path: str, width: int) -> _Piece:
        """Return the rows of an entity that holds so many of the selected signals, in the order of writing."""
        pieces = self.pieces.get(path)
        return _nothing(width) if pieces is None else pieces.in_order()

    def newest(self) -> Properties:
        """Return the newest texts of each property."""
        properties = Properties()
        for name, texts in self.properties.items():
            properties.read(name, texts[max(texts)])
        return properties

    def held(self) -> dict[str, list[str]] | None:
        """Return which signals each entity holds; None until that property has been read."""
        names = self.properties.get(SIGNALS_PROPERTY)
        texts = [texts for _, texts in sorted(names.items()) if "json" in texts] if names else []
        return json_property({SIGNALS_PROPERTY: texts[-1]}, SIGNALS_PROPERTY) if texts else None

    def numbered_events(self) -> tuple[list[NumberedEvent], int]:
        """Return the events in the order of writing, and how many differ from their check values and are not there."""
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

    entities = _Entities(selection)
    with _whole_messages(path, has_index=has_index) as (readable, cut_bytes), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "has no footer": it has none after a kill
        try:
            stream = _indexed(rrc.RrdReader(readable))
            held: dict[str, list[str]] | None = None
            early: list[pa.RecordBatch] = []  # rerun's own tools may put rows before the names of their signals
            for chunk in stream().filter(content=["/__properties/**", "/events", SIGNALS_PATH]):
                held = held or entities.held()
                if held is None and chunk.entity_path == SIGNALS_PATH:
                    early.append(chunk.to_record_batch())
                else:
                    _add(chunk.entity_path, chunk.to_record_batch(), entities, held)
            held = entities.held()
            while early:
                _add(SIGNALS_PATH, early.pop(0), entities, held)
            if held is None:
                if OVERLAY_PROPERTY in entities.properties:
                    raise DamagedError("an overlay of two runs")
                raise DamagedError(why_nothing(_stores(readable)[1], cut_bytes))
            # Recordings received live, and older files, have their signals in the entities that are drawn.
            drawn = [path for path, names in held.items() if path != SIGNALS_PATH and _columns(names, selection)]
            if drawn:
                for chunk in stream().filter(content=drawn):
                    _add(chunk.entity_path, chunk.to_record_batch(), entities, held)
        except (RuntimeError, ValueError, OSError) as error:
            holds_recording, programs = _stores(readable)
            if cut_bytes is not None and not holds_recording:
                raise DamagedError(why_nothing(programs, cut_bytes)) from error
            what = str(error).removeprefix(f"Failed to read RRD file at {readable}: ")
            raise DamagedError(f"damaged: {what}") from error
    return _compared(path, entities, held, cut_bytes)


def _compared(path: Path, entities: _Entities, held: dict[str, list[str]], cut_bytes: int | None) -> Contents:
    """Return the contents without what differs from its check value, and say what is missing."""
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
    if not properties.has_checks:
        old = "a version without check values recorded it: damage that changes its values cannot be noticed"
        return Contents(_signals(held, entities), events, properties, cut_bytes, tuple(damage), remarks=(old,))
    if list(held) != [SIGNALS_PATH]:
        live = "it was received live: its rows have no check values, and damage that changes them cannot be noticed"
        signals = _signals(held, entities)
        return Contents(signals, events, properties, cut_bytes, tuple(damage), 0, lost_events, remarks=(live,))
    names = [held[SIGNALS_PATH][i] for i in _columns(held[SIGNALS_PATH], entities.selection)]
    written = entities.rows(SIGNALS_PATH, len(names))
    stored, whole = _whole_rows(written, entities.words)
    rows = numbered_rows(stored, whole.values, names, properties)
    damage += rows.damage
    if (more := max(0, len(written.ticks) - len(stored) - rows.lost)) > 0:  # at an end that no number tells
        damage.append(f"{more} rows differ from their check values and are left out")
    if not damage and not _has_its_bytes(path, properties):
        rows.remarks.append(_OTHER_BYTES)
    told = tuple(damage), rows.lost + more, lost_events, rows.numbers, tuple(rows.remarks)
    return Contents(rows.signals, events, properties, cut_bytes, *told)


def _whole_rows(rows: _Piece, words: list[tuple[npt.NDArray[np.uint64], Words]]) -> tuple[Words, _Piece]:
    """Return numbers and rows of those that agree with their words; each row's word has the same row id."""
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
    """Return the contents of the messages that rerun can read. Raises ``damage`` if that is no recording."""
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


def _columns(names: list[str], selection: Selection) -> list[int]:
    return [i for i, name in enumerate(names) if selection is None or name in selection]


def _add(entity: str, batch: "pa.RecordBatch", entities: _Entities, held: dict[str, list[str]] | None) -> None:
    try:
        _take(entity, batch, entities, held)
    except (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        entities.senseless.append(f"{entity} has {str(error).partition(chr(10))[0] or type(error).__name__}")


def _take(entity: str, batch: "pa.RecordBatch", entities: _Entities, held: dict[str, list[str]] | None) -> None:
    columns = {name: batch.column(name) for name in batch.schema.names}
    row_ids = [one.as_py() for one in columns[_ROW_ID]] if entity != SIGNALS_PATH else []
    if entity.startswith(_PROPERTIES):
        texts = entities.properties.setdefault(entity.removeprefix(_PROPERTIES), {})
        for name, column in columns.items():
            if str(column.type) == _TEXTS:
                for row_id, words in zip(row_ids, column.to_pylist(), strict=True):
                    texts.setdefault(row_id, {}).update({name: words[0]} if words else {})
        return
    if entity == "/events":
        parts = {"level": "TextLog:level", "text": "TextLog:text", "word": WORDS}
        for row_id, t_ns in zip(row_ids, columns["t"].cast("int64").to_pylist(), strict=True):
            entities.events.setdefault(row_id, {})["t_ns"] = t_ns
        for part, name in parts.items():
            if name in columns:
                for row_id, [content] in zip(row_ids, columns[name].to_pylist(), strict=True):
                    entities.events[row_id][part] = content
        return
    ids = columns[_ROW_ID]
    rows = np.frombuffer(ids.buffers()[1], ">u8", count=2 * len(ids), offset=16 * ids.offset).reshape(len(ids), 2)
    if "Scalars:scalars" in columns and "tick" in columns:
        names = (held or {}).get(entity, [])
        values = columns["Scalars:scalars"].flatten().to_numpy()
        if len(values) != len(batch) * len(names):
            raise ValueError(f"{len(values)} values for {len(batch)} rows of {len(names)} signals")
        wanted = _columns(names, entities.selection)
        table, ticks = values.reshape(len(batch), -1), columns["tick"].to_numpy()
        crcs = np.zeros(len(batch), np.uint64)
        if entity == SIGNALS_PATH:
            crcs = row_crcs(columns["t"].cast("int64").to_numpy(), ticks, table)
        pieces = entities.pieces.setdefault(entity, _Pieces(len(wanted)))
        pieces.append(_Piece(rows, ticks, crcs, table[:, wanted]))
    if WORDS in columns and entity == SIGNALS_PATH:
        stored = columns[WORDS].flatten().to_numpy()
        if len(stored) != len(batch):
            raise ValueError(f"{len(stored)} check values for {len(batch)} rows")
        entities.words.append((rows.astype(np.uint64), stored))


def _signals(held: dict[str, list[str]], entities: _Entities) -> dict[str, Series]:
    """Return the signals of all entities, their rows in order."""
    joined: dict[str, tuple[list[str], _Piece]] = {}
    for path, names in held.items():
        kept = [names[i] for i in _columns(names, entities.selection)]
        if kept:
            joined[path] = kept, entities.rows(path, len(kept))
    clock = next((part for names, part in joined.values() if _TIME in names), None)
    if clock is not None:
        joined = {path: (names, part.from_first(clock.ticks)) for path, (names, part) in joined.items()}
    ticks = [part.ticks for _, part in joined.values()]
    if not all(np.array_equal(one, ticks[0]) for one in ticks):
        # After a kill some entities may lack the last rows; after a repair any may lack some.
        common = functools.reduce(np.intersect1d, ticks)
        joined = {path: (names, part.select(np.isin(part.ticks, common))) for path, (names, part) in joined.items()}
    return {name: part.values[:, i] for names, part in joined.values() for i, name in enumerate(names)}


def _nothing(width: int) -> _Piece:
    return _Piece(np.empty((0, 2), np.uint64), np.empty(0, np.int64), np.empty(0, np.uint64), np.empty((0, width)))


@contextmanager
def _whole_messages(path: Path, *, has_index: bool) -> Iterator[tuple[Path, int | None]]:
    """Yield the path to read, and how many bytes were left out (``Contents.cut_bytes``).

    The path is the file's own or, if its last message was cut short, that of a temporary copy without that message.
    Without ``has_index`` everything after the messages is left out too. ``hil.review.reader`` chooses the folder of
    temporary files, and removes the copy if rerun aborts this process.
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
