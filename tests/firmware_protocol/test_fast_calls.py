"""The calls of a tick from Python: as the library's own, and CPython's exceptions for what is no argument of theirs."""

import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.codec import encode
from firmware_protocol.fast_calls import RowLayout, Scaled, fast_call
from firmware_protocol.framer import Framer
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine, PackedFrames, packed_of
from hil.core.types import (
    Axes,
)
from tests.support.client_rig import kept_bytes, new_client, sent

FOUR = (1.0, -2.0, 3, 4.5)


def test_a_command_takes_numbers_of_any_kind() -> None:
    client = new_client()
    assert client.command(FOUR, (0, 0, 0, True), 0) == 1
    assert sent(client) == [m.TorqueFeedforward(0, 0, 0, 1, 1, 1), m.WheelCommand(*FOUR, 1, 1)]


@pytest.mark.parametrize(
    ("wrong", "error"),
    [((1.0, 2.0), IndexError), (("a",) * 4, TypeError), ([1.0] * 4, SystemError), (None, SystemError)],
)
@pytest.mark.parametrize("place", [0, 1])
def test_what_is_no_tuple_of_four_numbers_raises_and_sends_nothing(wrong: object, error: type, place: int) -> None:
    client = new_client()
    arguments = [FOUR, FOUR, 0]
    arguments[place] = wrong
    with pytest.raises(error):
        client.command(*arguments)
    assert sent(client) == []


def test_a_time_that_is_no_int_raises() -> None:
    client = new_client()
    for call in (
        lambda: client.poll(None),  # type: ignore[arg-type]
        lambda: client.command(FOUR, FOUR, "now"),  # type: ignore[arg-type]
        lambda: fast_call("step")(0, client.address, None, 0),
        lambda: client.poll(1 << 70),
    ):
        with pytest.raises((TypeError, OverflowError)):
            call()
    assert not client.view.out_bytes


NAMES = ("x", "y", "h", "to_x", "to_y", "to_h", "dx", "dy", "dh", "d", "a", "b")
numbers = st.floats(allow_nan=False, allow_infinity=False, width=32)


@given(pose=st.tuples(numbers, numbers, numbers), to=st.tuples(numbers, numbers, numbers), a=numbers)
def test_a_row_has_each_number_in_its_place_and_the_difference_of_the_poses(pose: Axes, to: Axes, a: float) -> None:
    layout = RowLayout(NAMES, (NAMES[:3], (NAMES[3:6], None), Scaled("a", 0.5)), ("x", "to_x", "dx"))
    row = dict(zip(NAMES, memoryview(layout.row(pose, (to, "left out"), a)).cast("d"), strict=True))
    x, y, h = (one - other for one, other in zip(pose, to, strict=True))
    assert [row[name] for name in NAMES[:9]] == [*pose, *to, x, y, math.remainder(h, math.tau)]
    assert row["d"] == pytest.approx(math.hypot(x, y), rel=1e-15)
    assert row["a"] == 0.5 * a
    assert math.isnan(row["b"]), "no object has it"


def test_an_infinite_heading_has_no_difference() -> None:
    layout = RowLayout(NAMES, (NAMES[:3], NAMES[3:6]), ("x", "to_x", "dx"))
    row = memoryview(layout.row((0, 0, math.inf), (0, 0, 0))).cast("d")
    assert math.isnan(row[NAMES.index("dh")])


@pytest.mark.parametrize(
    ("objects", "error"), [((("a", 1),), TypeError), (((1,),), IndexError), ((1,), SystemError), ((None,), SystemError)]
)
def test_what_has_not_the_layout_of_a_row_raises(objects: tuple, error: type) -> None:
    layout = RowLayout(("a", "b", "x", "y", "h", "d"), (("a", "b"),), ("a", "a", "x"))
    with pytest.raises(error):
        layout.row(*objects)


@pytest.mark.parametrize("wrong", [None, "a", bytearray(3), 3])
def test_what_is_no_bytes_raises(wrong: object) -> None:
    client = new_client()
    for call in (
        lambda: client.take(wrong, 0, 0),  # type: ignore[arg-type]
        lambda: fast_call("hold")(0, 0, wrong),
        lambda: fast_call("split")(wrong, 0x300),
        lambda: fast_call("frames")(wrong, Frame),
        lambda: HostLine().receive_for(client.address, wrong, 0),  # type: ignore[arg-type]
    ):
        with pytest.raises(TypeError):
            call()


@given(some=st.lists(st.builds(Frame, st.integers(0, 0xFFFF), st.binary(max_size=255)), max_size=9))
def test_frames_are_packed_as_in_python(some: list[Frame]) -> None:
    assert packed_of(some) == packed_of(PackedFrames(pack(some))) == pack(some)


@pytest.mark.parametrize(
    "wrong", [3, (3,), (1, "a"), (1,), Frame(1 << 16, b""), Frame(-1, b""), Frame(1 << 70, b""), Frame(1, bytes(256))]
)
def test_what_is_no_frame_is_not_packed(wrong: object) -> None:
    with pytest.raises((TypeError, IndexError, SystemError)):
        packed_of([Frame(1, b"a"), wrong])  # type: ignore[list-item]
    with pytest.raises(SystemError):
        fast_call("pack")([])  # no tuple


def test_noise_is_the_sum_of_what_is_rejected_but_for_lost_frames() -> None:
    line, framer = HostLine(), Framer()
    framer.encode(encode(m.Step(0, 1)))  # never comes
    whole = framer.encode(encode(m.StepDone(1)))
    line.feed(b"\2a\0".join((whole, whole[:3] + b"\1" + whole[4:], b"x" * 99, b"")))
    counts = line.rejected
    assert line.noise() == sum(counts.values()) - counts["lost"] > 2


def test_a_number_that_is_no_int_raises() -> None:
    client = new_client()
    for call in (
        lambda: fast_call("ask", client.handle)(None),
        lambda: client.take(b"", None, 0),  # type: ignore[arg-type]
        lambda: client.take(b"", 0, "now"),  # type: ignore[arg-type]
        lambda: fast_call("split")(b"", None),
    ):
        with pytest.raises(TypeError):
            call()
    assert not client.view.out_bytes


some_frames = st.lists(
    st.sampled_from(
        [m.Tick(1000, 3, 7, m.State.ACTIVE, 1, 1), m.Encoders(1, 2, 3, 4), m.TimeSyncResponse(1, 2, 3), m.StepDone(7)]
    ).map(encode),
    max_size=12,
)


@given(frames=some_frames, noise=st.binary(max_size=20), cut=st.integers(0, 200))
def test_received_bytes_leave_a_client_as_their_frames_do(frames: list[Frame], noise: bytes, cut: int) -> None:
    here, packed_way = HostLine(), HostLine()
    at_once, one_by_one = new_client(), new_client()
    framer = Framer()
    data = noise + b"\0" + b"".join(framer.encode(frame) for frame in frames)
    for piece in (data[:cut], data[cut:]):
        taken = here.receive_for(at_once.address, piece, 5)
        packed = packed_way.feed(piece).packed
        if not isinstance(taken, int):
            rest, at = taken
            assert rest == packed
            while at < len(rest):
                at = at_once.take(rest, at, 5)
        at = 0
        while at < len(packed):
            at = one_by_one.take(packed, at, 5)
    assert (at_once.view.received, at_once.view.step_done_tick) == (
        one_by_one.view.received,
        one_by_one.view.step_done_tick,
    )
    assert at_once.hexdigest() == one_by_one.hexdigest()
    assert here.rejected == packed_way.rejected


def test_what_waits_is_encoded_as_a_line_does() -> None:
    here, packed_way, client = HostLine(), HostLine(), new_client()
    assert here.encode_for(client.address) == b""
    for _ in range(2):
        client.command(FOUR, FOUR, 0)
        client.estop()
        packed = client.out().packed
        assert here.encode_for(client.address) == packed_way.encode_packed(packed)
        assert client.sent() == 3
        assert here.encode_for(client.address) == b""


def test_what_is_due_is_added_when_all_was_taken() -> None:
    line, client = HostLine(), new_client()
    client.request(m.Request.IDLE, 0)
    client.sent()
    assert line.receive_for(client.address, b"", 99_999_999) == 0
    assert line.receive_for(client.address, b"", 100_000_000) == (b"", 0)
    assert [message.request for message in sent(client)] == [m.Request.IDLE]


def test_a_thousand_receptions_leave_no_object_behind() -> None:
    line, client, framer = HostLine(), new_client(), Framer()
    data = framer.encode(encode(m.TimeSyncResponse(1, 2, 3)))
    before = sys.getrefcount(data)

    def receive() -> None:
        assert not isinstance(line.receive_for(client.address, data, 0), int)
        client.hash_log()

    assert kept_bytes(receive) < 10_000
    assert sys.getrefcount(data) == before


def test_a_thousand_splits_leave_no_object_behind() -> None:
    packed = pack([Frame(0x100, bytes(8)), Frame(0x300, b"")])
    before = sys.getrefcount(packed)

    def split() -> None:
        assert PackedFrames(packed)[1] == Frame(0x300, b"")
        assert fast_call("split")(packed, 0x300) == (packed[:11], packed[11:])

    assert kept_bytes(split) < 10_000
    assert sys.getrefcount(packed) == before


def test_what_calls_leave_behind_is_seen() -> None:
    left: list[bytes] = []
    assert kept_bytes(lambda: left.append(bytes(len(left)))) > 500_000
