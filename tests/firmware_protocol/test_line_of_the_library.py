"""Framing in the library as it is shipped, optimised and without sanitizers: the same laws, and its own counters."""

from itertools import pairwise

import pytest
from cobs import cobs
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.extension import library
from firmware_protocol.framer import Deframer, Framer
from firmware_protocol.framing import CAUSES, Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine, PackedFrames, split
from tests.support.bare_node import core
from tests.support.protocol_cases import frames, rejected
from tests.support.wheel_rig import WheelRig

blocks = st.binary(max_size=40) | st.integers(250, 520).map(lambda n: b"\x01" * n)


@given(data=blocks)
def test_cobs_encodes_as_the_cobs_package(data: bytes) -> None:
    ffi, lib = core()
    encoded = ffi.new("uint8_t[]", len(data) + len(data) // 254 + 1)
    written = lib.wheel_cobs_encode(data, len(data), encoded)
    assert bytes(encoded)[:written] == cobs.encode(data)


@given(data=blocks, place=st.integers(0, 520), value=st.integers(0, 255))
@example(data=b"abc", place=0, value=0)
@example(data=b"abc", place=2, value=0)
def test_cobs_decodes_and_refuses_as_the_cobs_package(data: bytes, place: int, value: int) -> None:
    ffi, lib = core()
    block = bytearray(cobs.encode(data))
    block[place % len(block)] = value
    length, in_place = ffi.new("size_t *", len(block)), ffi.new("uint8_t[]", bytes(block))
    accepted = lib.wheel_cobs_decode(in_place, length)
    try:
        expected = cobs.decode(bytes(block))
    except cobs.DecodeError:
        assert not accepted
    else:
        assert accepted
        assert bytes(in_place)[: length[0]] == expected


@pytest.mark.proves("R-GEN-1", "R-SER-3", "R-SER-8")
@given(pieces=st.lists(st.builds(lambda f: Framer().encode(f), frames) | st.binary(max_size=30), max_size=10))
def test_it_takes_and_counts_what_the_python_twin_does(pieces: list[bytes]) -> None:
    stream = b"".join(pieces) + b"".join(serial for _, serial in rejected())
    ffi, lib = core()
    deframer, block = ffi.new("wheel_deframer *"), ffi.new("wheel_frame *")
    lib.wheel_deframer_init(deframer)
    found = [
        Frame(block.id, bytes(block.payload)[: block.length])
        for byte in stream
        if lib.wheel_deframer_feed(deframer, byte, block)
    ]
    twin = Deframer()
    assert found == twin.feed(stream)
    names = {"length": "length_errors", "overrun": "overruns"}
    assert {cause: getattr(deframer, names.get(cause, cause)) for cause in CAUSES} == twin.rejected
    assert (deframer.frames, deframer.lost) == (twin.frames, twin.lost)


def test_it_does_not_send_a_length_that_is_not_the_ids() -> None:
    ffi, lib = core()
    out = ffi.new("uint8_t[15]")
    for number, right in m.LENGTHS.items():
        for length in range(9):
            block = ffi.new("wheel_frame *", {"id": number, "length": length})
            assert lib.wheel_frame_encode(block, 0, out) == (length + 7 if length == right else 0)
    assert lib.wheel_frame_encode(ffi.new("wheel_frame *", {"id": 0x123}), 0, out) == 0


pieces_of_a_line = st.lists(st.builds(lambda f: Framer().encode(f), frames) | st.binary(max_size=30), max_size=20)


@given(pieces=pieces_of_a_line, cuts=st.lists(st.integers(0, 400), max_size=8))
def test_the_hosts_line_hears_what_the_python_twin_does(pieces: list[bytes], cuts: list[int]) -> None:
    stream = b"".join(pieces) + b"".join(serial for _, serial in rejected())
    line, twin = HostLine(), Deframer()
    places = sorted({0, len(stream), *(min(cut, len(stream)) for cut in cuts)})
    for begin, end in pairwise(places):
        heard = line.feed(stream[begin:end])
        assert (list(heard), len(heard)) == (expected := twin.feed(stream[begin:end]), len(expected))
    assert line.rejected == twin.rejected | {"lost": twin.lost}


@pytest.mark.proves("R-SER-2")
@given(sent=st.lists(frames, max_size=300))
def test_the_hosts_line_sends_what_the_python_twin_does(sent: list[Frame]) -> None:
    line, twin = HostLine(), Framer()
    assert [line.encode(frame) for frame in sent] == [twin.encode(frame) for frame in sent]


@pytest.mark.proves("R-SER-7")
@given(half=st.binary(min_size=1, max_size=20))
def test_an_estop_of_the_hosts_line_is_obeyed_behind_half_a_frame(half: bytes) -> None:
    rig, line = WheelRig(), HostLine()
    rig.node.feed(half.replace(b"\0", b"\1"))
    rig.node.feed(line.encode(Frame(m.Estop.ID, b"\1\0")))
    assert rig.state is m.State.ESTOP


@pytest.mark.parametrize(
    "frame", [Frame(0x123, b""), Frame(m.Tick.ID, b"1234567"), Frame(m.Tick.ID, bytes(64)), Frame(1 << 16, b"")]
)
def test_the_hosts_line_refuses_what_the_python_twin_does(frame: Frame) -> None:
    line, twin = HostLine(), Framer()
    with pytest.raises(ValueError, match="expected") as ours:
        line.encode(frame)
    with pytest.raises(ValueError, match="expected") as theirs:
        twin.encode(frame)
    assert str(ours.value) == str(theirs.value)
    right = Frame(m.StepDone.ID, bytes(4))
    assert line.encode(right) == twin.encode(right), "what was refused is not counted"


def test_a_line_begins_the_same_whatever_its_memory_held() -> None:
    ffi, lib = library()
    frame, size = Frame(m.StepDone.ID, bytes(4)), lib.wheel_line_size()
    memory = ffi.new("uint64_t[]", size // 8 + 1)
    ffi.memmove(memory, b"\xa5" * size, size)
    line = ffi.cast("wheel_line *", memory)
    lib.wheel_line_init(line)
    out, used, counts = ffi.new("uint8_t[]", 64), ffi.new("size_t *"), ffi.new("wheel_line_counts *")
    written = lib.wheel_line_encode(line, pack([frame]), len(pack([frame])), out)
    assert (serial := bytes(out)[:written]) == Framer().encode(frame)
    assert lib.wheel_line_feed(line, serial, len(serial), out, used) == 1
    lib.wheel_line_count(line, counts)
    assert bytes(ffi.buffer(counts)) == bytes(ffi.buffer(ffi.new("wheel_line_counts *", {"frames": 1})))


def test_much_at_once_is_taken_whole() -> None:
    framer, line = Framer(), HostLine()
    sent = [Frame(m.StepDone.ID, number.to_bytes(4, "little")) for number in range(10_000)]
    heard = line.feed(b"".join(map(framer.encode, sent)))
    assert (list(heard), len(heard)) == (sent, len(sent))
    assert line.rejected["lost"] == 0


@given(some=st.lists(frames, max_size=9), wide=st.binary(max_size=255))
def test_packed_frames_are_the_frames(some: list[Frame], wide: bytes) -> None:
    some = [*some, Frame(0xFFFF, wide)]
    packed = PackedFrames(pack(some), len(some))
    assert (list(packed), len(packed)) == (some, len(some))
    assert (packed[0], packed[-1], packed[1:]) == (some[0], some[-1], some[1:])
    assert pack(packed) == packed.packed == pack(some)


@given(some=st.lists(frames, max_size=90))
def test_packed_frames_are_encoded_as_one_by_one(some: list[Frame]) -> None:
    one_by_one, at_once = HostLine(), HostLine()
    assert at_once.encode_packed(pack(some)) == b"".join(map(one_by_one.encode, some))


DONE = Frame(m.StepDone.ID, bytes(4))


@pytest.mark.proves("R-SER-3")
def test_up_to_127_missing_frames_are_lost_and_more_are_a_sender_that_began_anew() -> None:
    framer = Framer()
    serial = [framer.encode(DONE) for _ in range(257)]
    for missing in range(256):
        line = HostLine()
        line.feed(serial[0] + serial[missing + 1])
        assert line.rejected["lost"] == (missing if missing <= 127 else 0)


@pytest.mark.parametrize(
    "wrong", [pack([Frame(m.Tick.ID, b"1234567")]), pack([Frame(0x123, b"")]), pack([DONE])[:-1], pack([DONE])[:2]]
)
def test_nothing_is_sent_or_numbered_of_packed_frames_of_which_one_is_none(wrong: bytes) -> None:
    line = HostLine()
    assert line.encode_packed(pack([DONE]) + wrong) == b""
    assert line.encode_packed(pack([DONE])) == Framer().encode(DONE)


def test_more_frames_than_a_client_holds_are_refused() -> None:
    with pytest.raises(ValueError, match="1025 bytes of frames at once: expected at most 1024"):
        HostLine().encode_packed(bytes(1025))


@given(
    some=st.lists(frames, max_size=8),
    limit=st.integers(0, 0x7FF) | st.sampled_from(sorted(m.LENGTHS)),
    cut=st.integers(0, 9),
)
def test_a_split_keeps_the_order_of_both_groups_and_drops_what_is_cut(some: list[Frame], limit: int, cut: int) -> None:
    below, others = split(PackedFrames(pack(some)), limit)
    assert list(below or ()) == [one for one in some if one.id < limit]
    assert list(others or ()) == [one for one in some if one.id >= limit]

    ffi, lib = library()
    packed, out, used = pack(some)[: -cut or None], ffi.new("uint8_t[]", 100), ffi.new("size_t *")
    begin = lib.wheel_packed_split(packed, len(packed), limit, out, used)
    while len(pack(some)) > len(packed):
        some = some[:-1]
    assert bytes(out)[:begin] == pack([one for one in some if one.id < limit])
    assert bytes(out)[begin : used[0]] == pack([one for one in some if one.id >= limit])


@given(pieces=st.lists(frames.map(lambda frame: Framer().encode(frame)) | st.binary(max_size=30), max_size=10))
def test_noise_is_all_that_was_no_frame(pieces: list[bytes]) -> None:
    line = HostLine()
    for piece in pieces:
        line.feed(piece)
        counts = line.rejected
        assert line.noise() == sum(counts.values()) - counts["lost"]
