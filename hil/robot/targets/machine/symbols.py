"""Names for addresses: the functions that an ELF file's symbol table lists."""

import bisect
import struct
from pathlib import Path

_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")
_SECTION = struct.Struct("<10I")
_SYMBOL = struct.Struct("<IIIBBH")
_SYMBOL_TABLE, _FUNCTION = 2, 2


class Symbols:
    """The functions of a 32-bit little-endian ELF file; a stripped one has none."""

    def __init__(self, path: Path) -> None:
        elf = path.read_bytes()
        head = _HEADER.unpack_from(elf)
        sections = [_SECTION.unpack_from(elf, head[6] + i * _SECTION.size) for i in range(head[12])]
        functions = []
        for _, kind, _, _, offset, size, names, _, _, _ in sections:
            if kind != _SYMBOL_TABLE:
                continue
            names_at = sections[names][4]
            for name_at, value, _, info, _, _ in _SYMBOL.iter_unpack(elf[offset : offset + size]):
                start = names_at + name_at
                if info & 0xF == _FUNCTION:
                    name = elf[start : elf.index(b"\0", start)].decode("ascii", "replace")
                    functions.append((value & ~1, name))  # bit 0 says Thumb
        self._functions = sorted(functions)

    def where(self, address: int) -> str:
        """Return an address with the function that it is in, as far as known: ``0x08000123 (main + 0x12)``."""
        at = bisect.bisect_right(self._functions, address, key=lambda row: row[0]) - 1
        if at < 0:
            return f"{address:#010x}"
        start, name = self._functions[at]
        return f"{address:#010x} ({name} + {address - start:#x})"
