"""The C codec and framing, as shipped, under sanitizers: against the golden vectors and the Python twin."""

import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cffi
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.capabilities import Capability
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import Frame, crc16
from firmware_protocol.generated import messages
from firmware_protocol.generated.messages import LENGTHS, MESSAGES
from tests.support.examples import share_of_examples
from tests.support.protocol_cases import (
    DBC,
    IDS,
    PROTOCOL,
    VECTORS,
    any_values,
    frames,
    limits,
    out_of_range_payloads,
    vectors,
)

FIRMWARE = PROTOCOL / "firmware"
SOURCES = [
    PROTOCOL / "generated" / "wheel_messages.c",
    *(FIRMWARE / name for name in ("crc.c", "cobs.c", "framing.c")),
]
HEADERS = [
    PROTOCOL / "generated" / "wheel_messages.h",
    *(FIRMWARE / name for name in ("crc.h", "cobs.h", "framing.h")),
]
WARNINGS = ["-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
FLAGS = ["-std=c11", "-O1", "-g", "-ffp-contract=off", *WARNINGS]
UNDEFINED = "undefined,float-cast-overflow"
DEFINES = {"WP_PAYLOAD_MAX": "8", "WHEEL_FRAME_MAX - 1u": "14"}

by_id = pytest.mark.parametrize("number", IDS, ids=lambda n: DBC[n].name)


@pytest.fixture(scope="module")
def cc() -> str:
    found = next(filter(None, map(shutil.which, [os.environ.get("CC", "cc"), "gcc", "clang"])), None)
    if found is None:
        pytest.skip("no C compiler (cc, gcc, clang) on this machine")
    return found


def compile_c(cc: str, *arguments: str | Path) -> None:
    done = subprocess.run([cc, *FLAGS, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def c(cc: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any]:
    """The C sources as a library that traps on undefined behaviour: cffi's (ffi, lib)."""
    library = tmp_path_factory.mktemp("c") / "wheel.so"
    trap = [f"-fsanitize={UNDEFINED}", "-fsanitize-undefined-trap-on-error"]
    compile_c(cc, *trap, "-shared", "-fPIC", "-o", library, *SOURCES)
    ffi = cffi.FFI()
    for header in HEADERS:
        text = re.sub(
            r"^#ifdef __cplusplus\n.*?^#endif\n", "", header.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL
        )
        text = re.sub(r"^#(.*\\\n)*.*\n", "", text, flags=re.MULTILINE)
        for name, value in DEFINES.items():
            text = text.replace(name, value)
        ffi.cdef(text)
    return ffi, ffi.dlopen(str(library))


def stem(number: int) -> str:
    return DBC[number].name.lower()


def c_encode(c: tuple[Any, Any], number: int, values: dict[str, Any]) -> bytes | None:
    ffi, lib = c
    message = ffi.new(f"wp_{stem(number)} *", values)
    payload = ffi.new("uint8_t[8]", b"\xa5" * 8)
    if getattr(lib, f"wp_{stem(number)}_encode")(message, payload):
        return bytes(payload)[: LENGTHS[number]]
    assert bytes(payload) == b"\xa5" * 8, "a refused message must leave the payload untouched"
    return None


def c_decode(c: tuple[Any, Any], number: int, payload: bytes) -> tuple[float, ...] | None:
    ffi, lib = c
    message = ffi.new(f"wp_{stem(number)} *")
    ffi.buffer(message)[:] = b"\xa5" * ffi.sizeof(message[0])
    if getattr(lib, f"wp_{stem(number)}_decode")(payload, len(payload), message):
        return tuple(getattr(message, field) for field in MESSAGES[number]._fields)
    assert bytes(ffi.buffer(message)) == b"\xa5" * ffi.sizeof(message[0])
    return None


@pytest.mark.proves("R-SER-2", "R-GEN-9")
@pytest.mark.skipif(sys.platform == "win32", reason="gcc for Windows has no AddressSanitizer")
def test_the_golden_vectors_under_sanitizers(cc: str, tmp_path: Path) -> None:
    program = tmp_path / "check_vectors"
    sanitize = [f"-fsanitize=address,{UNDEFINED}", "-fno-sanitize-recover=all"]
    compile_c(cc, *sanitize, "-o", program, VECTORS / "check_vectors.c", *SOURCES)
    tables = [VECTORS / "frames.csv", VECTORS / "rejected.csv"]
    done = subprocess.run([program, *tables], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [len(table.read_text(encoding="utf-8").splitlines()) - 1 for table in tables]
    bits = [8 * len(vector.serial) for vector in vectors()]
    errors = sum(n * (n + 1) // 2 for n in bits)
    assert done.stdout == f"{rows[0]} frames, {errors} bit errors, {rows[1]} rejected, 0 failures\n"


def test_the_c_needs_no_library_and_no_writable_data(cc: str, tmp_path: Path) -> None:
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("no nm on this machine")
    for source in SOURCES:
        target = tmp_path / f"{source.stem}.o"
        compile_c(cc, "-ffreestanding", "-c", "-o", target, source)
        symbols = subprocess.run([nm, target], capture_output=True, text=True, check=True).stdout
        kinds = {line.split()[-1].lstrip("_"): line.split()[-2] for line in symbols.splitlines()}
        assert not [name for name, kind in kinds.items() if kind in "bBdDC"], "no statics"
        needed = {name for name, kind in kinds.items() if kind == "U" and not name.startswith(("wheel_", "wp_"))}
        assert needed <= {"memcpy", "memset"}, source.name


def test_the_constants_agree(c: tuple[Any, Any]) -> None:
    _, lib = c
    header = HEADERS[0].read_text(encoding="utf-8")
    assert f"#define WP_SCHEMA_HASH 0x{messages.SCHEMA_HASH:08X}u\n" in header
    assert f"#define WP_PROTOCOL_VERSION {messages.PROTOCOL_VERSION}u\n" in header
    for number in range(0x10000):
        assert lib.wp_payload_length(number) == LENGTHS.get(number, -1)
    assert lib.WP_STATE_ESTOP == messages.State.ESTOP
    assert lib.WP_ARM_REFUSAL_MODE == messages.ArmRefusal.MODE


@pytest.mark.proves("R-GEN-9")
@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_c_and_python_encode_the_same_bits(c: tuple[Any, Any], number: int, data: st.DataObject) -> None:
    values = data.draw(any_values(number))
    assert c_encode(c, number, values) == MESSAGES[number](**values).encode()


@pytest.mark.proves("R-GEN-9")
@by_id
@share_of_examples(0.4)
@given(data=st.data())
def test_c_and_python_decode_the_same_values(c: tuple[Any, Any], number: int, data: st.DataObject) -> None:
    payload = data.draw(st.binary(min_size=LENGTHS[number], max_size=LENGTHS[number]))
    assert c_decode(c, number, payload) == MESSAGES[number].decode(payload)


@pytest.mark.proves("R-GEN-8")
@by_id
def test_c_refuses_a_raw_value_just_outside_its_limits(c: tuple[Any, Any], number: int) -> None:
    for name, payload in out_of_range_payloads(number):
        assert c_decode(c, number, payload) is None, name


def next_binary32(value: float, direction: int) -> float:
    """Return the neighbour of a nonzero binary32 number, away from zero for +1, towards it for -1."""
    (bits,) = struct.unpack("<I", struct.pack("<f", value))
    (neighbour,) = struct.unpack("<f", struct.pack("<I", bits + direction))
    assert isinstance(neighbour, float)
    return neighbour


@pytest.mark.proves("R-GEN-7")
@by_id
def test_c_refuses_what_python_refuses(c: tuple[Any, Any], number: int) -> None:
    signals = limits(number)
    good: dict[str, Any] = {s.name: s.raw_minimum * s.scale if s.scaled else s.raw_minimum for s in signals}
    assert c_encode(c, number, good) is not None
    for s in signals:
        if s.scaled:
            ends = [s.raw_minimum * s.scale, s.raw_maximum * s.scale]
            bad: list[Any] = [*(next_binary32(end, +1) for end in ends), float("nan"), float("inf"), -3.4e38]
        else:
            storage = 8 if s.raw_maximum < 256 else 16 if s.raw_maximum < 65536 else 32
            candidates = [s.raw_minimum - 1, s.raw_maximum + 1, (1 << storage) - 1]
            bad = [v for v in candidates if 0 <= v < 1 << storage and not s.raw_minimum <= v <= s.raw_maximum]
        for value in bad:
            assert c_encode(c, number, good | {s.name: value}) is None, (s.name, value)


@pytest.mark.proves("R-GEN-10")
@by_id
def test_c_rounds_halves_and_their_neighbours_as_python(c: tuple[Any, Any], number: int) -> None:
    signals = limits(number)
    good: dict[str, Any] = {s.name: 0.0 if s.scaled else s.raw_minimum for s in signals}
    for s in (s for s in signals if s.scaled):
        for raw in [0, 1, 2, 3, 63, 64, 255, 1023, 2047, s.raw_maximum - 1]:
            half = (raw + 0.5) * s.scale
            for value in (half, next_binary32(half, +1), next_binary32(half, -1)):
                for signed in (value, -value):
                    values = good | {s.name: signed}
                    assert c_encode(c, number, values) == MESSAGES[number](**values).encode(), values


@pytest.mark.proves("R-SER-4")
@given(data=st.binary(max_size=300))
def test_crc_agrees(c: tuple[Any, Any], data: bytes) -> None:
    assert c[1].wheel_crc16(data, len(data)) == crc16(data)


blocks = st.one_of(st.binary(max_size=40), st.integers(250, 520).map(lambda n: b"\x01" * n))


@given(data=blocks)
def test_cobs_encodes_as_the_cobs_package(c: tuple[Any, Any], data: bytes) -> None:
    ffi, lib = c
    encoded = ffi.new("uint8_t[]", len(data) + len(data) // 254 + 1)
    written = lib.wheel_cobs_encode(data, len(data), encoded)
    assert bytes(encoded)[:written] == cobs.encode(data)


@given(
    encoded=blocks.map(cobs.encode),
    cut=st.integers(0, 3),
    changes=st.lists(st.tuples(st.integers(0, 520), st.integers(0, 255)), max_size=2),
)
def test_cobs_decodes_and_refuses_as_the_cobs_package(
    c: tuple[Any, Any], encoded: bytes, cut: int, changes: list[tuple[int, int]]
) -> None:
    ffi, lib = c
    damaged = bytearray(encoded[: len(encoded) - cut])
    for position, value in changes:
        if damaged:
            damaged[position % len(damaged)] = value
    length = ffi.new("size_t *", len(damaged))
    in_place = ffi.new("uint8_t[]", bytes(damaged) + b"\x55" * 8)
    accepted = lib.wheel_cobs_decode(in_place, length)
    assert bytes(in_place)[len(damaged) : len(damaged) + 8] == b"\x55" * 8
    try:
        expected = cobs.decode(bytes(damaged))
    except cobs.DecodeError:
        assert not accepted
    else:
        assert accepted
        assert bytes(in_place)[: length[0]] == expected


@pytest.mark.proves("R-GEN-9", "R-SER-2")
@given(frame=frames, sequence=st.integers(0, 255))
def test_both_framers_write_the_same_bytes(c: tuple[Any, Any], frame: Frame, sequence: int) -> None:
    ffi, lib = c
    framer = framer_at(sequence)
    out = ffi.new("uint8_t[15]")
    block = ffi.new("wheel_frame *", {"id": frame.id, "length": len(frame.payload), "payload": frame.payload})
    written = lib.wheel_frame_encode(block, sequence, out)
    begins = b"\0" if frame.id == messages.Estop.ID else b""
    assert begins + bytes(out)[:written] == framer.encode(frame)
    block.length += 1
    assert lib.wheel_frame_encode(block, sequence, out) == 0


def framer_at(sequence: int) -> Framer:
    framer = Framer()
    for _ in range(sequence):
        framer.encode(Frame(messages.Estop.ID, bytes(messages.Estop.LENGTH)))
    return framer


def disturb(pieces: list[tuple[bytes, int, int]]) -> bytes:
    """Join frames and garbage, with one bit of some pieces wrong."""
    stream = bytearray()
    for piece, position, bit in pieces:
        start = len(stream)
        stream += piece
        if piece and bit < 8:
            stream[start + position % len(piece)] ^= 1 << bit
    return bytes(stream)


@pytest.mark.proves("R-GEN-1", "R-GEN-9")
@given(
    stream=st.lists(
        st.tuples(
            st.one_of(
                st.builds(lambda frame, n: framer_at(n).encode(frame), frames, st.integers(0, 255)),
                st.binary(max_size=20).map(lambda garbage: garbage + b"\0"),
            ),
            st.integers(0, 20),
            st.integers(0, 40),
        ),
        max_size=20,
    ).map(disturb)
)
def test_both_deframers_accept_and_count_the_same(c: tuple[Any, Any], stream: bytes) -> None:
    ffi, lib = c
    deframer, frame = ffi.new("wheel_deframer *"), ffi.new("wheel_frame *")
    lib.wheel_deframer_init(deframer)
    found = [
        Frame(frame.id, bytes(frame.payload)[: frame.length])
        for byte in stream
        if lib.wheel_deframer_feed(deframer, byte, frame)
    ]
    twin = Deframer()
    assert found == twin.feed(stream)
    counted = {
        "cobs": deframer.cobs,
        "crc": deframer.crc,
        "length": deframer.length_errors,
        "unknown_id": deframer.unknown_id,
        "overrun": deframer.overruns,
    }
    assert counted == twin.rejected
    assert (deframer.frames, deframer.lost) == (twin.frames, twin.lost)


def test_capabilities_have_the_bits_of_the_firmware() -> None:
    header = (FIRMWARE / "node.h").read_text(encoding="utf-8")
    bits = re.findall(r"^#define WHEEL_CAPABILITY_(\w+) (0x\w+)u", header, flags=re.MULTILINE)
    assert {name: int(bit, 16) for name, bit in bits} == {one.name: one.value for one in Capability}
