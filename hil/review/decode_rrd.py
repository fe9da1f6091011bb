"""Decodes an .rrd recording, as ``hil.record.stream`` or rerun's own tools write it, also one without its end."""

import functools
import operator
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

from hil.record.files import has_end
from hil.record.properties import OVERLAY_PROPERTY, SIGNALS_PATH, SIGNALS_PROPERTY
from hil.review.contents import Contents, DamagedError, Selection, Series, json_property, why_nothing

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun.chunk import LazyChunkStream, RrdReader

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE = 0
_COPY_BYTES = 1 << 20
_GROWN_ROWS = 1 << 14
_PROPERTIES = "/__properties/"
_ROW_ID = "rerun.controls.RowId"
_TIME = "loop.t_s"


class _Piece(NamedTuple):
    """Rows of an entity: row ids (n, 2), which ascend in the order of writing, ticks (n,), values (n, signals)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    values: Series

    def select(self, rows: slice | npt.NDArray[Any]) -> "_Piece":
        """Return the selected rows."""
        return _Piece(self.row_ids[rows], self.ticks[rows], self.values[rows])

    def from_first(self, ticks: npt.NDArray[np.int64]) -> "_Piece":
        """Return it from the first of these ticks on, without values before its own first.

        A signal received live has an entity only from its first value on.
        """
        missing = ticks if not len(self.ticks) else ticks[ticks < self.ticks[0]]
        if not len(missing):
            return self
        nothing = np.full((len(missing), self.values.shape[1]), np.nan)
        ids = np.zeros((len(missing), 2), np.uint64)
        own = (np.append(missing, self.ticks), np.append(nothing, self.values, axis=0))
        return _Piece(np.append(ids, self.row_ids, axis=0), *own)


class _Pieces:
    """The rows read so far of an entity, in arrays that grow, because joining pieces later takes twice the memory."""

    def __init__(self, width: int) -> None:
        self._grown = _nothing(width)
        self._rows = 0

    def append(self, row_ids: npt.NDArray[np.uint64], ticks: npt.NDArray[np.int64], values: Series) -> None:
        """Add a copy of the next piece, with the shapes of ``_Piece``."""
        start, self._rows = self._rows, self._rows + len(values)
        for grown, piece in zip(self._grown, (row_ids, ticks, values), strict=True):
            if self._rows > len(grown):
                grown.resize((self._rows + _GROWN_ROWS, *grown.shape[1:]), refcheck=False)
            grown[start : self._rows] = piece

    def in_order(self) -> _Piece:
        """Return all rows in the order of writing."""
        read = self._grown.select(slice(self._rows))
        upper, lower = read.row_ids.T
        if ((upper[1:] > upper[:-1]) | ((upper[1:] == upper[:-1]) & (lower[1:] > lower[:-1]))).all():
            return read
        return read.select(np.lexsort((lower, upper)))


class _Entities:
    """The contents read from a file: the rows of the entities that hold signals, the properties and the events."""

    def __init__(self, selection: Selection) -> None:
        self.selection = selection
        self.pieces: dict[str, _Pieces] = {}
        self.properties: dict[str, dict[str, str]] = {}
        self.newest: dict[str, bytes] = {}  # the row id of each property's newest text
        self.events: list[tuple[bytes, tuple[float, str, str]]] = []  # with their row ids

    def held(self) -> dict[str, list[str]] | None:
        """Return which signals each entity holds; None until that property has been read."""
        return json_property(self.properties, SIGNALS_PROPERTY)


def decode_rrd(path: Path, selection: Selection) -> Contents:
    """Return the contents of an .rrd file; of one that was cut off, those before the cut. Raises DamagedError.

    A file whose index is damaged is read without it: every row is in the messages before it.
    """
    try:
        return _decoded(path, selection, has_index=has_end(path, ".rrd"))
    except DamagedError as damage:
        if not has_end(path, ".rrd"):
            raise
        try:
            contents = _decoded(path, selection, has_index=False)
        except DamagedError:
            raise damage from None
        return contents._replace(cut_bytes=None, damage=("its index cannot be read; every row was read without it",))


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
    events = [event for _, event in sorted(entities.events, key=operator.itemgetter(0))]
    return Contents(_signals(held, entities), events, entities.properties, cut_bytes)


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
    columns = {name: batch.column(name) for name in batch.schema.names}
    if entity.startswith(_PROPERTIES):
        row_id = columns[_ROW_ID][-1].as_py()
        texts = entities.properties.setdefault(entity.removeprefix(_PROPERTIES), {})
        if row_id < entities.newest.setdefault(entity, row_id):
            return
        entities.newest[entity] = row_id
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
            held_there = f"{len(values)} values for {len(batch)} rows of {len(names)} signals"
            raise DamagedError(f"damaged: {entity} has {held_there}")
        wanted = _columns(names, entities.selection)
        pieces = entities.pieces.setdefault(entity, _Pieces(len(wanted)))
        table = values.reshape(len(batch), -1)[:, wanted]
        pieces.append(row_ids.reshape(len(batch), 2), columns["tick"].to_numpy(), table)


def _signals(held: dict[str, list[str]], entities: _Entities) -> dict[str, Series]:
    """Return the signals of all entities, their rows in order."""
    joined: dict[str, tuple[list[str], _Piece]] = {}
    for path, names in held.items():
        kept = [names[i] for i in _columns(names, entities.selection)]
        if kept:
            pieces = entities.pieces.get(path)
            joined[path] = kept, _nothing(len(kept)) if pieces is None else pieces.in_order()
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
    return _Piece(np.empty((0, 2), np.uint64), np.empty(0, np.int64), np.empty((0, width)))


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
