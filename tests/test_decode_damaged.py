"""A trace that is cut or damaged: what ``hil decode`` prints of it was on the bus, and it says where it ends."""

import json

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.wire.trace import decode
from tests.examples import share_of_examples
from tests.processes import hil

EVERYTHING = decode.Selection.of([], 0, 1000)
LINES = 40


def messages(count):
    for number in range(count):
        yield can.Message(1.7e9 + 0.005 * number, 0x082, False, data=number.to_bytes(8, "big"), is_rx=number % 3 > 0)


def written(path, count=LINES, **options):
    with can.Logger(path, **options) as log:
        for message in messages(count):
            log.on_message_received(message)
    return path


def payloads(reading):
    return [entry.payload for entry in reading]


EXPECTED = [bytes(message.data) for message in messages(20_000)]


def assert_broken_off(path, frames, *words):
    done = hil("decode", path)
    assert done.returncode == 2, done.stderr
    assert len(done.stdout.splitlines()) == frames
    assert "not valid" not in done.stdout
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in (f"{frames or 'no'} frames could be read", *words)), done.stderr


@pytest.mark.parametrize("ending", ["asc", "log", "trc"])
def test_a_last_line_that_is_cut_is_said_and_not_decoded(tmp_path, ending):
    path = written(tmp_path / f"bus.{ending}")
    whole = path.read_bytes().removesuffix(b"End TriggerBlock\n")
    path.write_bytes(whole[:-9])
    assert_broken_off(path, LINES - 1, "cut within line", "not read")


def test_an_asc_file_without_its_end_is_cut(tmp_path):
    path = written(tmp_path / "bus.asc")
    path.write_bytes(path.read_bytes().removesuffix(b"End TriggerBlock\n"))
    assert_broken_off(path, LINES, "End TriggerBlock")


def test_an_asc_line_with_less_data_than_it_says_is_no_frame(tmp_path):
    path = written(tmp_path / "bus.asc")
    lines = path.read_text().splitlines(keepends=True)
    lines[20] = lines[20][:-7] + "\n"
    path.write_text("".join(lines))
    assert_broken_off(path, 15, "8 bytes and has 6")


@pytest.mark.parametrize("ending", ["asc", "log", "trc"])
@pytest.mark.parametrize(
    "garbage", [b"garbage\n", b"\xff\0\x81\n", b"  0.1 1 0%2 Rx d 1 00\n", b"(1.0) can0 082#123\n"]
)
def test_a_line_of_garbage_is_said(tmp_path, ending, garbage):
    path = written(tmp_path / f"bus.{ending}")
    lines = path.read_bytes().splitlines(keepends=True)
    lines.insert(len(lines) - 10, garbage)
    path.write_bytes(b"".join(lines))
    after = 9 if ending == "asc" else 10  # its last line is no frame
    assert_broken_off(path, LINES - after, f"line {len(lines) - 10} ", "damaged")


def test_the_events_of_other_tools_in_an_asc_file_are_no_damage(tmp_path):
    path = tmp_path / "bus.asc"
    path.write_bytes(
        b"date Tue Nov 14 10:13:20.000 PM 2023\r\nbase hex  timestamps absolute\r\nno internal events logged\r\n"
        b"// version 9.0.0\r\nBegin Triggerblock Tue Nov 14 10:13:20.000 PM 2023\r\n"
        b"   0.000000 Start of measurement\r\n"
        b"   0.002 CAN 1 Status:chip status error active\r\n"
        b"   0.003 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%\r\n"
        b"   0.004 Li 60 Rx 8 00 00 00 00 00 00 00 00\r\n\r\n"
        b"   0.005 1  82  Rx   d 2 AB 0C Length = 0 BitCount = 64 ID = 130\r\n"
        b"   0.006 CANFD   2 Rx  82 1 0 a 16 00 01 02 03 04 05 06 07 08 09 0A 0B 0C 0D 0E 0F 0 0 1000 0 0 0 0 0\r\n"
        b"   0.007 1  ErrorFrame  Flags = 0xe\r\n   0.008 1  J1939TP FEE3p 6 0 0 - Rx d 3 01 02 03\r\nEnd TriggerBlock"
    )
    reading = decode.read(path, EVERYTHING)
    assert payloads(reading) == [b"\xab\x0c", bytes(range(16)), b""]
    assert reading.trouble is None


@share_of_examples(2.0)
@given(ending=st.sampled_from(["asc", "log"]), share=st.floats(0, 1, exclude_max=True))
def test_no_cut_makes_up_a_frame(tmp_path_factory, ending, share):
    path = written(tmp_path_factory.mktemp("cut") / f"bus.{ending}")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    reading = decode.read(path, EVERYTHING)
    got = payloads(reading)
    assert got == EXPECTED[: len(got)]
    if reading.trouble is None:  # a last line without its line feed may be whole
        assert len(got) == (len(path.read_bytes().splitlines()) if ending == "log" else LINES)


def test_a_damaged_block_of_a_blf_file_is_said_after_what_comes_before_it(tmp_path):
    path = written(tmp_path / "bus.blf", 20_000)
    content = bytearray(path.read_bytes())
    blocks = [at for at in range(len(content)) if content[at : at + 4] == b"LOBJ"]
    assert len(blocks) > 4
    content[blocks[2] + 1000] ^= 0x10
    path.write_bytes(content)
    reading = decode.read(path, EVERYTHING)
    got = payloads(reading)
    assert 2 * 128 * 1024 // 48 - 1 <= len(got) < 20_000
    assert got == EXPECTED[: len(got)]
    assert f"damaged in the block at byte {blocks[2]}" in reading.trouble


def test_a_blf_file_with_a_piece_missing_is_damaged_where_it_is_missing(tmp_path):
    path = written(tmp_path / "bus.blf", 20_000)
    content = path.read_bytes()
    third = [at for at in range(len(content)) if content[at : at + 4] == b"LOBJ"][2]
    path.write_bytes(content[: third + 1000] + content[third + 1100 :])
    reading = decode.read(path, EVERYTHING)
    got = payloads(reading)
    assert 128 * 1024 // 48 < len(got) < 20_000
    assert got == EXPECTED[: len(got)]
    assert f"damaged in the block at byte {third}" in reading.trouble


def test_a_damaged_blf_file_of_one_block_says_that_it_is_damaged(tmp_path):
    path = written(tmp_path / "bus.blf")
    content = bytearray(path.read_bytes())
    content[len(content) // 2 + 60] ^= 0x10
    path.write_bytes(content)
    assert_broken_off(path, 0, "damaged in the block at byte 144")


@share_of_examples(2.0)
@given(place=st.integers(144, 144 + 300), bit=st.integers(0, 7))
def test_no_damaged_bit_of_a_block_makes_up_a_frame(tmp_path_factory, place, bit):
    path = written(tmp_path_factory.mktemp("damaged") / "bus.blf")
    content = bytearray(path.read_bytes())
    content[place % len(content)] ^= 1 << bit
    path.write_bytes(content)
    reading = decode.read(path, EVERYTHING)
    got = payloads(reading)
    assert got == EXPECTED[: len(got)]
    assert reading.trouble is not None or len(got) == LINES


@pytest.mark.parametrize("arguments", [[], ["--json"]])
def test_counts_of_a_file_that_cannot_be_read_are_not_printed(tmp_path, arguments):
    path = tmp_path / "bus.log"
    path.write_text("no trace at all\n")
    done = hil("decode", path, "--counts", *arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    path.write_text("(1.0) can0 082#0000000000000000\ngarbage\n")
    done = hil("decode", path, "--counts", "--json")
    assert done.returncode == 2
    assert [row["frames"] for row in json.loads(done.stdout)] == [1]
