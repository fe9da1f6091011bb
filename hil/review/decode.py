"""Decoding of a recording, in a process of its own: ``python -m hil.review.decode RUN.rrd``.

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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, TypedDict

import numpy as np
import numpy.typing as npt

from hil.telemetry.names import RECORDER_PROPERTY, RUN_PROPERTY, SIGNALS_PROPERTY, SUMMARY_PROPERTY

if TYPE_CHECKING:
    import pyarrow as pa

Series = npt.NDArray[np.float64]

# An .rrd file: header of 12 bytes, then messages of (kind u64, length u64, payload), and a footer.
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE = 0
_COPY_BYTES = 1 << 20
_PROPERTIES = "/__properties/"


class Decoded(TypedDict):
    """What the answer's first line holds; ``signals`` names the rows of the table that follows."""

    signals: list[str]
    rows: int
    events: list[tuple[float, str, str]]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None


class DamagedError(Exception):
    """The file cannot be read as a recording of a run; the text says what is wrong with it."""


class _Part(NamedTuple):
    """A piece of an entity: row ids (n, 2) in the order of writing, ticks (n,), values (n, signals)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    values: Series


class _Contents(NamedTuple):
    parts: dict[str, list[_Part]]
    properties: dict[str, dict[str, str]]
    events: list[tuple[float, str, str]]


def decode(path: Path) -> tuple[Decoded, dict[str, Series]]:
    """Return what a recording holds, and its signals by name. Raises DamagedError."""
    contents = _contents(path)
    held = _json(contents, SIGNALS_PROPERTY)
    if held is None:
        raise DamagedError("a recording of another program")
    signals = _signals(held, contents.parts)
    recorder = _json(contents, RECORDER_PROPERTY)
    decoded = Decoded(
        signals=list(signals),
        rows=len(next(iter(signals.values()), ())),
        events=contents.events,
        properties=contents.properties.get(RUN_PROPERTY, {}),
        summary=_json(contents, SUMMARY_PROPERTY),
        rows_dropped=None if recorder is None else recorder.get("rows_dropped"),
    )
    return decoded, signals


def _contents(path: Path) -> _Contents:
    import rerun.chunk as rrc

    contents = _Contents({}, {}, [])
    with _whole_messages(path) as readable, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "has no footer": so it is, after a kill
        try:
            for chunk in rrc.RrdReader(readable).stream():
                _take(chunk.entity_path, chunk.to_record_batch(), contents)
        except (RuntimeError, ValueError, OSError) as error:
            what = str(error).removeprefix(f"Failed to read RRD file at {readable}: ")
            raise DamagedError(f"damaged: {what}") from error
    return contents


def _json(contents: _Contents, name: str) -> dict[str, Any] | None:
    """Return a property that holds a JSON object, or None when the recording does not have it."""
    texts = contents.properties.get(name)
    if texts is None:
        return None
    try:
        value = json.loads(texts["json"])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise DamagedError(f"damaged: its property {name!r} is not readable")
    return value


def _take(entity: str, batch: "pa.RecordBatch", contents: _Contents) -> None:
    columns = {name: batch.column(name) for name in batch.schema.names}
    if entity.startswith(_PROPERTIES):
        texts = contents.properties.setdefault(entity.removeprefix(_PROPERTIES), {})
        for name, column in columns.items():
            if str(column.type) == "list<item: string>" and (held := column[-1].as_py()):
                texts[name] = held[0]
    elif {"TextLog:text", "TextLog:level", "t"} <= columns.keys():
        times = columns["t"].cast("int64").to_pylist()
        levels, texts_ = (columns[f"TextLog:{name}"].to_pylist() for name in ("level", "text"))
        contents.events.extend(
            (t_ns / 1e9, level[0], text[0]) for t_ns, level, text in zip(times, levels, texts_, strict=True)
        )
    elif {"Scalars:scalars", "tick"} <= columns.keys():
        ids = columns["rerun.controls.RowId"]
        row_ids = np.frombuffer(ids.buffers()[1], ">u8", count=2 * len(ids), offset=16 * ids.offset)
        values = columns["Scalars:scalars"].flatten().to_numpy()
        part = _Part(
            row_ids.astype(np.uint64).reshape(len(batch), 2),
            columns["tick"].to_numpy(),
            values.reshape(len(batch), -1),
        )
        contents.parts.setdefault(entity, []).append(part)


def _signals(held: dict[str, list[str]], parts: dict[str, list[_Part]]) -> dict[str, Series]:
    """Put the entities' parts in order and side by side."""
    entities = {entity: _joined(parts.get(entity, [_nothing(len(names))])) for entity, names in held.items()}
    for entity, names in held.items():
        width = entities[entity].values.shape[1]
        if width != len(names):
            raise DamagedError(f"damaged: {entity} has {width} values for {len(names)} signals")
    ticks = [entity.ticks for entity in entities.values()]
    if not all(np.array_equal(one, ticks[0]) for one in ticks):
        # After a kill the last rows may have reached some entities only; after a repair any may lack some.
        common = functools.reduce(np.intersect1d, ticks)
        entities = {path: _only(part, common) for path, part in entities.items()}
    signals: dict[str, Series] = {}
    for entity, names in held.items():
        signals.update(zip(names, entities[entity].values.T.copy(), strict=True))
    return signals


def _joined(parts: list[_Part]) -> _Part:
    row_ids, ticks, values = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((row_ids[:, 1], row_ids[:, 0]))
    return _Part(row_ids[order], ticks[order], values[order])


def _only(part: _Part, ticks: npt.NDArray[np.int64]) -> _Part:
    rows = np.isin(part.ticks, ticks)
    return _Part(part.row_ids[rows], part.ticks[rows], part.values[rows])


def _nothing(width: int) -> _Part:
    return _Part(np.empty((0, 2), np.uint64), np.empty(0, np.int64), np.empty((0, width)))


@contextmanager
def _whole_messages(path: Path) -> Iterator[Path]:
    """Yield the file, or, if its last message was cut short, a temporary copy without that message."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        end = _end_of_messages(file, size)
        if end == size:
            yield path
            return
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
            decoded, signals = decode(Path(sys.argv[1]))
        except DamagedError as damage:
            output.write(json.dumps({"damage": str(damage)}).encode() + b"\n")
            return 1
        output.write(json.dumps(decoded).encode() + b"\n")
        for name in decoded["signals"]:
            output.write(signals[name].tobytes())
    return 0


if __name__ == "__main__":
    sys.exit(main())
