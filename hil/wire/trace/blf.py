"""Reads Vector's binary traces (.blf): objects in compressed blocks with a checksum.

A block is read whole or not at all: data inflated before a damaged bit cannot be told from data inflated after it.
python-can has the layouts; its reader skips the objects that it does not know without a word, and reads one of size 0
for ever.
"""

import struct
import zlib
from collections.abc import Generator, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

from can.io import blf

from hil.wire.trace.traced import DamagedError, LeftOut, TracedFrame, length_of

_CLASSIC = (blf.CAN_MESSAGE, blf.CAN_MESSAGE2)
_ERRORS = {2: "<H", blf.CAN_ERROR_EXT: "<H", 104: "<B"}  # with the form of their channel
# Objects that are often found beside frames.
_OTHERS = {
    3: "overload frames",
    4: "statistics",
    5: "triggers",
    **dict.fromkeys((6, 7, 8, 9), "environment variables"),
    **dict.fromkeys((11, 57), "LIN frames"),
    **dict.fromkeys((31, 44, 74), "driver errors"),
    65: "texts",
    **dict.fromkeys((71, 120), "Ethernet frames"),
    72: "system variables",
    92: "comments",
    96: "markers",
    115: "restore points",
}
_HEADERS = {1: blf.OBJ_HEADER_V1_STRUCT, 2: blf.OBJ_HEADER_V2_STRUCT}
_LOCATOR = b"LOBJ"
_PADDING = 3
_MOST_INFLATED = 1 << 26  # Vector's tools and python-can inflate to 128 KiB
_REMOTE, _EXTENDED, _NUMBER = 0x80, 0x80000000, 0x1FFFFFFF
_FD64_REMOTE = 0x10
_DIRECTIONS, _REQUEST = 0x0F, 2


def read_blf(path: Path) -> Iterator[TracedFrame | LeftOut]:
    """Yield the contents of a .blf file. Raises DamagedError where it is cut or damaged."""
    size = path.stat().st_size
    with path.open("rb") as file:
        raw = file.read(blf.FILE_HEADER_STRUCT.size)
        if len(raw) < blf.FILE_HEADER_STRUCT.size or not raw.startswith(b"LOGG"):
            raise DamagedError("it is not a .blf file, or it is empty")
        head = blf.FILE_HEADER_STRUCT.unpack(raw)
        finished_size, start_s = head[10], _unix_s(head[14:22])
        rest = b""
        for at, content, is_container in _blocks(file, max(head[1], len(raw)), size, is_finished=finished_size == size):
            if is_container:  # its last object may go on in the next one
                rest += content
                end = yield from _objects(rest, at, start_s)
                rest = rest[end:]
            else:
                yield from _objects(content, at, start_s)
        if finished_size != size:
            raise DamagedError("it was not finished, or is cut")
        if len(rest) > _PADDING:
            raise DamagedError("its last object is cut")


def _unix_s(system_time: tuple[int, ...]) -> float:
    year, month, _, day, hour, minute, second, milliseconds = system_time
    try:
        return datetime(year, month, day, hour, minute, second, milliseconds * 1000, tzinfo=UTC).timestamp()
    except ValueError:
        return 0.0


def _blocks(file: BinaryIO, offset: int, size: int, *, is_finished: bool) -> Iterator[tuple[int, bytes, bool]]:
    """Yield the place of each block in a file, its content, and whether it is a container, else it is one object.

    A file that is not finished may be cut at its end.
    """
    base = blf.OBJ_HEADER_BASE_STRUCT
    while offset + base.size <= size:
        file.seek(offset)
        raw = file.read(base.size)
        signature, _, _, length, kind = base.unpack(raw)
        is_cut = offset + length > size
        if is_cut and signature == _LOCATOR and not is_finished:
            return
        if is_cut or signature != _LOCATOR or length < base.size:
            raise DamagedError(f"the file is damaged in the block at byte {offset}")
        content = file.read(length - base.size)
        inflated, is_container = _inflated(content), kind == blf.LOG_CONTAINER
        if is_container == (inflated is None):  # else its kind is damaged
            raise DamagedError(f"the file is damaged in the block at byte {offset}")
        yield offset, raw + content if inflated is None else inflated, is_container
        offset += length + length % 4


def _inflated(content: bytes) -> bytes | None:
    """Return the content of a container; None if it is damaged."""
    if len(content) < blf.LOG_CONTAINER_STRUCT.size:
        return None
    method, length = blf.LOG_CONTAINER_STRUCT.unpack_from(content)
    packed = content[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return packed
    if method != blf.ZLIB_DEFLATE or length > _MOST_INFLATED:
        return None
    stream = zlib.decompressobj()
    try:
        inflated = stream.decompress(packed, length + 1)
    except zlib.error:
        return None
    is_whole = len(inflated) == length and stream.eof and len(stream.unused_data) <= _PADDING
    return inflated if is_whole else None


def _objects(data: bytes, at: int, start_s: float) -> Generator[TracedFrame | LeftOut, None, int]:
    """Yield the whole objects in data that ends with the block at a byte; return the end of the last one."""
    base, end = blf.OBJ_HEADER_BASE_STRUCT, 0
    while True:
        place = data.find(_LOCATOR, end, end + _PADDING + 1 + len(_LOCATOR))
        if place < 0:
            if not any(data[end:]):  # padding, of which some tools write more
                return len(data)
            if len(data) - end > _PADDING + len(_LOCATOR):
                raise DamagedError(f"the file is damaged in the block at byte {at}")
            return end
        if place + base.size > len(data):
            return end
        _, _, version, length, kind = base.unpack_from(data, place)
        if length < base.size:
            raise DamagedError(f"the file is damaged in the block at byte {at}, by an object of {length} bytes")
        if place + length > len(data):
            return end
        try:
            yield _object(kind, version, data[place : place + length], start_s)
        except (struct.error, IndexError) as error:
            why = f"the file is damaged in the block at byte {at}, by an object that is too short"
            raise DamagedError(why) from error
        end = place + length


def _object(kind: int, version: int, raw: bytes, start_s: float) -> TracedFrame | LeftOut:
    base = blf.OBJ_HEADER_BASE_STRUCT.size
    head = _HEADERS.get(version)
    if head is None:
        return LeftOut(f"objects with a header of version {version}")
    flags, _, _, stamp = head.unpack_from(raw, base)
    unix_s, at = start_s + stamp / (1e5 if flags == blf.TIME_TEN_MICS else 1e9), base + head.size
    if kind in _CLASSIC:
        channel, flags, code, number, data = blf.CAN_MSG_STRUCT.unpack_from(raw, at)
        data, direction, is_remote = data[: length_of(code, fd=False)], flags & _DIRECTIONS, bool(flags & _REMOTE)
    elif kind == blf.CAN_FD_MESSAGE:
        channel, flags, _, number, _, _, _, valid, data = blf.CAN_FD_MSG_STRUCT.unpack_from(raw, at)
        data, direction, is_remote = data[:valid], flags & _DIRECTIONS, bool(flags & _REMOTE)
    elif kind == blf.CAN_FD_MESSAGE_64:
        channel, _, valid, _, number, _, flags, *_, direction, extra, _ = blf.CAN_FD_MSG_64_STRUCT.unpack_from(raw, at)
        # CANoe leaves out trailing zeros of the data.
        data = raw[at + blf.CAN_FD_MSG_64_STRUCT.size : extra or len(raw)][:valid].ljust(valid, b"\0")
        is_remote = bool(flags & _FD64_REMOTE)
    elif kind in _ERRORS:
        channel = struct.unpack_from(_ERRORS[kind], raw, at)[0]
        return TracedFrame(unix_s, str(channel), True, 0, False, b"", is_error=True)
    else:
        return LeftOut(_OTHERS.get(kind, f"objects of type {kind}"))
    extended, number, is_request = bool(number & _EXTENDED), number & _NUMBER, direction == _REQUEST
    payload, is_rx = b"" if is_remote else data, direction == 0
    return TracedFrame(
        unix_s, str(channel), is_rx, number, extended, payload, is_remote=is_remote, is_request=is_request
    )
