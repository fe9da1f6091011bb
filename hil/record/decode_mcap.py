"""Decodes a recording in MCAP, as ``hil.record.mcap_file`` writes it, also one without its end."""

import io
import json
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError, RecordLengthLimitExceeded
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Message, Metadata
from mcap.stream_reader import CRCValidationError, breakup_chunk, get_chunk_data_stream

from hil.record.contents import (
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
from hil.record.mcap_file import CDR_HEADER, LOG_LEVELS, SIGNALS_TOPIC, ZERO_KEY, log_fields
from hil.record.properties import EVENTS_PATH, JOURNAL, JOURNAL_PATH, RECORDER_PROPERTY, SIGNALS_PROPERTY

_LEVEL_NAMES = {number: {"warning": "WARN"}.get(name, name.upper()) for name, number in LOG_LEVELS.items()}
_LONGEST_RECORD_BYTES = 256 << 20
_UNREADABLE = (McapError, CRCValidationError, zstandard.ZstdError, struct.error, ValueError, KeyError)
# Raised by lz4, and for lengths that make no sense.
_SENSELESS = (RuntimeError, MemoryError, OverflowError)
_KNOWN = frozenset(Opcode)
_READ: dict[int, Any] = {
    Opcode.HEADER: Header, Opcode.METADATA: Metadata, Opcode.CHANNEL: Channel, Opcode.CHUNK: Chunk,
    Opcode.MESSAGE: Message,
}  # fmt: skip
_COPY_BYTES = 1 << 20
_MAGIC = b"\x89MCAP0\r\n"  # a file begins and ends with it; between are records of (opcode u8, length u64, content)
_RECORD = struct.Struct("<BQ")


def decode_mcap(path: Path, selection: Selection = None) -> Contents:
    """Return the contents of an MCAP recording; of a file that was cut off, those before the cut.

    A damaged chunk is left out, and named in ``damage``. Raises DamagedError for any other damage.
    """
    reader = _Reader(selection)
    with path.open("rb") as file:
        cut_bytes = _cut_bytes(file)
        reader.compare(file)
        try:
            for _, opcode, length in _records(file):
                if length > _LONGEST_RECORD_BYTES:
                    raise RecordLengthLimitExceeded(opcode, length, _LONGEST_RECORD_BYTES)
                if (kind := _READ.get(opcode)) is not None:
                    reader.add(kind.read(ReadDataStream(io.BytesIO(file.read(length)))))
        except (*_UNREADABLE, *_SENSELESS) as error:
            raise DamagedError(f"damaged: {error or type(error).__name__}") from error
    return reader.contents(cut_bytes)


def _cut_bytes(file: BinaryIO) -> int | None:
    """Return the number of bytes after the last whole record; None if the file was not cut."""
    place, opcode, length = [(len(_MAGIC) - _RECORD.size, None, 0), *_records(file)][-1]
    end = place + _RECORD.size + length
    size = file.seek(0, os.SEEK_END)
    file.seek(end)
    return None if opcode == Opcode.FOOTER and file.read() == _MAGIC else size - end


def _records(file: BinaryIO) -> Iterator[tuple[int, int, int]]:
    """Yield where each whole record begins, its kind and the length of its content, at which the file then is."""
    size = file.seek(0, os.SEEK_END)
    place, opcode = len(_MAGIC), None
    while opcode != Opcode.FOOTER and place + _RECORD.size <= size:
        file.seek(place)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        if place + _RECORD.size + length > size:
            return
        yield place, opcode, length
        place += _RECORD.size + length


def _sums(file: BinaryIO) -> Iterator[tuple[str, int, int]]:
    """Yield which part of the file it is, its CRC-32, and that of the format: of the records, and of the index."""
    data_end = None
    for place, opcode, length in _records(file):
        if opcode == Opcode.DATA_END:
            stored = int.from_bytes(file.read(4), "little")
            yield "records", _crc32(file, 0, place), stored
            data_end = place + _RECORD.size + length
        elif opcode == Opcode.FOOTER and data_end is not None:
            until = place + _RECORD.size + length - 4
            file.seek(until)
            stored = int.from_bytes(file.read(4), "little")
            yield "parts of its index", _crc32(file, data_end, until), stored


def _crc32(file: BinaryIO, begin: int, end: int) -> int:
    file.seek(begin)
    crc = 0
    for place in range(begin, end, _COPY_BYTES):
        crc = zlib.crc32(file.read(min(_COPY_BYTES, end - place)), crc)
    return crc


class _Reader:
    def __init__(self, selection: Selection) -> None:
        self._selection = selection
        self._properties = Properties()
        self._events: list[NumberedEvent] = []
        self._topics: dict[int, str] = {}
        self._programs: list[str] = []
        self._pieces: list[Series] = []
        self._numbers: list[npt.NDArray[np.uint32]] = []
        self._names: list[str] | None = None
        self._zero_ns = 0
        self._damage: list[str] = []
        self._rows_damage: list[str] = []
        self._left_s: list[float] = []  # when the rows of each of these begin
        self._lost_rows = 0
        self._other: list[str] = []

    def compare(self, file: BinaryIO) -> None:
        """Compare the file with the two CRC-32 of its format, of the records before the index and of the index."""
        for place, opcode, length in _records(file):
            begin = file.read(6)  # of a message index: its channel and the size of its entries
            fits = opcode != Opcode.MESSAGE_INDEX or length == 6 + int.from_bytes(begin[2:], "little")
            if opcode not in _KNOWN or not fits:
                self._damage.append(f"{length} bytes from byte {place} on cannot be read and are left out")
        for record, summed, stored in _sums(file):
            if stored and stored != summed:
                self._other.append(f"{record} that are not read here differ from their check value (CRC-32)")

    def add(self, record: object) -> None:
        """Add a record of the file."""
        if isinstance(record, Metadata):
            self._properties.read(record.name, record.metadata)
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
        damage = self._properties.damage()
        if self._names is None:
            raise DamagedError(why_nothing(self._programs, cut_bytes))
        names = [self._names[column] for column in self._columns]
        table = np.concatenate([np.empty((0, len(names))), *self._pieces])
        self._pieces.clear()
        damage += self._damage
        if not self._properties.has_checks:
            signals = {name: table[:, i] for i, name in enumerate(names)}
            damage += self._rows_damage or self._other
            events = [event for _, event in self._events]
            old = ("a version without check values recorded it: damage of its properties cannot be noticed",)
            return Contents(signals, events, self._properties, cut_bytes, tuple(damage), self._lost_rows, remarks=old)
        events, lost_events, of_events = numbered_events(self._events, self._properties)
        stored = np.concatenate([np.empty(0, np.uint32), *self._numbers])
        rows = numbered_rows(stored, table, names, self._properties)
        damage += of_events + rows.damage
        if RECORDER_PROPERTY not in self._properties:  # then no number tells that the last rows are missing
            left = zip(self._rows_damage, self._left_s, strict=True)
            damage += [one for one, at_s in left if not at_s <= rows.last_s]
        told = tuple(damage or self._other), rows.lost, lost_events, rows.numbers, tuple(rows.remarks)
        return Contents(rows.signals, events, self._properties, cut_bytes, *told)

    def _begin(self) -> None:
        held = json_property(self._properties, SIGNALS_PROPERTY)
        if held is None or list(held) != [SIGNALS_TOPIC]:
            raise DamagedError("damaged: it does not say what its signals are")
        self._names = held[SIGNALS_TOPIC]
        self._zero_ns = int(self._properties[SIGNALS_PROPERTY][ZERO_KEY])
        self._columns = [i for i, name in enumerate(self._names) if self._selection is None or name in self._selection]
        head = [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("stamps", "V16")]
        values = ("values", "<f8", (len(self._names),))
        self._row = np.dtype([*head, ("header", f"V{len(CDR_HEADER)}"), values])

    def _chunk(self, chunk: Chunk) -> None:
        try:
            inside = [] if self._rows_alone(chunk) else breakup_chunk(chunk, validate_crc=True)
        except (*_UNREADABLE, *_SENSELESS) as error:
            self._leave_out(chunk, error)
            return
        for inner in inside:
            self.add(inner)

    def _leave_out(self, chunk: Chunk, error: Exception) -> None:
        """Note the contents of a damaged chunk, by its header, which has no CRC of its own."""
        begin_s, end_s = ((t_ns - self._zero_ns) / 1e9 for t_ns in (chunk.message_start_time, chunk.message_end_time))
        rows = chunk.uncompressed_size / self._row.itemsize if self._names is not None else 0.5
        are_rows = rows.is_integer() and chunk.uncompressed_size < _LONGEST_RECORD_BYTES
        self._lost_rows += int(rows) if are_rows else 0
        what = f"{int(rows)} rows" if are_rows else "what was recorded"
        why = str(error).partition("\n")[0] or type(error).__name__
        kind = self._rows_damage if are_rows else self._damage
        self._left_s.extend([begin_s] * are_rows)
        kind.append(f"{what} from t = {begin_s:.6g} s to {end_s:.6g} s cannot be read and are left out: {why}")

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
        self._numbers.append(rows["sequence"])
        return True

    def _message(self, message: Message) -> None:
        topic = self._topics.get(message.channel_id)
        if topic in (EVENTS_PATH, JOURNAL_PATH):
            level, text = _log(message.data)
            name = JOURNAL if topic == JOURNAL_PATH else _LEVEL_NAMES.get(level, "INFO")
            event = ((message.log_time - self._zero_ns) / 1e9, name, text)
            self._events.append((message.sequence if self._properties.has_checks else None, event))
        elif topic == SIGNALS_TOPIC and self._names is not None:
            values = np.frombuffer(message.data, "<f8", count=len(self._names), offset=len(CDR_HEADER))
            self._pieces.append(values[None, self._columns])
            self._numbers.append(np.array([message.sequence], np.uint32))


def _log(data: bytes) -> tuple[int, str]:
    """Return the level, as ROS 2 counts it, and the text of an event; older versions wrote ``foxglove.Log`` in JSON."""
    if data.startswith(CDR_HEADER):
        return log_fields(data)
    log = json.loads(data)
    return 10 * log["level"], log["message"]
