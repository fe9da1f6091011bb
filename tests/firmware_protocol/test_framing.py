"""Serial framing: whatever arrives, the receiver neither raises nor stays lost, and counts what it drops."""

from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from firmware_protocol.framer import MAX_ENCODED, Deframer, Framer
from firmware_protocol.framing import CAUSES, Frame, crc16
from firmware_protocol.generated.messages import Estop, StepDone
from tests.support.protocol_cases import Vector, frames, rejected, vectors

STEP_DONE = Frame(StepDone.ID, StepDone(tick=7).encode())

wire = st.lists(
    st.one_of(
        st.binary(max_size=40),
        st.builds(lambda frame: Framer().encode(frame), frames),
        st.just(b"\0"),
        st.just(b"\0\0"),
    )
).map(b"".join)
"""What a line may carry: valid frames among bytes of any kind."""


@pytest.mark.proves("R-SER-4")
def test_the_crc_has_its_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1
    assert crc16(b"") == 0xFFFF


@pytest.mark.proves("R-SER-2")
@pytest.mark.parametrize("vector", vectors(), ids=lambda v: f"{v.message.NAME}-{v.sequence}")
def test_golden_vectors(vector: Vector) -> None:
    framer = Framer()
    for _ in range(vector.sequence):
        framer.encode(STEP_DONE)
    begins = b"\0" if vector.frame.id == Estop.ID else b""
    assert framer.encode(vector.frame) == begins + vector.serial
    deframer = Deframer()
    assert deframer.feed(vector.serial) == [vector.frame]
    assert not any(deframer.rejected.values())


@pytest.mark.proves("R-GEN-1", "R-CNT-2", "R-CNT-3", "R-CNT-4", "R-CNT-5", "R-CNT-6")
@pytest.mark.parametrize(("cause", "serial"), rejected(), ids=lambda x: x if isinstance(x, str) else x.hex())
def test_rejected_vectors(cause: str, serial: bytes) -> None:
    deframer = Deframer()
    assert deframer.feed(serial) == []
    assert deframer.rejected == dict.fromkeys(CAUSES, 0) | {cause: 1}


@given(st.lists(frames, max_size=20))
def test_frames_come_back_in_order(sent: list[Frame]) -> None:
    framer, deframer = Framer(), Deframer()
    stream = b"".join(framer.encode(frame) for frame in sent)
    assert deframer.feed(stream) == sent
    assert (deframer.bytes, deframer.frames, deframer.lost) == (len(stream), len(sent), 0)
    assert stream.count(0) == len(sent) + sum(frame.id == Estop.ID for frame in sent)


@given(data=st.binary(max_size=200))
def test_no_bytes_raise(data: bytes) -> None:
    deframer = Deframer()
    for frame in deframer.feed(data):
        assert Framer().encode(frame)  # every accepted frame could have been sent


@given(stream=wire, cuts=st.lists(st.integers(0, 400)))
@example(stream=Framer().encode(STEP_DONE) * 3, cuts=list(range(40)))
def test_where_the_stream_is_split_changes_nothing(stream: bytes, cuts: list[int]) -> None:
    whole, pieces = Deframer(), Deframer()
    edges = sorted({0, len(stream), *(c for c in cuts if c < len(stream))})
    found = [frame for a, b in pairwise(edges) for frame in pieces.feed(stream[a:b])]
    assert found == whole.feed(stream)
    assert pieces.rejected == whole.rejected
    assert (pieces.bytes, pieces.frames, pieces.lost) == (whole.bytes, whole.frames, whole.lost)


@pytest.mark.proves("R-SER-5")
@given(garbage=st.binary(max_size=100), frame=frames)
def test_the_next_zero_ends_every_disturbance(garbage: bytes, frame: Frame) -> None:
    deframer = Deframer()
    deframer.feed(garbage)
    deframer.feed(b"\0")
    assert deframer.feed(Framer().encode(frame)) == [frame]


@pytest.mark.proves("R-SER-6")
@given(frame=frames)
def test_stray_zeros_are_no_errors(frame: Frame) -> None:
    deframer = Deframer()
    assert deframer.feed(b"\0\0" + Framer().encode(frame) + b"\0\0\0") == [frame]
    assert not any(deframer.rejected.values())


@pytest.mark.proves("R-SER-7")
@given(half=st.binary(min_size=1, max_size=MAX_ENCODED), before=st.integers(0, 300))
def test_an_estop_is_heard_behind_half_a_frame(half: bytes, before: int) -> None:
    framer, deframer = Framer(), Deframer()
    for _ in range(before):
        framer.encode(STEP_DONE)
    estop = Frame(Estop.ID, b"\1\0")
    deframer.feed(half.replace(b"\0", b"\1"))
    assert deframer.feed(framer.encode(estop)) == [estop]


@pytest.mark.proves("R-SER-8")
def test_memory_is_bounded_and_an_endless_frame_is_one_overrun() -> None:
    deframer = Deframer()
    for _ in range(100):
        assert deframer.feed(b"\x55" * 1000) == []
        assert len(deframer._open) <= MAX_ENCODED
    assert deframer.rejected["overrun"] == 1
    assert deframer.feed(b"\0" + Framer().encode(STEP_DONE)) == [STEP_DONE]
    assert deframer.rejected["overrun"] == 1


@pytest.mark.proves("R-SER-3")
def test_lost_frames_show_as_gaps_of_the_sequence() -> None:
    framer, deframer = Framer(), Deframer()
    sent = [framer.encode(STEP_DONE) for _ in range(600)]
    kept = [serial for i, serial in enumerate(sent) if i % 100 not in (10, 11, 12)]
    deframer.feed(b"".join(kept))
    assert deframer.lost == 3 * 6
    assert deframer.frames == len(kept)


def test_a_corrupted_frame_is_both_rejected_and_lost() -> None:
    framer, deframer = Framer(), Deframer()
    sent = [bytearray(framer.encode(STEP_DONE)) for _ in range(3)]
    sent[1][4] ^= 0x10
    assert deframer.feed(b"".join(sent)) == [STEP_DONE, STEP_DONE]
    assert (deframer.rejected["crc"], deframer.lost) == (1, 1)


@pytest.mark.proves("R-SER-3")
def test_a_repeated_frame_or_a_new_sender_is_no_loss() -> None:
    framer, deframer = Framer(), Deframer()
    for _ in range(50):
        serial = framer.encode(STEP_DONE)
        deframer.feed(serial + serial)
    deframer.feed(Framer().encode(STEP_DONE))
    assert deframer.lost == 0


def test_the_framer_refuses_what_the_other_side_would_drop() -> None:
    framer = Framer()
    with pytest.raises(ValueError, match=r"0x301 with 3 bytes: expected 4 bytes"):
        framer.encode(Frame(StepDone.ID, b"\0\0\0"))
    with pytest.raises(ValueError, match=r"0x7ff with 8 bytes: expected the id of a message"):
        framer.encode(Frame(0x7FF, bytes(8)))
    deframer = Deframer()
    deframer.feed(framer.encode(STEP_DONE))
    assert framer.encode(STEP_DONE)[3] == 1, "a refused frame must not take a sequence number"


@pytest.mark.parametrize("vector", vectors()[::7], ids=lambda v: f"{v.message.NAME}-{v.sequence}")
def test_no_one_or_two_wrong_bits_pass(vector: Vector) -> None:
    """A part of the vectors; the C test does the same for every one of them."""
    bits = 8 * len(vector.serial)
    serial = int.from_bytes(vector.serial, "little")
    deframer = Deframer()
    for i in range(bits):
        for j in range(i, bits):
            wrong = serial ^ (1 << i | 1 << j)
            assert deframer.feed(wrong.to_bytes(len(vector.serial), "little") + b"\0") == []
