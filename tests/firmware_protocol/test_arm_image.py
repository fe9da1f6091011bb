"""A linked firmware: its sizes, bytes, Intel HEX and deepest use of the stack, and how arm_build tells them."""

import re
import struct
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile

from firmware_protocol import arm_build
from firmware_protocol.arm_image import Image, read_elf, write_bin, write_hex
from firmware_protocol.arm_stack import worst_stack
from firmware_protocol.built import BuildError

FLASH, RAM = 0x0800_0000, 0x2000_0000
# Name, type (1: bits, 8: none), flags (1: write, 2: occupies memory), address, bytes.
SECTIONS = (
    ("", 0, 0, 0, b""),
    (".vectors", 1, 2, FLASH, b"v" * 5),
    (".text", 1, 2 | 4, FLASH + 8, b"t" * 20),
    (".data", 1, 1 | 2, RAM, b"d" * 7),
    (".bss", 8, 1 | 2, RAM + 8, b"b" * 300),
    (".stack", 8, 1 | 2, RAM + 400, b"s" * 1000),
    (".comment", 1, 0, 0, b"c" * 40),
    (".shstrtab", 3, 0, 0, b""),
)
# Type (1: load), where it is linked, where it is loaded, bytes in the file, bytes in memory.
SEGMENTS = ((1, RAM, FLASH + 40, b"d" * 7, 7), (1, FLASH, FLASH, b"v" * 5 + b"\0" * 3 + b"t" * 20, 28))
SEGMENTS += ((1, RAM + 8, RAM + 8, b"", 300), (0x6474E551, 0, 0, b"x" * 4, 4))


def elf(path: Path, machine: int = 40) -> Path:
    """Write an ELF file of these sections and segments, laid out by hand."""
    names = b"".join(name.encode() + b"\0" for name, *_ in SECTIONS)
    body, table, programs = bytearray(52 + 32 * len(SEGMENTS)), b"", b""
    for kind, linked, loaded, data, size in SEGMENTS:
        programs += struct.pack("<8I", kind, len(body), linked, loaded, len(data), size, 5, 4)
        body += data
    for name, kind, flags, address, data in SECTIONS:
        data = names if name == ".shstrtab" else data
        place = names.index(name.encode() + b"\0") if name else names.index(b"\0")
        table += struct.pack("<10I", place, kind, flags, address, len(body), len(data), 0, 0, 1, 0)
        body += b"" if kind == 8 else data
    head = (2, machine, 1, FLASH, 52, len(body), 0, 52, 32, len(SEGMENTS), 40, len(SECTIONS), len(SECTIONS) - 1)
    body[:52] = b"\x7fELF\x01\x01\x01".ljust(16, b"\0") + struct.pack("<HHIIIIIHHHHHH", *head)
    body[52 : 52 + len(programs)] = programs
    path.write_bytes(body + table)
    return path


def test_sizes_and_segments_are_read_from_an_elf(tmp_path: Path) -> None:
    path = elf(tmp_path / "a.elf")
    with path.open("rb") as file:
        assert [section.name for section in ELFFile(file).iter_sections()] == [name for name, *_ in SECTIONS]
    image = read_elf(path)
    assert (image.text, image.data, image.bss, image.stack) == (25, 7, 300, 1000)
    assert (image.flash, image.ram) == (32, 1307)
    assert image.segments == ((FLASH, b"v" * 5 + b"\0" * 3 + b"t" * 20), (FLASH + 40, b"d" * 7))


def test_what_is_no_whole_arm_firmware_is_refused_with_what_is_wrong(tmp_path: Path) -> None:
    whole = elf(tmp_path / "a.elf").read_bytes()
    path = tmp_path / "b.elf"
    with pytest.raises(ValueError, match=r"a\.elf is for ELF machine 62: expected 40, ARM"):
        read_elf(elf(tmp_path / "a.elf", machine=62))
    for wrong in (whole[:51], b"\x7fELF\x02" + whole[5:], b"\x7fELF\x01\x02" + whole[6:]):
        path.write_bytes(wrong)
        with pytest.raises(ValueError, match=r"b\.elf is not a 32-bit little-endian ELF file"):
            read_elf(path)
    path.write_bytes(whole[:52])
    with pytest.raises(ValueError, match=r"b\.elf is cut short or damaged \(.+\); build it again"):
        read_elf(path)
    path.write_bytes(whole[:56] + (len(whole) - 6).to_bytes(4, "little") + whole[60:])
    with pytest.raises(ValueError, match=rf"a segment ends at byte {len(whole) + 1} of {len(whole)}"):
        read_elf(path)
    path.write_bytes(whole[:56] + (len(whole) - 7).to_bytes(4, "little") + whole[60:])
    assert read_elf(path).segments[1] == (FLASH + 40, whole[-7:])


# Not in whole records, with a gap, and over a border of 64 KiB.
BYTES = Image(((FLASH + 0xFFF5, bytes(range(1, 30))), (FLASH + 0x1_0020, b"\xfe" * 33)), 0, 0, 0, 0)


def test_hex_says_each_byte_at_its_address_and_no_other(tmp_path: Path) -> None:
    write_hex(BYTES, tmp_path / "a.hex")
    text = (tmp_path / "a.hex").read_text(encoding="ascii")
    said, high, kinds = dict[int, int](), 0, []
    for line in text.splitlines():
        length, low, kind, data = int(line[1:3], 16), int(line[3:7], 16), int(line[7:9], 16), bytes.fromhex(line[9:-2])
        assert line[0] == ":"
        assert line == line.upper()
        assert len(data) == length
        assert sum(bytes.fromhex(line[1:])) % 256 == 0
        kinds.append(kind)
        if kind == 4:
            high = int.from_bytes(data, "big") << 16
        elif kind == 0:
            assert low + length <= 0x1_0000
            assert 0 < length <= 16
            said |= {high + low + place: byte for place, byte in enumerate(data)}
    assert said == {address + place: byte for address, data in BYTES.segments for place, byte in enumerate(data)}
    # Records end where 16 bytes do: 11 bytes before the border, and 16 and 2 behind it; then 16, 16 and 1.
    assert kinds == [4, 0, 4, 0, 0, 0, 0, 0, 1]
    assert text.endswith("\n:00000001FF\n")


def test_bin_begins_at_the_first_byte_and_fills_gaps_as_erased_flash(tmp_path: Path) -> None:
    write_bin(BYTES, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == bytes(range(1, 30)) + b"\xff" * (0x2B - 29) + b"\xfe" * 33


LISTING = """
08000100 <reset>:
 8000100:\tb500      \tpush\t{lr}
 8000102:\tbl\t8000120 <narrow>
 8000106:\tbeq.n\t8000102 <reset+0x2>
 8000108:\tblls\t8000140 <wide>
 800010c:\tb.n\t8000100 <reset>
08000120 <narrow>:
 8000120:\tbx\tlr
08000140 <wide>:
 8000140:\tbne.w\t8000160 <tail.part.0>
 8000144:\tblx\tr3
 8000146:\tbx\tlr
08000160 <tail.part.0>:
 8000160:\tbx\tlr
08000180 <pointed>:
 8000180:\tbx\tlr
080001a0 <small_interrupt>:
 80001a0:\tbx\tlr
080001c0 <large_interrupt>:
 80001c0:\tbl\t8000120 <narrow>
"""
FRAMES = (
    *(("reset", 8), ("narrow", 100), ("wide", 24), ("tail", 16), ("tail", 40), ("pointed", 88)),
    *(("small_interrupt", 48), ("large_interrupt", 4)),
)
USAGE = "".join(f"a.c:{row}:6:{name}\t{size}\tstatic\n" for row, (name, size) in enumerate(FRAMES))
NOBODY = Image(((0x0800_0000, b"\x81\x01\0\x08" * 64 + b"\0\0\0\0"),), 0, 0, 0, 0)
"""The address of a function before the code, in the vector table, is none that a call through a pointer takes."""
POINTED = Image(((0x0800_0000, bytes(0x104) + b"\x81\x01\0\x08" + b"\1"),), 0, 0, 0, 0)


def test_the_stack_is_that_of_the_deepest_chain_with_an_interrupt_on_top() -> None:
    use = worst_stack(LISTING, USAGE, POINTED)
    assert use.main == (("reset", 8), ("wide", 24), ("pointed", 88))
    assert use.interrupt == (("large_interrupt", 4), ("narrow", 100))
    assert (use.indirect, use.reachable) == (("wide",), ("pointed",))
    assert use.total == 120 + 104 + 2 * 108  # bytes that the core pushes at an interrupt, and at a fault in it


def test_a_jump_to_another_functions_beginning_is_a_call_and_the_larger_of_two_frames_counts() -> None:
    use = worst_stack(LISTING, USAGE.replace("narrow\t100", "narrow\t60"), NOBODY)
    assert use.main == (("reset", 8), ("wide", 24), ("tail.part.0", 40))
    assert (use.indirect, use.reachable) == (("wide",), ())
    assert worst_stack(LISTING, USAGE, NOBODY).main == (("reset", 8), ("narrow", 100))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("narrow\t100\tstatic", "narrow\t100\tdynamic", "function narrow has a stack frame of changing size"),
        ("a.c:1:6:narrow\t100\tstatic\n", "", "function narrow has no stack usage"),
        ("beq.n\t8000102 <reset+0x2>", "bl\t8000100 <reset>", "function reset calls itself: its stack has no bound"),
    ],
)
def test_a_stack_without_a_bound_is_refused(old: str, new: str, words: str) -> None:
    assert old in LISTING + USAGE
    with pytest.raises(BuildError, match=words):
        worst_stack(LISTING.replace(old, new), USAGE.replace(old, new), NOBODY)


@pytest.mark.parametrize("knows_stack", [True, False])
def test_a_build_tells_its_sizes_and_the_stack_with_its_chains(
    knows_stack: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target = arm_build.TARGETS[0]
    stack = worst_stack(LISTING, USAGE, POINTED) if knows_stack else None
    image = Image((), 9000, 16, 2000, 1500)
    made = arm_build.Built(target, Path("out") / "a.elf", image, stack)
    monkeypatch.setattr(arm_build, "build", lambda asked, output: made if asked is target else None)
    assert arm_build.main([target.name]) == 0
    first, sizes, *rest = capsys.readouterr().out.splitlines()
    assert first == f"{Path('out') / 'a.elf'} (and .hex, .bin)"
    flash, text, data, ram, again, bss, reserved = map(int, re.findall(r"\d+", sizes))
    assert (flash, text, data) == (9016, 9000, 16)
    assert (ram, again, bss, reserved) == (3516, 16, 2000, 1500)
    assert [word for word in re.findall(r"[a-zA-Z]+", sizes) if word not in ("bytes", "data")] == [
        *("flash", "text", "RAM", "bss", "stack")
    ]
    if not knows_stack:
        assert rest == ["  worst-case stack not known: only arm-none-eabi-gcc tells it"]
        return
    assert rest == [
        "  worst-case stack 440 bytes: reset 8 > wide 24 > pointed 88; interrupted in large_interrupt",
        "  through pointers in wide: pointed",
    ]


def test_each_target_has_its_own_name_sources_and_number() -> None:
    names = {target.name: {path.stem for path in target.sources()} for target in arm_build.TARGETS}
    assert len(names) == len({arm_build.source_hash(target) for target in arm_build.TARGETS}) == 8
    assert all(path.is_file() for target in arm_build.TARGETS for path in target.sources())
    both = names["motors-f405_bridges-can"], names["hil-emulated-hil_f405-serial"]
    assert both[0] - both[1] == {
        *("clock_crystal", "plant_motors", "pwm", "encoders", "analog", "host_can", "f405_bridges")
    }
    assert both[1] - both[0] == {
        *("clock_emulated", "plant_line", "plant_codec", "usart", "lockstep", "host_serial", "hil_f405")
    }
    assert both[0] & both[1] >= {"node", "supervise", "wheel_messages", "startup", "robot", "main", "parameter_log"}
