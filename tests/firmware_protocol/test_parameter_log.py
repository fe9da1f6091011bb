"""Parameters in flash: the real log over a model of NOR flash whose supply fails at any word."""

import re
import shutil
import struct
import subprocess

import cffi
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.arm_build import PORT
from firmware_protocol.built import FIRMWARE_FLAGS, HERE
from firmware_protocol.stm32_flash import PARAMETER_ADDRESS, SECTOR_BYTES, flash_image, newest_stored
from tests.support.examples import share_of_examples
from tests.support.protocol_cases import PROTOCOL

STORED_SIZE = 96  # WHEEL_STORED_SIZE
RECORDS = 1024  # in a sector
WORDS = STORED_SIZE // 4 + 3  # that a STORE programs
stored_bytes = st.binary(min_size=STORED_SIZE, max_size=STORED_SIZE)


@pytest.fixture(scope="module")
def flash(tmp_path_factory):
    """(ffi, library) of the model with the log in it; undefined behaviour traps."""
    cc = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if cc is None:
        pytest.skip("no C compiler on this machine: install gcc or clang")
    model = PROTOCOL.parent / "tests" / "firmware_protocol" / "flash_model.c"
    library = tmp_path_factory.mktemp("flash") / "flash.so"
    trap = ("-fsanitize=undefined", "-fsanitize-undefined-trap-on-error")
    core = (HERE / "firmware" / "crc.c", PORT / "parameter_log.c")
    command = [cc, *FIRMWARE_FLAGS, *trap, "-shared", "-fPIC", f"-I{PORT}", "-o", library, model, *core]
    subprocess.run(list(map(str, command)), check=True)
    ffi = cffi.FFI()
    ffi.cdef(re.findall(r"/\* cffi: begin \*/(.*?)/\* cffi: end \*/", model.read_text(), re.DOTALL)[0])
    return ffi, ffi.dlopen(str(library))


class Robot:
    """A robot's flash, from erased on."""

    def __init__(self, flash) -> None:
        self.ffi, self.lib = flash
        self.lib.model_reset()
        self.open()

    def open(self) -> bytes | None:
        """Reset the chip and return what it finds."""
        out = self.ffi.new("uint8_t[]", STORED_SIZE)
        return bytes(self.ffi.buffer(out)) if self.lib.model_open(out) else None

    def append(self, data: bytes, words_to_live: int = -1, mask: int = 0) -> int:
        return self.lib.model_append(data, words_to_live, mask)


def test_erased_flash_holds_nothing(flash):
    assert Robot(flash).open() is None


@given(st.lists(stored_bytes, min_size=1, max_size=5))
def test_the_newest_survives_a_reset(flash, many):
    robot = Robot(flash)
    for data in many:
        assert robot.append(data) == 1
        assert robot.open() == data


@share_of_examples(3.0)
@given(old=st.none() | stored_bytes, new=stored_bytes, cut=st.integers(0, WORDS - 1), mask=st.integers(0, 2**32 - 1))
def test_a_power_cut_at_any_word_leaves_the_old_or_the_new(flash, old, new, cut, mask):
    robot = Robot(flash)
    if old is not None:
        assert robot.append(old) == 1
    assert robot.append(new, cut, mask) == -1
    assert robot.open() in (old, new)
    assert robot.append(new) == 1, "and the log goes on"
    assert robot.open() == new


def test_a_power_cut_before_the_last_word_leaves_the_old(flash):
    for cut in range(WORDS - 1):
        robot = Robot(flash)
        robot.append(b"o" * STORED_SIZE)
        robot.append(b"n" * STORED_SIZE, cut)
        assert robot.open() == b"o" * STORED_SIZE, cut


def test_a_broken_word_is_told_and_the_next_record_is_good(flash):
    robot = Robot(flash)
    robot.lib.model_break_word(0, 5)
    assert robot.append(b"a" * STORED_SIZE) == 0
    assert robot.append(b"b" * STORED_SIZE) == 1
    assert robot.open() == b"b" * STORED_SIZE


def test_a_full_log_is_erased_by_the_store_that_needs_it(flash):
    robot = Robot(flash)
    for i in range(2 * RECORDS):
        assert robot.append(i.to_bytes(2, "big") * (STORED_SIZE // 2)) == 1
        assert robot.lib.model_is_full() == (i == 2 * RECORDS - 1)
    assert robot.lib.model_erasures == 0
    for i in range(2 * RECORDS):
        assert robot.append(i.to_bytes(2, "little") * (STORED_SIZE // 2)) == 1
        assert robot.lib.model_erasures == 1 + i // RECORDS
    last = (2 * RECORDS - 1).to_bytes(2, "little") * (STORED_SIZE // 2)
    assert robot.open() == last
    assert robot.append(b"z" * STORED_SIZE) == 1
    assert robot.open() == b"z" * STORED_SIZE


@share_of_examples(0.2)
@given(seed=st.integers(0, 2**32 - 1), chance=st.integers(0, 256))
def test_a_power_cut_while_a_full_log_is_erased_leaves_the_newest(flash, seed, chance):
    robot = Robot(flash)
    for _ in range(2 * RECORDS - 1):
        robot.append(b"o" * STORED_SIZE)
    robot.append(b"n" * STORED_SIZE)
    assert robot.lib.model_tear_append(b"z" * STORED_SIZE, seed, chance)
    assert robot.open() == b"n" * STORED_SIZE


def fill(robot: Robot, data: bytes) -> None:
    """Leave a full first sector and, in the second, two records; `data` is the newest."""
    for _ in range(RECORDS + 1):
        robot.append(b"o" * STORED_SIZE)
    robot.append(data)


@share_of_examples(0.3)
@given(new=stored_bytes, seed=st.integers(0, 2**32 - 1), chance=st.integers(0, 256), again=stored_bytes)
def test_a_power_cut_in_an_erasure_leaves_the_newest_and_the_log_goes_on(flash, new, seed, chance, again):
    robot = Robot(flash)
    fill(robot, new)
    assert robot.lib.model_tear_erasure(seed, chance)
    assert robot.open() == new
    assert robot.append(again) == 1
    assert robot.open() == again


def test_a_record_that_lost_bits_falls_back_to_the_good_one_before(flash):
    robot = Robot(flash)
    robot.append(b"o" * STORED_SIZE)
    robot.append(b"n" * STORED_SIZE)
    robot.lib.model_set_word(0, 32 + 5, robot.lib.model_word(0, 32 + 5) | 0x80)
    assert robot.open() == b"o" * STORED_SIZE


def test_erasures_do_not_share_the_time_of_one_feed(flash):
    robot = Robot(flash)
    for sector in (0, 1):
        robot.lib.model_set_word(sector, 99, 0)
    robot.open()
    assert robot.lib.model_erasures == 2
    assert robot.lib.model_most_erasures_unfed == 1


def test_a_sector_that_does_not_get_blank_is_not_written(flash):
    robot = Robot(flash)
    fill(robot, b"n" * STORED_SIZE)
    robot.lib.model_keep_word(0, 77)
    assert robot.open() == b"n" * STORED_SIZE
    for _ in range(RECORDS - 2):
        assert robot.append(b"m" * STORED_SIZE) == 1
    assert robot.append(b"z" * STORED_SIZE) == 0
    assert robot.open() == b"m" * STORED_SIZE


@given(stored_bytes)
def test_the_image_made_for_an_emulator_is_what_a_first_store_leaves(flash, data):
    robot = Robot(flash)
    robot.append(data)
    words = [robot.lib.model_word(0, i) for i in range(32)]
    assert b"".join(word.to_bytes(4, "little") for word in words) == flash_image(data)


def test_the_newest_record_is_read_from_the_bytes_of_both_sectors(flash):
    """After each store, after one that lost a bit, and of an erased chip: what the robot itself would find."""

    def sectors() -> bytes:
        both = bytearray(b"\xff" * 2 * SECTOR_BYTES)
        for sector, record in ((0, RECORDS - 2), (0, RECORDS - 1), (1, 0), (1, 1)):
            words = (robot.lib.model_word(sector, 32 * record + i) for i in range(32))
            struct.pack_into("<32I", both, sector * SECTOR_BYTES + 128 * record, *words)
        return bytes(both)

    robot = Robot(flash)
    assert newest_stored(sectors(), STORED_SIZE) is None
    for _ in range(RECORDS - 1):
        robot.append(b"o" * STORED_SIZE)
    for letter in (b"l", b"m", b"n"):  # over the border between the sectors
        robot.append(letter * STORED_SIZE)
        assert newest_stored(sectors(), STORED_SIZE) == letter * STORED_SIZE == robot.open()
    robot.lib.model_set_word(1, 32 + 23, robot.lib.model_word(1, 32 + 23) ^ 0x8000_0000)
    assert newest_stored(sectors(), STORED_SIZE) == b"m" * STORED_SIZE == robot.open()
    robot.lib.model_set_word(1, 31, robot.lib.model_word(1, 31) ^ 1)  # the complement of its number
    assert newest_stored(sectors(), STORED_SIZE) is None, "the first sector was erased"
    assert robot.open() is None


def test_the_image_lies_where_the_firmware_keeps_it():
    code = "".join((PORT / f"flash_memory.{kind}").read_text(encoding="utf-8") for kind in "ch")
    (address,), (words,) = (re.findall(rf"#define {name} (\w+)u", code) for name in ("FIRST_ADDRESS", "\\w+_WORDS"))
    assert (int(address, 16), 4 * int(words)) == (PARAMETER_ADDRESS, SECTOR_BYTES)


def test_as_many_bytes_as_a_record_holds_are_taken():
    assert flash_image(bytes(range(116)))[:116] == bytes(range(116))


def test_more_bytes_than_a_record_holds_are_refused():
    with pytest.raises(ValueError, match="117 stored bytes"):
        flash_image(bytes(117))
