"""A firmware image: the loadable segments and the symbols of a 32-bit little-endian ELF file for ARM."""

import bisect
import struct
from dataclasses import dataclass
from pathlib import Path

from hil.errors import BadInputError

_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SEGMENT = struct.Struct("<8I")
_SECTION = struct.Struct("<10I")
_SYMBOL = struct.Struct("<IIIBBH")
_MAGIC = b"\x7fELF\x01\x01"  # 32 bits, little-endian
_ARM, _LOAD, _SYMBOL_TABLE, _FUNCTION = 40, 1, 2, 2


@dataclass(frozen=True, slots=True)
class Image:
    """What is loaded where. ``segments`` are (address, bytes), ``symbols`` addresses by name."""

    path: Path
    segments: tuple[tuple[int, bytes], ...]
    symbols: dict[str, int]
    functions: tuple[tuple[int, str], ...]

    def where(self, address: int) -> str:
        """Return an address with the function that it is in: ``0x08000123 (main + 0x12)``."""
        at = bisect.bisect_right(self.functions, (address, "\U0010ffff")) - 1
        if at < 0:
            return f"{address:#010x}"
        start, name = self.functions[at]
        return f"{address:#010x} ({name} + {address - start:#x})"


def read_image(path: Path) -> Image:
    """Read an ELF file.

    Raises BadInputError when there is none, or when it is not for a 32-bit little-endian ARM.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BadInputError(f"firmware {str(path)!r} cannot be read ({error.strerror})") from error
    try:
        return _parse(path, data)
    except (struct.error, IndexError, ValueError) as error:
        raise BadInputError(f"firmware {str(path)!r} is damaged ({error}); build it again") from error


def _parse(path: Path, data: bytes) -> Image:
    if data[: len(_MAGIC)] != _MAGIC:
        raise BadInputError(f"firmware {str(path)!r} is no 32-bit little-endian ELF file; expected one for ARM")
    _, _, machine, _, _, segments_at, sections_at, _, _, size, count, section_size, sections, _ = _HEADER.unpack_from(
        data
    )
    if machine != _ARM:
        raise BadInputError(f"firmware {str(path)!r} is for ELF machine {machine}; expected {_ARM}, which is ARM")
    loaded = []
    for n in range(count):
        kind, offset, _, address, file_size, _, _, _ = _SEGMENT.unpack_from(data, segments_at + n * size)
        if kind == _LOAD and file_size:
            loaded.append((address, _slice(data, offset, file_size)))
    headers = [_SECTION.unpack_from(data, sections_at + n * section_size) for n in range(sections)]
    symbols, functions = _symbols(data, headers)
    return Image(path, tuple(loaded), symbols, tuple(sorted(functions)))


def _symbols(data: bytes, headers: list[tuple[int, ...]]) -> tuple[dict[str, int], list[tuple[int, str]]]:
    symbols, functions = {}, []
    for header in headers:
        if header[1] != _SYMBOL_TABLE:
            continue
        names_at = headers[header[6]][4]
        for entry in _SYMBOL.iter_unpack(_slice(data, header[4], header[5])):
            name_at, value, _, info, _, _ = entry
            start = names_at + name_at
            name = data[start : data.index(b"\0", start)].decode("ascii", "replace")
            if name and not name.startswith("$"):
                symbols[name] = value
                if info & 0xF == _FUNCTION:
                    functions.append((value & ~1, name))
    return symbols, functions


def _slice(data: bytes, offset: int, size: int) -> bytes:
    piece = data[offset : offset + size]
    if len(piece) != size:
        raise ValueError(f"{size} bytes at {offset} are beyond its end")
    return piece
