"""Firmware images: reads a linked ELF file, and writes it as Intel HEX and as plain bytes."""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_HEADER = struct.Struct("<16sHHIIIIIHHHHHH")  # ELF32 header, then program headers and section headers
_PROGRAM = struct.Struct("<IIIIIIII")
_SECTION = struct.Struct("<IIIIIIIIII")
_ELF32_LITTLE = b"\x7fELF\x01\x01"
_MACHINE_ARM = 40
_LOAD = 1
_NOBITS = 8
_WRITE, _ALLOC = 1, 2
_HEX_BYTES = 16


@dataclass(frozen=True)
class Image:
    """The content of the flash, and the memory that a firmware takes.

    ``segments`` are (address, bytes), in the order of their addresses. In bytes: ``text`` is code and constants,
    ``data`` variables with a start value (they take flash too), ``bss`` variables without one, ``stack`` the space
    reserved for the stack.
    """

    segments: tuple[tuple[int, bytes], ...]
    text: int
    data: int
    bss: int
    stack: int

    @property
    def flash(self) -> int:
        """Bytes of flash."""
        return self.text + self.data

    @property
    def ram(self) -> int:
        """Bytes of RAM."""
        return self.data + self.bss + self.stack


def read_elf(path: Path) -> Image:
    """Read a linked 32-bit ARM ELF file. Raises ValueError for another kind of file, or one that is incomplete."""
    elf = path.read_bytes()
    if elf[:6] != _ELF32_LITTLE or len(elf) < _HEADER.size:
        raise ValueError(f"{path} is not a 32-bit little-endian ELF file")
    head = _HEADER.unpack_from(elf)
    if head[2] != _MACHINE_ARM:
        raise ValueError(f"{path} is for ELF machine {head[2]}: expected {_MACHINE_ARM}, ARM")
    try:
        return _image(elf, head)
    except (struct.error, IndexError, ValueError) as error:
        raise ValueError(f"{path} is cut short or damaged ({error}); build it again") from error


def _image(elf: bytes, head: tuple[Any, ...]) -> Image:
    program_at, section_at = head[5], head[6]
    program_count, section_count, names_index = head[10], head[12], head[13]
    segments = []
    for i in range(program_count):
        kind, offset, _, load_address, in_file, *_ = _PROGRAM.unpack_from(elf, program_at + i * _PROGRAM.size)
        if kind == _LOAD and in_file > 0:
            if offset + in_file > len(elf):
                raise ValueError(f"a segment ends at byte {offset + in_file} of {len(elf)}")
            segments.append((load_address, elf[offset : offset + in_file]))
    sections = [_SECTION.unpack_from(elf, section_at + i * _SECTION.size) for i in range(section_count)]
    names_at = sections[names_index][4]
    size = {"text": 0, "data": 0, "bss": 0, "stack": 0}
    for name_at, kind, flags, _, _, length, *_ in sections:
        if flags & _ALLOC:
            start = names_at + name_at
            name = elf[start : elf.index(b"\0", start)]
            if name == b".stack":
                size["stack"] += length
            elif kind == _NOBITS:
                size["bss"] += length
            else:
                size["data" if flags & _WRITE else "text"] += length
    return Image(tuple(sorted(segments)), **size)


def write_bin(image: Image, path: Path) -> None:
    """Write the bytes from the first address on; gaps are filled with FF, like erased flash."""
    start = image.segments[0][0]
    plain = bytearray()
    for address, data in image.segments:
        plain += b"\xff" * (address - start - len(plain)) + data
    path.write_bytes(plain)


def write_hex(image: Image, path: Path) -> None:
    """Write Intel HEX with 16 bytes per record and extended linear addresses."""
    lines = []
    high = -1
    for address, data in image.segments:
        at = 0
        while at < len(data):
            here = address + at
            if here >> 16 != high:
                high = here >> 16
                lines.append(_record(4, 0, high.to_bytes(2, "big")))
            # No record crosses a boundary of 64 KB, where the address of its first byte would wrap.
            count = min(_HEX_BYTES - here % _HEX_BYTES, len(data) - at)
            lines.append(_record(0, here & 0xFFFF, data[at : at + count]))
            at += count
    lines.append(_record(1, 0, b""))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def _record(kind: int, address: int, data: bytes) -> str:
    body = bytes([len(data)]) + address.to_bytes(2, "big") + bytes([kind]) + data
    return ":" + (body + bytes([-sum(body) & 0xFF])).hex().upper()
