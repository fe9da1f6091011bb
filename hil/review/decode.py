"""Decoding of a recording, in a process of its own: ``python -m hil.review.decode RUN.rrd [SIGNAL ...]``.

rerun's reader aborts its whole process on some damaged files; ``hil.review.reader`` starts this one and outlives it.
The answer on standard output is one line of JSON (``Decoded``), then the values as float64, signal by signal.
"""

import functools
import json
import os
import struct
import sys
import tempfile
import warnings
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt

from hil.telemetry.names import RECORDER_PROPERTY, RUN_PROPERTY, SIGNALS_PROPERTY, SUMMARY_PROPERTY

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun.chunk import Chunk

Series = npt.NDArray[np.float64]

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE = 0
_COPY_BYTES = 1 << 20
_PROPERTIES = "/__properties/"
_EVENTS = "/events"


class Decoded(TypedDict):
    """What the answer's first line holds; ``signals`` names the rows of the table that follows.

    ``held`` names all signals of the recording, asked for or not. ``repairs`` has a sentence for each thing that was
    wrong with the file and what was lost by it.
    """

    signals: list[str]
    held: list[str]
    rows: int
    events: list[tuple[float, str, str]]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None
    repairs: list[str]


class DamagedError(Exception):
    """The file cannot be read as a recording of a run; the text says what is wrong with it."""


class _Part(NamedTuple):
    """A chunk of an entity: id of its first row, ticks (n,), values (signals, n) in the order of writing."""

    row_id: tuple[int, int]
    ticks: npt.NDArray[np.int64]
    values: Series


class _Entity(NamedTuple):
    """An entity of the recording: the places of the wanted signals in its vector, and its chunks."""

    width: int
    wanted: list[int]
    parts: list[_Part]


class _Contents(NamedTuple):
    entities: dict[str, _Entity]
    properties: dict[str, dict[str, str]]
    events: list[tuple[float, str, str]]
    ticks: dict[bytes, npt.NDArray[np.int64]]  # entities of one row have the same: kept once


def decode(path: Path, wanted: Collection[str] | None = None) -> tuple[Decoded, dict[str, Series]]:
    """Return what a recording holds, and its signals by name, or those of them that are wanted. Raises DamagedError."""
    decoded, signals = _decoded(path, wanted)
    return decoded, dict(signals)


def _decoded(path: Path, wanted: Collection[str] | None) -> tuple[Decoded, Iterator[tuple[str, Series]]]:
    """Return what a recording holds, and its signals one after the other: what was taken is kept no longer."""
    repairs: list[str] = []
    with _whole_messages(path, repairs) as readable, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "has no footer": so it is, after a kill
        try:
            held = _held(readable)
            contents = _contents(readable, held, wanted)
        except (RuntimeError, ValueError, OSError) as error:
            what = str(error).removeprefix(f"Failed to read RRD file at {readable}: ")
            raise DamagedError(f"damaged: {what}") from error
    recorder = _json(contents.properties, RECORDER_PROPERTY)
    if recorder is None and not repairs:
        repairs.append("it has no end: the recorder was killed, and what it had not yet written is lost")
    kept = _kept_rows(contents.entities, repairs)
    decoded = Decoded(
        signals=[names[i] for path_, names in held.items() for i in contents.entities[path_].wanted],
        held=[name for names in held.values() for name in names],
        rows=kept.rows,
        events=sorted(contents.events, key=lambda event: event[0]),
        properties=contents.properties.get(RUN_PROPERTY, {}),
        summary=_json(contents.properties, SUMMARY_PROPERTY),
        rows_dropped=None if recorder is None else recorder.get("rows_dropped"),
        repairs=repairs,
    )
    return decoded, _columns(held, contents.entities, kept)


def _held(path: Path) -> dict[str, list[str]]:
    """Return which signals each entity holds: the recording begins with it."""
    properties: dict[str, dict[str, str]] = {}
    for chunk in _stream(path, [f"{_PROPERTIES}{SIGNALS_PROPERTY}"]):
        _take_property(chunk.entity_path, _columns_of(chunk), properties)
        if (held := _json(properties, SIGNALS_PROPERTY)) is not None:
            return held
    raise DamagedError("a recording of another program")


def _contents(path: Path, held: dict[str, list[str]], wanted: Collection[str] | None) -> _Contents:
    """Read the entities that hold what is wanted, and all that is no signal."""
    entities = {
        entity: _Entity(len(names), [i for i, name in enumerate(names) if wanted is None or name in wanted], [])
        for entity, names in held.items()
    }
    contents = _Contents(entities, {}, [], {})
    needed = [entity for entity, one in entities.items() if one.wanted]
    for chunk in _stream(path, [f"{_PROPERTIES}**", _EVENTS, *(needed or list(entities)[:1])]):
        _take(chunk.entity_path, _columns_of(chunk), contents)
    contents.ticks.clear()
    return contents


def _stream(path: Path, entities: list[str]) -> Iterator["Chunk"]:
    """Yield the chunks of these entities: by the file's own index where it has one, without reading the rest."""
    import rerun.chunk as rrc

    reader = rrc.RrdReader(path)
    try:
        stream = reader.store().stream()
    except (RuntimeError, ValueError, OSError):
        stream = reader.stream()  # no footer: all is looked at
    yield from stream.filter(content=entities)


def _columns_of(chunk: "Chunk") -> dict[str, "pa.Array"]:
    batch = chunk.to_record_batch()
    return {name: batch.column(name) for name in batch.schema.names}


def _json(properties: dict[str, dict[str, str]], name: str) -> dict[str, Any] | None:
    """Return a property that holds a JSON object, or None when the recording does not have it."""
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


def _take_property(entity: str, columns: dict[str, "pa.Array"], properties: dict[str, dict[str, str]]) -> None:
    texts = properties.setdefault(entity.removeprefix(_PROPERTIES), {})
    for name, column in columns.items():
        if str(column.type) == "list<item: string>" and (held := column[-1].as_py()):
            texts[name] = held[0]


def _take(entity: str, columns: dict[str, "pa.Array"], contents: _Contents) -> None:
    if entity.startswith(_PROPERTIES):
        _take_property(entity, columns, contents.properties)
    elif {"TextLog:text", "TextLog:level", "t"} <= columns.keys():
        times = columns["t"].cast("int64").to_pylist()
        levels, texts = (columns[f"TextLog:{name}"].to_pylist() for name in ("level", "text"))
        contents.events.extend(
            (t_ns / 1e9, level[0], text[0]) for t_ns, level, text in zip(times, levels, texts, strict=True)
        )
    elif {"Scalars:scalars", "tick"} <= columns.keys() and entity in contents.entities:
        one = contents.entities[entity]
        ids = columns["rerun.controls.RowId"]
        first = np.frombuffer(ids.buffers()[1], ">u8", count=2, offset=16 * ids.offset)
        values = columns["Scalars:scalars"].flatten().to_numpy()
        if len(values) != len(ids) * one.width:
            found = len(values) // max(1, len(ids))
            raise DamagedError(f"damaged: {entity} has {found} values for {one.width} signals")
        ticks = np.array(columns["tick"].to_numpy(), dtype=np.int64)
        ticks = contents.ticks.setdefault(ticks.tobytes(), ticks)
        # A copy of what is wanted: the chunk's own buffers hold its row ids and times too.
        kept = np.ascontiguousarray(values.reshape(-1, one.width)[:, one.wanted].T)
        one.parts.append(_Part((int(first[0]), int(first[1])), ticks, kept))


class _Kept(NamedTuple):
    """The rows that every entity has: how many, and for each entity which of its own, or None for all of them."""

    rows: int
    places: dict[str, npt.NDArray[np.intp] | None]


def _kept_rows(entities: dict[str, _Entity], repairs: list[str]) -> _Kept:
    """Put the chunks of each entity in the order of writing, and find the rows that all of them have."""
    ticks: dict[str, npt.NDArray[np.int64]] = {}
    for path, entity in entities.items():
        if entity.wanted or entity.parts:
            entity.parts.sort(key=lambda part: part.row_id)
            ticks[path] = np.concatenate([part.ticks for part in entity.parts] or [np.empty(0, np.int64)])
    first = next(iter(ticks.values()), np.empty(0, np.int64))
    if all(np.array_equal(one, first) for one in ticks.values()):
        return _Kept(len(first), dict.fromkeys(ticks))
    # After a kill the last rows may have reached some entities only; after a repair any may lack some.
    common = functools.reduce(np.intersect1d, ticks.values())
    most = max(map(len, ticks.values()))
    repairs.append(f"{most - len(common)} of {most} rows are there in part only, and were left out")
    return _Kept(len(common), {path: np.flatnonzero(np.isin(one, common)) for path, one in ticks.items()})


def _columns(held: dict[str, list[str]], entities: dict[str, _Entity], kept: _Kept) -> Iterator[tuple[str, Series]]:
    """Yield the wanted signals, each as one array."""
    for path, names in held.items():
        _, wanted, parts = entities.pop(path)
        for place, i in enumerate(wanted):
            whole = np.concatenate([part.values[place] for part in parts] or [np.empty(0)])
            places = kept.places[path]
            yield names[i], whole if places is None else whole[places]


@contextmanager
def _whole_messages(path: Path, repairs: list[str]) -> Iterator[Path]:
    """Yield the file, or, if its last message was cut short, a temporary copy without that message."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        end = _end_of_messages(file, size)
        if end == size:
            yield path
            return
        cut = f", and its last {size - end} bytes are a message that was cut short" if size > end else ""
        repairs.append(f"it has no end: the recorder was killed or the file was cut{cut}; what came after is lost")
        with tempfile.TemporaryDirectory() as directory:
            copy = Path(directory) / "whole.rrd"
            with copy.open("wb") as target:
                file.seek(0)
                for start in range(0, end, _COPY_BYTES):
                    target.write(file.read(min(_COPY_BYTES, end - start)))
            yield copy


def _end_of_messages(file: BinaryIO, size: int) -> int:
    """Return where the last whole message ends; the size of the file when nothing was cut."""
    end = _HEADER_BYTES
    while True:
        file.seek(end)
        header = file.read(_MESSAGE.size)
        if len(header) < _MESSAGE.size:
            return end
        kind, length = _MESSAGE.unpack(header)
        if end + _MESSAGE.size + length > size:
            return end
        if kind == _END_MESSAGE:
            return size  # a footer follows that is not a message
        end += _MESSAGE.size + length


def main() -> int:
    """Write the answer; 1, with the reason alone in it, when the file cannot be read."""
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not get into the answer
    with output:
        try:
            decoded, signals = _decoded(Path(sys.argv[1]), set(sys.argv[2:]) or None)
        except DamagedError as damage:
            output.write(json.dumps({"damage": str(damage)}).encode() + b"\n")
            return 1
        output.write(json.dumps(decoded).encode() + b"\n")
        for _, values in signals:
            output.write(values.data)
    return 0


if __name__ == "__main__":
    sys.exit(main())
