"""A cut or damaged trace: ``hil decode`` prints only frames that were on the bus, and says where the trace ends."""

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.addons.report.trace import trace_decoder as decode
from tests.support.examples import share_of_examples
from tests.support.processes import hil

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
    return [entry.frame.payload for entry in reading]


EXPECTED = [bytes(message.data) for message in messages(20_000)]


def assert_broken_off(path, frames, *words):
    done = hil("decode", path)
    assert done.returncode == 2, done.stderr
    assert len(done.stdout.splitlines()) == frames
    assert "not valid" not in done.stdout
    assert done.stderr.count("\n") == 1
    assert all(word in done.stderr for word in (f"{frames or 'no'} frames could be read", *words)), done.stderr


def test_a_last_line_that_is_cut_is_said_and_not_decoded(tmp_path):
    path = written(tmp_path / "bus.log")
    path.write_bytes(path.read_bytes()[:-9])
    assert_broken_off(path, LINES - 1, "cut within line", "not read")


@pytest.mark.parametrize("garbage", [b"garbage\n", b"\xff\0\x81\n", b"(1.0) can0 082#123\n"])
def test_a_line_of_garbage_is_said(tmp_path, garbage):
    path = written(tmp_path / "bus.log")
    lines = path.read_bytes().splitlines(keepends=True)
    lines.insert(len(lines) - 10, garbage)
    path.write_bytes(b"".join(lines))
    assert_broken_off(path, LINES - 10, f"line {len(lines) - 10} ", "damaged")


@share_of_examples(2.0)
@given(share=st.floats(0, 1, exclude_max=True))
def test_no_cut_makes_up_a_frame(tmp_path_factory, share):
    path = written(tmp_path_factory.mktemp("cut") / "bus.log")
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    reading = decode.read(path, EVERYTHING)
    got = payloads(reading)
    assert got == EXPECTED[: len(got)]
    if reading.trouble is None:  # a last line without its line feed may be whole
        assert len(got) == len(path.read_bytes().splitlines())


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
