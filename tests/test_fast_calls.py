"""The calls of a tick from Python: as the library's own, and CPython's exceptions for what is no argument of theirs."""

import math
import sys
import tracemalloc
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.client import Client
from firmware_protocol.codec import encode
from firmware_protocol.fast_calls import RowLayout, Scaled, fast_call
from firmware_protocol.fast_tuples import Choice, Tuple, fields_of, tuple_maker
from firmware_protocol.framing import Frame, Framer, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import library
from firmware_protocol.host_line import HostLine
from hil.core import makers
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
    Axes,
    CommandMode,
    Pose,
    Reference,
    State,
    Twist,
    WheelCommand,
    Wheels,
)
from hil.robot.channel import feedback_reader
from hil.robot.snapshot import Feedback
from tests.client_rig import feed, feedback, new_client, sent

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


def a_robot_in(state: m.State) -> Client:
    """Return a client that has one snapshot, of all parts."""
    client = new_client()
    tick = m.Tick(5_000, 3, 7, state, 31, 1)
    feed(
        client,
        [
            tick,
            m.Encoders(1, 2, 3, 4),
            m.WheelSpeeds(0.1, 0.2, 0.3, 0.4),
            m.Currents(1.0, 2.0, 3.0, 4.0),
            m.Accelerometer(0.5, 0.25, 9.75, 5),
            m.Gyro(0.0, 0.0, 0.125, 5),
        ],
    )
    return client


def test_feedback_is_a_named_tuple_with_what_the_view_has() -> None:
    client = a_robot_in(m.State.ACTIVE)
    found = feedback_reader(client)()
    assert found == feedback(client)
    assert type(found) is Feedback
    assert (type(found.speed_rad_s), type(found.current_a), found.state) == (Wheels, Wheels, m.State.ACTIVE)


def test_feedback_and_rows_leave_no_object_behind() -> None:
    client = a_robot_in(m.State.ACTIVE)
    states, read = tuple(m.State), feedback_reader(client)
    layout = RowLayout(("a", "b", "x", "y", "h", "d"), ("a", (None, Scaled("b", 2.0))), ("a", "a", "x"))
    references = [sys.getrefcount(one) for one in (*states, None, Feedback, Wheels)]
    tracemalloc.start()
    for _ in range(1000):
        assert read().command_age_ms == 7
        assert layout.row(1, (0, 3)) == layout.row(1.0, ("left out", True + 2))
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    grown = [sys.getrefcount(one) for one in (*states, None, Feedback, Wheels)]
    assert all(abs(now - before) < 100 for now, before in zip(grown, references, strict=True))
    assert kept_bytes < 10_000


def test_feedback_in_a_state_that_nobody_named_raises() -> None:
    client = a_robot_in(m.State.ESTOP)
    (state,) = fields_of(library()[0], client.view, "state")
    before = sys.getrefcount(Wheels)
    read = tuple_maker(Tuple(Wheels, (state, Choice(state.address, (m.State.BOOT,)))), client)
    for _ in range(1000):
        with pytest.raises(IndexError):
            read()
    assert sys.getrefcount(Wheels) < before + 100


def test_a_reader_keeps_the_memory_that_it_reads() -> None:
    ffi, _ = library()
    numbers, owner = ffi.new("wheel_view *"), []
    numbers.speed_rad_s, numbers.tick, numbers.robot_time_us = (1.0, 2.0, 3.0, 4.0), 7, 1 << 40
    numbers = ffi.gc(numbers, lambda _: owner.append("freed"))
    (time,) = fields_of(ffi, numbers, "robot_time_us")
    some = Tuple(None, fields_of(ffi, numbers, "speed_rad_s", 1, 2))
    read = tuple_maker(Tuple(None, (time._replace(factor=1000), some)), numbers)
    del numbers
    assert read() == (1000 << 40, (2.0, 3.0))
    assert not owner
    del read
    assert owner == ["freed"]


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
        lambda: fast_call("exchange")(0, client.address, wrong),
        lambda: fast_call("split")(wrong, 0x300),
        lambda: HostLine().receive_for(client.address, wrong, 0),  # type: ignore[arg-type]
    ):
        with pytest.raises(TypeError):
            call()


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
    tracemalloc.start()
    for _ in range(1000):
        assert not isinstance(line.receive_for(client.address, data, 0), int)
        client.hash_log()
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sys.getrefcount(data) == before
    assert kept_bytes < 10_000


def test_a_thousand_splits_leave_no_object_behind() -> None:
    packed = pack([Frame(0x100, bytes(8)), Frame(0x300, b"")])
    before = sys.getrefcount(packed)
    tracemalloc.start()
    for _ in range(1000):
        assert fast_call("split")(packed, 0x300) == (packed[:11], packed[11:])
    kept_bytes, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sys.getrefcount(packed) == before
    assert kept_bytes < 10_000


NINE = tuple(range(9))
MADE: list[tuple[Callable[..., tuple], tuple, tuple]] = [
    (makers.make_loop_signals, (1.0, 2, 3.0, 4.0, 5), LoopSignals(1.0, 2, 3.0, 4.0, 5)),
    (makers.make_state, (Pose(1, 2, 3), Twist(4, 5, 6)), State(Pose(1, 2, 3), Twist(4, 5, 6))),
    (makers.make_reference, NINE, Reference(Pose(0, 1, 2), Twist(3, 4, 5), Acceleration(6, 7, 8))),
    (makers.make_torque_command, FOUR, WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, Wheels(*FOUR))),
    (makers.make_speed_command, (*FOUR, *FOUR), WheelCommand(CommandMode.SPEED, Wheels(*FOUR), Wheels(*FOUR))),
]


def types_in(value: object) -> object:
    """Return the class of a value, with those in a tuple."""
    return (type(value), *map(types_in, value)) if isinstance(value, tuple) else type(value)


@pytest.mark.parametrize(("make", "arguments", "expected"), MADE)
def test_what_a_maker_makes_is_what_its_classes_make(
    make: Callable[..., tuple], arguments: tuple, expected: tuple
) -> None:
    made = make(*arguments)
    assert (made, types_in(made)) == (expected, types_in(expected))
    for wrong in (arguments[1:], (*arguments, 0.0)):
        with pytest.raises(TypeError, match="argument"):
            make(*wrong)


@pytest.mark.parametrize(("make", "arguments", "_expected"), MADE)
def test_a_thousand_tuples_leave_no_object_behind(
    make: Callable[..., tuple], arguments: tuple, _expected: tuple
) -> None:
    seen = (*arguments, ZERO_WHEELS, CommandMode.TORQUE, Pose, Wheels)
    before = [sys.getrefcount(one) for one in seen]
    for _ in range(1000):
        make(*arguments)
    assert all(sys.getrefcount(one) < count + 100 for one, count in zip(seen, before, strict=True))
