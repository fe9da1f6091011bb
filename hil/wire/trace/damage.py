"""Finds where a trace file is cut or damaged; python-can's readers silently skip such places.

They read the text formats line by line, and skip or complete what they cannot read. So the lines are checked before
they get them. In Vector's binary format frames come in compressed blocks with a checksum. A block is read whole or not
at all: data inflated before a damaged bit cannot be told from data inflated after it.
"""

import re
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

# An event on a bus (by number) or elsewhere (by name), after its time stamp; or a line of the header or footer.
_ASC_LINE = re.compile(
    r"""//.* | (?:date|base|version|previous\ log|(?:no\s+)?internal\s+events|(?:begin|end)\s+triggerblock)\b.*
    | \d+\.\d+\s+ (?: [a-z].* | \d+\s+ (?: \w+\s+[tr]x\w*\s.* | (?![\da-f]+x?\s)[a-z].* ) )""",
    re.VERBOSE | re.IGNORECASE | re.ASCII,
)
_ASC_BEGIN, _ASC_END = (re.compile(rf"{word}\s+triggerblock\b", re.IGNORECASE) for word in ("begin", "end"))
_LOG_LINE = re.compile(
    r"\(\d+\.\d+\)\s+\S+\s+(?:[\da-f]{3}|[\da-f]{8})\#(?:r\d*|(?:\#[\da-f])?(?:[\da-f]{2})*)(?:\s+[rt])?",
    re.IGNORECASE | re.ASCII,
)
_TRC_LINE = re.compile(r";.*|\d+\)?\s+\d+(?:\.\d+)?\s+\S.*", re.ASCII)
_FORMS = {".asc": _ASC_LINE, ".log": _LOG_LINE, ".trc": _TRC_LINE}


class DamagedError(Exception):
    """The file is damaged from here on; the text gives the reason."""


def sound_lines(file: Iterable[bytes], ending: str) -> Iterator[str]:
    """Check and yield the lines of a text trace, in place of the file, to python-can's readers.

    Raises DamagedError at a line without its line feed, at one that the format does not allow, and at the end of an
    .asc file whose trigger block is open.
    """
    open_block = False
    for number, raw in enumerate(file, 1):
        line = raw.decode("utf-8", "replace").strip()
        ended = ending == ".asc" and _ASC_END.match(line) is not None
        if not (ended or raw.endswith(b"\n")):
            raise DamagedError(f"it is cut within line {number}, which is not read")
        if line and not _FORMS[ending].fullmatch(line):
            raise DamagedError(f"line {number} is not a line of a {ending} file, the file is damaged there")
        open_block = not ended and (open_block or (ending == ".asc" and _ASC_BEGIN.match(line) is not None))
        yield line
    if open_block:
        raise DamagedError("it is cut, or was not finished: its last line is not End TriggerBlock")


def check_length(message: Any) -> None:
    """Raise DamagedError if a line of text has less data than its length field says."""
    most = 64 if message.is_fd else 8  # a classic frame may have a length code of up to 15
    if message.is_error_frame or message.is_remote_frame:
        return
    if len(message.data) < min(message.dlc, most):
        raise DamagedError(f"the next frame says {message.dlc} bytes and has {len(message.data)}, it is cut or damaged")


def check_blocks(path: Path) -> None:
    """Raise DamagedError if a block of a .blf file is damaged; a file that is cut at its end passes.

    The blocks are those of ``can.io.blf``, which does not check their ends.
    """
    from can.io import blf

    file_head, block_head = blf.FILE_HEADER_STRUCT, blf.OBJ_HEADER_BASE_STRUCT
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file_head.unpack(file.read(file_head.size))
        offset, finished_size = max(head[1], file_head.size), head[10]
        while offset + block_head.size <= size:
            file.seek(offset)
            signature, _, _, length, kind = block_head.unpack(file.read(block_head.size))
            cut = offset + length > size
            if cut and signature == b"LOBJ" and finished_size != size:
                return
            content = b"" if cut else file.read(max(0, length - block_head.size))
            if (
                cut
                or signature != b"LOBJ"
                or length < block_head.size
                or (kind == blf.LOG_CONTAINER and not _sound_container(content))
            ):
                raise DamagedError(f"the file is damaged in the block at byte {offset}")
            offset += length + length % 4


def _sound_container(content: bytes) -> bool:
    from can.io import blf

    if len(content) < blf.LOG_CONTAINER_STRUCT.size:
        return False
    method, inflated = blf.LOG_CONTAINER_STRUCT.unpack_from(content)
    packed = content[blf.LOG_CONTAINER_STRUCT.size :]
    if method != blf.ZLIB_DEFLATE:
        return bool(method == blf.NO_COMPRESSION)
    stream = zlib.decompressobj()
    try:
        return len(stream.decompress(packed)) == inflated and stream.eof and len(stream.unused_data) < 4  # padding
    except zlib.error:
        return False
