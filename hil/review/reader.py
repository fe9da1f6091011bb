"""Reading a recording back: every signal bit for bit, the events, what the run was, and its summary.

Works for a file without an end too: one whose recorder was killed.
"""

import functools
import json
import os
import struct
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.errors import BadInputError
from hil.telemetry.names import RECORDER_PROPERTY, RUN_PROPERTY, SIGNALS_PROPERTY, SUMMARY_PROPERTY

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

Series = npt.NDArray[np.float64]

# An .rrd file: header of 12 bytes beginning with the magic, then messages of (kind u64, length u64, payload).
MAGIC = b"RRF2"
_HEADER_BYTES = 12
_MESSAGE = struct.Struct("<QQ")
_END_MESSAGE = 0
_EXPECTED = "an .rrd file made by 'hil run --record'"
_REPAIR = "'rerun rrd optimize --continue-on-error' may recover what is whole"
_COPY_BYTES = 1 << 20
_PROPERTIES = "/__properties/"


class Event(NamedTuple):
    """A line of the event log; level as rerun names it: DEBUG, INFO, WARN or ERROR."""

    t_s: float
    level: str
    text: str


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """What a recording holds.

    Attributes:
        path: the file.
        signals: float64 arrays of one length by the signal's name, in the order of the recording's time.
        events: the event log.
        properties: what the run was, as texts by name.
        summary: what the run said at its end; None when it never came to that.
        rows_dropped: rows that the run had to drop; None when the recorder never came to say.
    """

    path: Path
    signals: dict[str, Series]
    events: tuple[Event, ...]
    properties: dict[str, str]
    summary: dict[str, Any] | None
    rows_dropped: int | None


class _Part(NamedTuple):
    """A piece of an entity: row ids (n, 2) in the order of writing, ticks (n,), values (n, signals)."""

    row_ids: npt.NDArray[np.uint64]
    ticks: npt.NDArray[np.int64]
    values: Series


class _Contents(NamedTuple):
    parts: dict[str, list[_Part]]
    properties: dict[str, dict[str, str]]
    events: list[Event]


def read(path: Path) -> RecordedRun:
    """Read a recording made by ``hil run``.

    Raises BadInputError when the file is missing, empty, no recording, damaged, or one of another program.
    """
    check_is_recording(path)
    contents = _contents(path)
    held = _json(path, contents, SIGNALS_PROPERTY)
    if held is None:
        raise BadInputError(f"{path}: a recording of another program; expected {_EXPECTED}")
    recorder = _json(path, contents, RECORDER_PROPERTY)
    return RecordedRun(
        path=path,
        signals=_signals(path, held, contents.parts),
        events=tuple(contents.events),
        properties=contents.properties.get(RUN_PROPERTY, {}),
        summary=_json(path, contents, SUMMARY_PROPERTY),
        rows_dropped=None if recorder is None else recorder.get("rows_dropped"),
    )


def check_is_recording(path: Path) -> None:
    """Raise BadInputError unless the path is a file that begins like a recording."""
    try:
        with path.open("rb") as file:
            start = file.read(len(MAGIC))
    except OSError as error:
        raise BadInputError(f"{path}: {error.strerror}; expected {_EXPECTED}") from error
    if not start:
        raise BadInputError(f"{path}: the file is empty; expected {_EXPECTED}")
    if start != MAGIC:
        raise BadInputError(f"{path}: not a recording; expected {_EXPECTED}")


def to_frame(run: RecordedRun) -> "pd.DataFrame":
    """Return the signals as a frame: one column each, indexed by the scenario time ``loop.t_s``."""
    import pandas as pd

    return pd.DataFrame(run.signals).set_index("loop.t_s", drop=False)


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
            raise BadInputError(f"{path}: damaged: {what}; {_REPAIR}") from error
    return contents


def _json(path: Path, contents: _Contents, name: str) -> dict[str, Any] | None:
    """Return a property that holds a JSON object, or None when the recording does not have it."""
    texts = contents.properties.get(name)
    if texts is None:
        return None
    try:
        value = json.loads(texts["json"])
    except (KeyError, ValueError):
        value = None
    if not isinstance(value, dict):
        raise BadInputError(f"{path}: damaged: its property {name!r} is not readable")
    return value


def _take(entity: str, batch: "pa.RecordBatch", contents: _Contents) -> None:
    columns = {name: batch.column(name) for name in batch.schema.names}
    if entity.startswith(_PROPERTIES):
        texts = contents.properties.setdefault(entity.removeprefix(_PROPERTIES), {})
        for name, column in columns.items():
            if str(column.type) == "list<item: string>":
                texts[name] = column[-1].as_py()[0]
    elif "TextLog:text" in columns:
        times = columns["t"].cast("int64").to_pylist()
        levels, texts_ = (columns[f"TextLog:{name}"].to_pylist() for name in ("level", "text"))
        contents.events.extend(
            Event(t_ns / 1e9, level[0], text[0])
            for t_ns, level, text in zip(times, levels, texts_, strict=True)
        )
    elif "Scalars:scalars" in columns:
        ids = columns["rerun.controls.RowId"]
        row_ids = np.frombuffer(ids.buffers()[1], ">u8", count=2 * len(ids), offset=16 * ids.offset)
        values = columns["Scalars:scalars"].flatten().to_numpy()
        part = _Part(
            row_ids.astype(np.uint64).reshape(len(batch), 2),
            columns["tick"].to_numpy(),
            values.reshape(len(batch), -1),
        )
        contents.parts.setdefault(entity, []).append(part)


def _signals(path: Path, held: dict[str, list[str]], parts: dict[str, list[_Part]]) -> dict[str, Series]:
    """Put the entities' parts in order and side by side."""
    entities = {entity: _joined(parts.get(entity, [_nothing(len(names))])) for entity, names in held.items()}
    for entity, names in held.items():
        width = entities[entity].values.shape[1]
        if width != len(names):
            raise BadInputError(f"{path}: damaged: {entity} has {width} values for {len(names)} signals")
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
