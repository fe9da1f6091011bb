"""Decodes a recording in MCAP, as ``hil.record.mcap_file`` writes it, also one without its end."""

import json
import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np
import zstandard
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Message, Metadata
from mcap.stream_reader import CRCValidationError, StreamReader, breakup_chunk, get_chunk_data_stream

from hil.record.mcap_file import EVENTS_TOPIC, LEVELS, SIGNALS_TOPIC, ZERO_KEY
from hil.record.properties import SIGNALS_PROPERTY
from hil.record.ros_messages import CDR_HEADER
from hil.review.contents import Contents, DamagedError, Selection, Series, json_property, why_nothing

_LEVEL_NAMES = {number: {"warning": "WARN"}.get(name, name.upper()) for name, number in LEVELS.items()}
_LONGEST_RECORD_BYTES = 256 << 20
_UNREADABLE = (McapError, CRCValidationError, zstandard.ZstdError, struct.error, ValueError, KeyError)
# Raised by lz4, and for lengths that make no sense.
_SENSELESS = (RuntimeError, MemoryError, OverflowError)
_MAGIC = b"\x89MCAP0\r\n"  # a file begins and ends with it; between are records of (opcode u8, length u64, content)
_RECORD = struct.Struct("<BQ")


def decode_mcap(path: Path, selection: Selection = None) -> Contents:
    """Return the contents of an MCAP recording; of a file that was cut off, those before the cut.

    A damaged chunk is left out, and named in ``damage``. Raises DamagedError for any other damage.
    """
    reader = _Reader(selection)
    with path.open("rb") as file:
        end, cut_bytes = _end_of_records(file)
        file.seek(0)
        stream = StreamReader(file, emit_chunks=True, record_size_limit=_LONGEST_RECORD_BYTES)
        try:
            records = stream.records
            while max(file.tell(), len(_MAGIC)) < end:
                reader.add(next(records))
        except (*_UNREADABLE, *_SENSELESS) as error:
            raise DamagedError(f"damaged: {error or type(error).__name__}") from error
    return reader.contents(cut_bytes)


def _end_of_records(file: BinaryIO) -> tuple[int, int | None]:
    """Return the end of the last whole record, and the number of bytes after it; None if the file was not cut."""
    size = file.seek(0, os.SEEK_END)
    end, opcode = len(_MAGIC), None
    while opcode != Opcode.FOOTER:
        file.seek(end)
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return end, size - end
        opcode, length = _RECORD.unpack(head)
        if end + _RECORD.size + length > size:
            return end, size - end
        end += _RECORD.size + length
    file.seek(end)
    return end, None if file.read() == _MAGIC else size - end


class _Reader:
    def __init__(self, selection: Selection) -> None:
        self._selection = selection
        self._properties: dict[str, dict[str, str]] = {}
        self._events: list[tuple[float, str, str]] = []
        self._topics: dict[int, str] = {}
        self._programs: list[str] = []
        self._pieces: list[Series] = []
        self._names: list[str] | None = None
        self._zero_ns = 0
        self._damage: list[str] = []
        self._lost_rows = 0

    def add(self, record: object) -> None:
        """Add a record of the file."""
        if isinstance(record, Metadata):
            self._properties[record.name] = record.metadata
            if record.name == SIGNALS_PROPERTY:
                self._begin()
        elif isinstance(record, Header):
            self._programs.append(record.library)
        elif isinstance(record, Channel):
            self._topics[record.id] = record.topic
        elif isinstance(record, Message):
            self._message(record)
        elif isinstance(record, Chunk):
            self._chunk(record)

    def contents(self, cut_bytes: int | None) -> Contents:
        """Return what was added. Raises DamagedError for a file that holds no run."""
        if self._names is None:
            raise DamagedError(why_nothing(self._programs, cut_bytes))
        table = np.concatenate([np.empty((0, len(self._columns))), *self._pieces])
        self._pieces.clear()
        signals = {self._names[column]: table[:, i] for i, column in enumerate(self._columns)}
        return Contents(signals, self._events, self._properties, cut_bytes, tuple(self._damage), self._lost_rows)

    def _begin(self) -> None:
        held = json_property(self._properties, SIGNALS_PROPERTY)
        if held is None or list(held) != [SIGNALS_TOPIC]:
            raise DamagedError("damaged: it does not say what its signals are")
        self._names = held[SIGNALS_TOPIC]
        self._zero_ns = int(self._properties[SIGNALS_PROPERTY][ZERO_KEY])
        self._columns = [i for i, name in enumerate(self._names) if self._selection is None or name in self._selection]
        head = [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("stamps", "V20"),
            ("header", f"V{len(CDR_HEADER)}"),
        ]
        self._row = np.dtype([*head, ("values", "<f8", (len(self._names),))])

    def _chunk(self, chunk: Chunk) -> None:
        """Add what is in a chunk, all of it or nothing."""
        try:
            inside = [] if self._rows_alone(chunk) else breakup_chunk(chunk, validate_crc=True)
        except (*_UNREADABLE, *_SENSELESS) as error:
            self._leave_out(chunk, error)
            return
        for inner in inside:
            self.add(inner)

    def _leave_out(self, chunk: Chunk, error: Exception) -> None:
        """Note what a damaged chunk held, by its header, which has no CRC of its own."""
        begin_s, end_s = ((t_ns - self._zero_ns) / 1e9 for t_ns in (chunk.message_start_time, chunk.message_end_time))
        rows = chunk.uncompressed_size / self._row.itemsize if self._names is not None else 0.5
        are_rows = rows.is_integer() and chunk.uncompressed_size < _LONGEST_RECORD_BYTES
        self._lost_rows += int(rows) if are_rows else 0
        what = f"{int(rows)} rows" if are_rows else "what was recorded"
        why = str(error).partition("\n")[0] or type(error).__name__
        self._damage.append(f"{what} from t = {begin_s:.6g} s to {end_s:.6g} s cannot be read and are left out: {why}")

    def _rows_alone(self, chunk: Chunk) -> bool:
        """Add all rows of a chunk at once if it holds nothing else; return whether it did."""
        if self._names is None:
            return False
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        if length % self._row.itemsize:
            return False
        rows = np.frombuffer(stream.read(length), self._row)
        expected = self._row.itemsize - 9
        if (rows["opcode"] != Opcode.MESSAGE).any() or (rows["length"] != expected).any():
            return False
        if {self._topics.get(int(number)) for number in np.unique(rows["channel"])} - {SIGNALS_TOPIC, None}:
            return False  # None: the chunk that names this topic may be lost
        self._pieces.append(rows["values"][:, self._columns])
        return True

    def _message(self, message: Message) -> None:
        topic = self._topics.get(message.channel_id)
        if topic == EVENTS_TOPIC:
            log, t_s = json.loads(message.data), (message.log_time - self._zero_ns) / 1e9
            self._events.append((t_s, _LEVEL_NAMES.get(log["level"], "INFO"), log["message"]))
        elif topic == SIGNALS_TOPIC and self._names is not None:
            values = np.frombuffer(message.data, "<f8", count=len(self._names), offset=len(CDR_HEADER))
            self._pieces.append(values[None, self._columns])
