"""The linked STM32F405 firmware: its contents, the parts left out, and its use of the chip."""

import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cffi
import pytest
from elftools.elf.elffile import ELFFile
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import arm_build
from firmware_protocol.arm_build import PORT, TARGETS, Built, Target, build
from firmware_protocol.arm_image import read_elf
from firmware_protocol.arm_stack import worst_stack
from firmware_protocol.built import FIRMWARE_FLAGS, BuildError
from tests.support.arm_firmwares import firmware, need_gcc

FLASH_LIMIT = 32 * 1024
RAM_LIMIT = 16 * 1024
STACK_LIMIT = 1024
HIL = [target for target in TARGETS if target.variant != "motors"]
MOTORS = [target for target in TARGETS if target.variant == "motors"]
OF_MOTORS = re.compile(r"pwm|encoder|analog|motor|pin_to_bridge|pin_output|pin_write", re.IGNORECASE)
# The core keeps wheel_node_fault_... and names of encoder supervision of its own.
OF_THE_CORE = {"check_encoders", "wp_encoders_encode", "wp_encoders_decode"}
# Double precision and 64-bit division, allocation, and what comes with stdio.
UNWANTED = re.compile(
    r"__aeabi_d|__aeabi_[a-z]*2d|__aeabi_[u]?ldiv|df[0-9]|malloc|calloc|free|_sbrk|printf|_exit|__libc"
)

by_target = pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)


@pytest.fixture
def firmwares() -> dict[Target, Built]:
    """Every firmware, built with gcc."""
    return {target: firmware(*target) for target in TARGETS}


def symbols(built: Built) -> dict[str, int]:
    with built.elf.open("rb") as file:
        table = ELFFile(file).get_section_by_name(".symtab")
        kinds = ("STT_FUNC", "STT_OBJECT")
        return {s.name: s["st_value"] & ~1 for s in table.iter_symbols() if s["st_info"]["type"] in kinds}


@by_target
def test_it_takes_a_small_part_of_the_chip(firmwares, target):
    built = firmwares[target]
    assert 8 * 1024 < built.image.flash < FLASH_LIMIT
    assert built.image.ram < RAM_LIMIT
    assert built.image.data == 0, "variables with start values would be statics of the core"


@by_target
def test_the_stack_has_a_bound_far_below_what_is_kept_for_it(firmwares, target):
    built = firmwares[target]
    assert 300 < built.stack.total < STACK_LIMIT < built.image.stack
    assert built.stack.main[0][0] == "reset"
    assert built.stack.indirect == ("wheel_node_receive",), "each call through a pointer is known"
    assert {"on_wheel_command", "on_estop", "on_heartbeat"} < set(built.stack.reachable)


@by_target
def test_no_double_no_allocation_no_c_library(firmwares, target):
    assert [name for name in symbols(firmwares[target]) if UNWANTED.search(name)] == []


@pytest.mark.parametrize("target", HIL, ids=lambda t: t.name)
def test_a_hardware_in_the_loop_build_has_nothing_of_motors(firmwares, target):
    names = {name for name in symbols(firmwares[target]) if OF_MOTORS.search(name)} - OF_THE_CORE
    assert names == set()
    assert {"plant_deframer_feed", "lockstep_serve"} <= set(symbols(firmwares[target]))


@pytest.mark.parametrize("target", MOTORS, ids=lambda t: t.name)
def test_a_build_for_motors_has_no_step_and_no_plant_port(firmwares, target):
    names = set(symbols(firmwares[target]))
    assert not names & {"lockstep_serve", "wheel_node_step_pending", "wheel_node_step_done", "wp_step_done_encode"}
    assert not any(name.startswith(("plant_deframer", "plant_encode", "PLANT_LINE")) for name in names)
    assert {"pwm_drive", "MOTORS"} <= names


@pytest.mark.parametrize("link", ["serial", "can"])
def test_only_clock_init_tells_an_emulated_build_from_a_real_one(firmwares, link):
    real, emulated = Target("hil", "hil_f405", link), Target("hil-emulated", "hil_f405", link)
    assert {p.name for p in set(real.sources()) ^ set(emulated.sources())} == {"clock_crystal.c", "clock_emulated.c"}
    assert symbols(firmwares[real]).keys() == symbols(firmwares[emulated]).keys()


@by_target
def test_the_vector_table_leads_into_the_code(firmwares, target):
    built = firmwares[target]
    start, data = built.image.segments[0]
    vectors = [int.from_bytes(data[i : i + 4], "little") for i in range(0, 98 * 4, 4)]
    own = symbols(built)
    assert start == 0x0800_0000
    assert vectors[0] == 0x2000_0000 + built.image.stack, "the stack is the first thing in RAM"
    assert vectors[1] == own["reset"] | 1
    assert vectors[15] == own["systick_interrupt"] | 1
    assert all(vector & 1 for vector in vectors[1:]), "Thumb"
    assert {vector & ~1 for vector in vectors[1:]} <= set(own.values())
    line = {"usart1": 37, "usart2": 38, "usart3": 39, "can1_receive": 20, "can1_transmit": 19, "can1_status": 22}
    for name, number in line.items():
        assert vectors[16 + number] == own[f"{name}_interrupt"] | 1
    assert vectors[3] == vectors[2] == vectors[16 + 28] == own["fault"] | 1


@by_target
def test_hex_and_bin_hold_what_objcopy_makes_of_the_elf(firmwares, target, tmp_path):
    elf = firmwares[target].elf
    made = tmp_path / "objcopy.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-O", "binary", "--gap-fill", "0xff", elf, made], check=True)
    assert elf.with_suffix(".bin").read_bytes() == made.read_bytes()
    back = tmp_path / "hex.bin"
    subprocess.run(["arm-none-eabi-objcopy", "-I", "ihex", "-O", "binary", elf.with_suffix(".hex"), back], check=True)
    assert back.read_bytes() == made.read_bytes()


def test_sizes_are_those_that_binutils_count(firmwares):
    for built in firmwares.values():
        said = subprocess.run(["arm-none-eabi-size", built.elf], capture_output=True, text=True, check=True).stdout
        text, data, bss, *_ = map(int, said.splitlines()[1].split()[:3])
        image = built.image
        assert (text, data, bss) == (image.text, image.data, image.bss + image.stack)


def test_two_builds_are_the_same_bytes(firmwares, tmp_path):
    target = TARGETS[0]
    assert build(target, tmp_path).elf.read_bytes() == firmwares[target].elf.read_bytes()


def test_only_what_has_changed_is_compiled_anew(firmwares, tmp_path, monkeypatch):
    target = TARGETS[0]
    built = firmwares[target]
    objects = tmp_path / "objects"
    shutil.copytree(built.elf.parents[1] / "objects", objects)
    before = set(objects.iterdir())
    again = build(target, tmp_path, objects)
    assert set(objects.iterdir()) == before
    assert again.elf.read_bytes() == built.elf.read_bytes()
    assert again.stack == built.stack
    monkeypatch.setattr(arm_build, "source_hash", lambda _: 1)  # the number that the firmware says of itself
    assert build(target, tmp_path, objects).elf.read_bytes() != built.elf.read_bytes()
    assert [path.name.partition("-")[0] for path in set(objects.iterdir()) - before if path.suffix == ".o"] == ["robot"]


def test_the_build_number_follows_the_sources(firmwares):
    hashes = [arm_build.source_hash(target) for target in TARGETS]
    assert len(set(hashes)) == len(TARGETS)


@pytest.mark.parametrize("target", [MOTORS[0], HIL[-1]], ids=lambda t: t.name)
def test_zig_builds_it_too(target, tmp_path, monkeypatch):
    pytest.importorskip("ziglang", reason="no zig: pip install ziglang")
    which = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: None if name.startswith("arm-none-eabi") else which(name))
    built = build(target, tmp_path)
    assert built.stack is None
    assert built.image.flash < FLASH_LIMIT
    assert [name for name in symbols(built) if UNWANTED.search(name)] == []


def test_without_a_compiler_one_sentence_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "ziglang", None)
    with pytest.raises(BuildError, match=r"install arm-none-eabi-gcc .* or ziglang"):
        build(TARGETS[0], tmp_path)


def test_an_unknown_target_is_refused_with_the_known_ones(capsys):
    with pytest.raises(SystemExit, match="target motor: expected one of motors-f405_drivers-serial, "):
        arm_build.main(["motor"])


def test_a_file_that_is_cut_short_is_refused(firmwares, tmp_path):
    elf = firmwares[TARGETS[0]].elf.read_bytes()
    path = tmp_path / "cut.elf"
    for length in (*range(200), *range(200, len(elf), 4099), len(elf) - 1):
        path.write_bytes(elf[:length])
        with pytest.raises(ValueError, match=r"cut\.elf is "):
            read_elf(path)


@given(at=st.integers(0, 51), value=st.integers(0, 255))
def test_a_wrong_header_is_read_or_refused_in_a_sentence(at, value):
    elf = bytearray(firmware(*TARGETS[0]).elf.read_bytes())
    elf[at] = value
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "wrong.elf"
        path.write_bytes(elf)
        with contextlib.suppress(ValueError):
            read_elf(path)


def test_what_is_no_arm_firmware_is_refused(tmp_path):
    (tmp_path / "text").write_text("no firmware")
    with pytest.raises(ValueError, match="not a 32-bit little-endian ELF"):
        read_elf(tmp_path / "text")


@pytest.fixture
def small(tmp_path):
    """Compiles a few functions and gives what the analysis of the stack reads."""
    need_gcc()

    def compile_c(source: str):
        (tmp_path / "s.c").write_text(f"void reset(void);\nvoid x_interrupt(void) {{}}\n{source}\n")
        flags = ["-mcpu=cortex-m4", "-mthumb", "-O1", "-fno-inline", "-nostdlib", "-mword-relocations", "-fstack-usage"]
        elf, cwd = tmp_path / "s.elf", {"cwd": tmp_path, "check": True}
        link = ["-Wl,--entry=reset,-Ttext=0x8000000", "-o", str(elf)]
        subprocess.run(["arm-none-eabi-gcc", *flags, *link, "-dumpdir", "./", "s.c"], **cwd)
        dump = ["arm-none-eabi-objdump", "-d", "-z", "--no-show-raw-insn", str(elf)]
        listing = subprocess.run(dump, capture_output=True, text=True, **cwd).stdout
        return worst_stack(listing, (tmp_path / "s.su").read_text(), read_elf(elf))

    return compile_c


_LEAF = "__attribute__((noipa)) void use(volatile char *at) { at[0] = 1; }\n"


def test_the_deepest_of_two_ways_counts(small):
    source = (
        _LEAF + "__attribute__((noipa)) void narrow(void) { char a[16]; use(a); }\n"
        "__attribute__((noipa)) void wide(void) { char a[256]; use(a); }\n"
        "void reset(void) { narrow(); wide(); narrow(); }"
    )
    use = small(source)
    assert [name for name, _ in use.main] == ["reset", "wide", "use"]
    assert dict(use.main)["wide"] >= 256


def test_calls_through_pointers_reach_every_function_whose_address_is_taken(small):
    source = (
        _LEAF + "void far(void) { char a[512]; use(a); }\nvoid near(void) {}\n"
        "void (*const table[])(void) = {near, far};\n"
        "void reset(void) { for (volatile int i = 0; i < 2; i++) table[i](); }"
    )
    use = small(source)
    assert [name for name, _ in use.main] == ["reset", "far", "use"]
    assert use.indirect == ("reset",)
    assert use.reachable == ("far", "near")


def test_recursion_and_frames_of_changing_size_have_no_bound(small):
    with pytest.raises(BuildError, match="calls itself"):
        small("__attribute__((noipa)) int f(int n) { return n ? f(n - 1) + n : 0; }\nvoid reset(void) { f(3); }")
    with pytest.raises(BuildError, match="changing size"):
        small(_LEAF + "__attribute__((noipa)) void f(int n) { char a[n]; use(a); }\nvoid reset(void) { f(3); }")


@pytest.fixture(scope="module")
def memory(tmp_path_factory):
    """The firmware's own memory functions, compiled for this machine under names that are not the C library's."""
    cc = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if cc is None:
        pytest.skip("no C compiler on this machine: install gcc or clang")
    folder = tmp_path_factory.mktemp("memory")
    names = ("memcpy", "memmove", "memset", "memcmp")
    flags = ["-ffreestanding", "-fno-builtin", f"-I{PORT / 'include'}", *(f"-D{name}=own_{name}" for name in names)]
    made = folder / "memory.so"
    subprocess.run([cc, *FIRMWARE_FLAGS, *flags, "-shared", "-fPIC", "-o", made, PORT / "memory.c"], check=True)
    ffi = cffi.FFI()
    ffi.cdef(
        "void *own_memcpy(void *, const void *, size_t); void *own_memmove(void *, const void *, size_t);"
        "void *own_memset(void *, int, size_t); int own_memcmp(const void *, const void *, size_t);"
    )
    return ffi, ffi.dlopen(str(made))


@given(st.binary(min_size=1, max_size=40), st.data())
def test_memory_functions_do_what_the_standard_says(memory, data, draw):
    ffi, lib = memory
    size = draw.draw(st.integers(0, len(data)))
    one, other = (draw.draw(st.integers(0, len(data) - size)) for _ in range(2))
    block = ffi.new("uint8_t[]", data)
    lib.own_memmove(block + one, block + other, size)
    expected = bytearray(data)
    expected[one : one + size] = data[other : other + size]
    assert bytes(ffi.buffer(block, len(data))) == expected
    copy = ffi.new("uint8_t[]", len(data))
    assert lib.own_memcpy(copy, block, len(data)) == copy
    assert lib.own_memcmp(copy, block, len(data)) == 0
    lib.own_memset(copy, data[0], size)
    expected[:size] = data[:1] * size
    assert bytes(ffi.buffer(copy, len(data))) == expected
    difference = lib.own_memcmp(copy, block, len(data))
    now = bytes(ffi.buffer(block, len(data)))
    assert (difference > 0) - (difference < 0) == (expected > now) - (expected < now)
