"""Named tuples that the host library makes: what their classes make, of arguments, of memory and of packed frames."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol.client import Client
from firmware_protocol.codec import encode
from firmware_protocol.fast_calls import RowLayout, Scaled
from firmware_protocol.fast_tuples import Choice, Kept, Tuple, fields_of, tuple_constructor
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import library
from firmware_protocol.host_line import PackedFrames
from hil.core import tuples
from hil.core.signals import LoopSignals
from hil.core.types import (
    ZERO_WHEELS,
    Acceleration,
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
from tests.support.client_rig import feed, feedback, kept_bytes, new_client

FOUR = (1.0, -2.0, 3, 4.5)


some_frames = st.lists(
    st.sampled_from(
        [m.Tick(1000, 3, 7, m.State.ACTIVE, 1, 1), m.Encoders(1, 2, 3, 4), m.TimeSyncResponse(1, 2, 3), m.StepDone(7)]
    ).map(encode),
    max_size=12,
)


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


@given(st.lists(st.sampled_from([0.0, -0.0, 1.5, float("nan"), float("inf")]), min_size=1, max_size=20))
def test_a_kept_tuple_has_the_numbers_of_now_and_is_the_same_while_they_are(values: list[float]) -> None:
    ffi, _ = library()
    numbers = ffi.new("wheel_view *")
    make = tuple_constructor(Tuple(None, (Kept(Tuple(Wheels, fields_of(ffi, numbers, "current_a"))),)), numbers)
    before, (held,) = bytes(16), make()
    for place, value in enumerate(values):
        numbers.current_a[place % 4] = value
        now = bytes(ffi.buffer(numbers.current_a))
        (made,) = make()
        assert type(made) is Wheels
        assert list(map(repr, made)) == list(map(repr, numbers.current_a))
        assert (made is held) == (now == before)
        before, held = now, made
    references = sys.getrefcount(held)
    for _ in range(100):
        make()
    assert sys.getrefcount(held) == references


@given(st.tuples(*[st.floats()] * 6))
def test_a_state_is_finite_when_each_of_its_numbers_is(six: tuple[float, ...]) -> None:
    state = State(Pose(*six[:3]), Twist(*six[3:]))
    assert tuples.is_finite(state) == all(map(math.isfinite, six))


def test_without_a_snapshot_there_is_no_feedback() -> None:
    assert feedback_reader(new_client())() is None


def test_feedback_and_rows_leave_no_object_behind() -> None:
    client = a_robot_in(m.State.ACTIVE)
    states, read = tuple(m.State), feedback_reader(client)
    layout = RowLayout(("a", "b", "x", "y", "h", "d"), ("a", (None, Scaled("b", 2.0))), ("a", "a", "x"))
    references = [sys.getrefcount(one) for one in (*states, None, Feedback, Wheels)]

    def make() -> None:
        assert read().command_age_ms == 7
        assert layout.row(1, (0, 3)) == layout.row(1.0, ("left out", True + 2))

    assert kept_bytes(make) < 10_000
    grown = [sys.getrefcount(one) for one in (*states, None, Feedback, Wheels)]
    assert all(abs(now - before) < 100 for now, before in zip(grown, references, strict=True))


def test_feedback_in_a_state_that_nobody_named_raises() -> None:
    client = a_robot_in(m.State.ESTOP)
    (state,) = fields_of(library()[0], client.view, "state")
    before = sys.getrefcount(Wheels)
    read = tuple_constructor(Tuple(Wheels, (state, Choice(state.address, (m.State.BOOT,)))), client)
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
    read = tuple_constructor(Tuple(None, (time._replace(factor=1000), some)), numbers)
    del numbers
    assert read() == (1000 << 40, (2.0, 3.0))
    assert not owner
    del read
    assert owner == ["freed"]


NINE = tuple(range(9))


MADE: list[tuple[Callable[..., tuple], tuple, tuple]] = [
    (tuples.make_loop_signals, (1.0, 2, 3.0, 4.0, 5), LoopSignals(1.0, 2, 3.0, 4.0, 5)),
    (tuples.make_state, (Pose(1, 2, 3), Twist(4, 5, 6)), State(Pose(1, 2, 3), Twist(4, 5, 6))),
    (tuples.make_reference, NINE, Reference(Pose(0, 1, 2), Twist(3, 4, 5), Acceleration(6, 7, 8))),
    (tuples.make_torque_command, FOUR, WheelCommand(CommandMode.TORQUE, ZERO_WHEELS, Wheels(*FOUR))),
    (tuples.make_speed_command, (*FOUR, *FOUR), WheelCommand(CommandMode.SPEED, Wheels(*FOUR), Wheels(*FOUR))),
]


def types_in(value: object) -> object:
    """Return the class of a value, with those in a tuple."""
    return (type(value), *map(types_in, value)) if isinstance(value, tuple) else type(value)


@pytest.mark.parametrize(("make", "arguments", "expected"), MADE)
def test_what_is_made_is_what_its_classes_make(make: Callable[..., tuple], arguments: tuple, expected: tuple) -> None:
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


@given(frames=some_frames)
def test_packed_frames_come_apart_as_they_were(frames: list[Frame]) -> None:
    unpacked = tuple(PackedFrames(pack(frames)))
    assert list(unpacked) == frames
    assert all(type(frame) is Frame for frame in unpacked)


def test_without_the_library_only_what_makes_tuples_is_refused(tmp_path: Path) -> None:
    """Whatever needs no run, such as ``hil doctor``, works then. It is another process because of the import."""
    missing = tmp_path / "missing"
    program = "import hil.laws, hil.core.tuples as t; print('imported'); t.make_wheels(1.0, 2.0, 3.0, 4.0)"
    environment = os.environ | {"WHEEL_HOST_LIBRARY": str(missing)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == "imported\n"
    assert f"BadInputError: {missing} does not exist; build it, or unset WHEEL_HOST_LIBRARY" in done.stderr
