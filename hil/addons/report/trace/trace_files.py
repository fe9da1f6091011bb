"""Reads the frames of a trace: the .log of ``candump -L``, and Vector's binary .blf.

Each line of a log is a frame, is left out and counted, or is damage. A .blf has objects in compressed blocks with a
checksum. A block is read whole or not at all: data inflated before a damaged bit look the same as data inflated after
it. python-can has the layouts; its readers silently skip what they do not know, and read an object of size 0 for ever.
"""

import re
import struct
import zlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from can.io import blf


class TracedFrame(NamedTuple):
    """One frame of a file.

    Attributes:
        stamp_s: the file's own time stamp [s].
        channel: the bus as the file names it, or None.
        is_rx: whether the writer received it; true if the file does not say.
        number: the identifier; of an error frame its class, if the file has it.
        extended: whether the identifier has 29 bits.
        payload: the data.
        is_remote: a request without data.
        is_error: an error frame.
        is_request: one that was to be sent; the frame itself follows if it was.
    """

    stamp_s: float
    channel: str | None
    is_rx: bool
    number: int
    extended: bool
    payload: bytes
    is_remote: bool = False
    is_error: bool = False
    is_request: bool = False

    @property
    def direction(self) -> str:
        """``Tx`` or ``Rx``, as seen by the writer of the trace."""
        return "Rx" if self.is_rx else "Tx"


class LeftOut(NamedTuple):
    """Something in a file that is not a CAN frame, or cannot be read as one: its kind, in the plural."""

    cause: str


class DamagedError(Exception):
    """The file is damaged from here on; the text gives the reason."""


_CLASSIC_BYTES, _FD_BYTES = 8, 64
_NUMBER = 0x1FFFFFFF
_ERROR_FLAG = 0x20000000
# Lines of candump -L, also with its options -8, -e and -x; its lines of CAN XL frames; what it prints on the screen.
_LINE = re.compile(
    r"\((?P<t>\d{1,15}\.\d{1,15})\)\s+(?P<channel>\S+)\s+(?P<id>[\da-f]{3}|[0-3][\da-f]{7})"
    r"#(?:(?P<remote>r[\da-f]?)|(?P<fd>\#[\da-f])?(?P<data>(?:[\da-f]{2}){,64}))(?P<code>_[\da-f])?(?:\s+(?P<dir>[rt]))?",
    re.IGNORECASE | re.ASCII,
)
_XL = re.compile(r"\(\d+\.\d+\)\s+\S+\s+[\da-f]+#[\da-f]+:[\da-f:]+#[\da-f]*(?:\s+[rt])?", re.IGNORECASE | re.ASCII)
_SCREEN = re.compile(
    r"(?:\([^)]*\)\s+)?\S+\s+(?:[TR]X(?:\s+\S){2}\s+)?[\da-f]{3,8}\s+\[\d+\]", re.IGNORECASE | re.ASCII
)


def read_log(path: Path) -> Iterator[TracedFrame | LeftOut]:
    """Yield the contents of a log of ``candump -L``. Raises DamagedError where it is cut or damaged."""
    with path.open("rb") as file:
        for number, raw in enumerate(file, 1):
            line, ended = raw.decode("utf-8", "replace").lstrip("\ufeff").strip(), raw.endswith(b"\n")
            if not line:
                continue
            try:
                content = _logged(line, ended=ended)
            except ValueError:
                why = f"line {number} is not of a log of candump -L; the file is damaged there, or has another form"
                if not ended and number > 1:
                    why = f"it is cut within line {number}, which is not read"
                raise DamagedError(why) from None
            yield content


def _logged(line: str, *, ended: bool) -> TracedFrame | LeftOut:
    """Return the content of a line. One that has not ``ended`` has no line feed.

    Raises ValueError for a line of another form, or if a part of its frame may be missing.
    """
    found = _LINE.fullmatch(line)
    if found is None:
        if _SCREEN.match(line):
            raise DamagedError("it is of the form that candump prints on the screen; log with candump -L")
        if _XL.fullmatch(line):
            return LeftOut("CAN XL frames")
        raise ValueError
    stamp, channel, name, remote, fd, digits, code, direction = found.groups()
    number, data = int(name, 16), bytes.fromhex(digits or "")
    most = _FD_BYTES if fd else _CLASSIC_BYTES
    may_go_on = not (ended or direction or code or remote) and len(data) < most
    if len(data) > most or may_go_on:
        raise ValueError
    is_rx, is_error = (direction or "r").lower() == "r", len(name) == 8 and bool(number & _ERROR_FLAG)
    extended = len(name) == 8 and not is_error
    return TracedFrame(float(stamp), channel, is_rx, number & _NUMBER, extended, data, remote is not None, is_error)


_CLASSIC = (blf.CAN_MESSAGE, blf.CAN_MESSAGE2)
_ERRORS = {2: "<H", blf.CAN_ERROR_EXT: "<H", 104: "<B"}  # with the form of their channel
_HEADERS = {1: blf.OBJ_HEADER_V1_STRUCT, 2: blf.OBJ_HEADER_V2_STRUCT}
_LOCATOR = b"LOBJ"
_PADDING = 3
_MOST_INFLATED = 1 << 26  # Vector's tools and python-can inflate to 128 KiB
_REMOTE, _EXTENDED = 0x80, 0x80000000
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
        finished_size = head[10]
        rest = b""
        for at, content, is_container in _blocks(file, max(head[1], len(raw)), size, is_finished=finished_size == size):
            if is_container:  # its last object may go on in the next one
                rest += content
                end = yield from _objects(rest, at)
                rest = rest[end:]
            else:
                yield from _objects(content, at)
        if finished_size != size:
            raise DamagedError("it was not finished, or is cut")
        if len(rest) > _PADDING:
            raise DamagedError("its last object is cut")


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


def _objects(data: bytes, at: int) -> Generator[TracedFrame | LeftOut, None, int]:
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
            yield _object(kind, version, data[place : place + length])
        except (struct.error, IndexError) as error:
            why = f"the file is damaged in the block at byte {at}, by an object that is too short"
            raise DamagedError(why) from error
        end = place + length


def _object(kind: int, version: int, raw: bytes) -> TracedFrame | LeftOut:
    base = blf.OBJ_HEADER_BASE_STRUCT.size
    head = _HEADERS.get(version)
    if head is None:
        return LeftOut(f"objects with a header of version {version}")
    flags, _, _, stamp = head.unpack_from(raw, base)
    stamp_s, at = stamp / (1e5 if flags == blf.TIME_TEN_MICS else 1e9), base + head.size
    if kind in _CLASSIC:
        channel, flags, code, number, data = blf.CAN_MSG_STRUCT.unpack_from(raw, at)
        data, direction, is_remote = data[: min(code, _CLASSIC_BYTES)], flags & _DIRECTIONS, bool(flags & _REMOTE)
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
        return TracedFrame(stamp_s, str(channel), True, 0, False, b"", is_error=True)
    else:
        return LeftOut(f"objects of type {kind}")
    extended, number, is_request = bool(number & _EXTENDED), number & _NUMBER, direction == _REQUEST
    payload, is_rx = b"" if is_remote else data, direction == 0
    return TracedFrame(
        stamp_s, str(channel), is_rx, number, extended, payload, is_remote=is_remote, is_request=is_request
    )
