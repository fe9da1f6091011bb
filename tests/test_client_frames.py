"""What the client of the protocol sends, takes and logs, held against the codec in Python."""

import hashlib
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host import library
from hil.core.types import FourWheels
from tests.client_rig import feed, new_client, sent, take
from tests.examples import share_of_examples
from tests.protocol_cases import frames as any_frames

REST = (0.0,) * 4

# Commands

numbers = (
    st.floats(allow_nan=True, allow_infinity=True, width=64)
    | st.floats(-70.0, 70.0)
    | st.integers(-9000, 9000).map(lambda n: n / 256)
)
wheels = st.tuples(*[numbers] * 4) | st.just(REST)


def encoded(kind: type[m.Message], values: tuple[float, ...], sequence: int) -> m.Message | None:
    """Return what arrives of a message, by the codec in Python; None for one that it cannot encode."""
    try:
        return codec.decode(codec.encode(kind(*values, sequence, 0xB)))
    except (ValueError, OverflowError):
        return None


@pytest.mark.proves("R-GEN-7", "R-GEN-9")
@share_of_examples(3.0)
@given(mode=st.sampled_from(m.Mode), speed=wheels, torque=wheels)
def test_a_command_has_the_bytes_that_the_codec_gives(
    mode: m.Mode, speed: tuple[float, ...], torque: tuple[float, ...]
) -> None:
    client = new_client(mode, nonce=0xAB)
    if mode is m.Mode.TORQUE:
        expected = [encoded(m.TorqueCommand, torque, 1)]
    else:
        ahead = [encoded(m.TorqueFeedforward, torque, 1)] if any(torque) else []
        expected = [*ahead, encoded(m.WheelCommand, speed, 1)]
    number = client.command(speed, torque, 0)
    assert (number, sent(client)) == ((-1, []) if None in expected else (1, expected))


def test_a_command_that_has_no_room_is_refused_and_the_next_one_is_numbered_on() -> None:
    client = new_client()
    numbers = [client.command(REST, REST, 0) for _ in range(200)]
    count = numbers.index(-1)
    assert numbers[:count] == list(range(1, count + 1))
    assert set(numbers[count:]) == {-1}
    assert len(sent(client)) == count
    assert client.command(REST, REST, 0) == 201


@pytest.mark.parametrize(("number", "payload"), [(0x123, b""), (m.TimeSyncRequest.ID, b"12"), (m.Step.ID, bytes(9))])
def test_only_a_message_of_the_protocol_is_added(number: int, payload: bytes) -> None:
    client = new_client()
    with pytest.raises(ValueError, match="cannot be sent"):
        client.add(number, payload)
    assert sent(client) == []


@given(
    wheels=st.permutations(range(4)),
    signs=st.tuples(*[st.sampled_from((1, -1))] * 4),
    values=st.tuples(*[st.integers(-31, 31)] * 4),
)
def test_wiring_gives_each_channel_its_wheel(wheels: list[int], signs: tuple[int, ...], values: FourWheels) -> None:
    client = new_client()
    client.wire(wheels, signs)
    client.command(values, (0.0,) * 4, 0)
    channels = [sign * values[wheel] for wheel, sign in zip(wheels, signs, strict=True)]
    assert sent(client) == [m.WheelCommand(*channels, 1, 1)]
    (found,) = feed(
        client,
        [m.Tick(0, 0, 0, m.State.IDLE, 7, 0), m.Encoders(*(one & 0xFFFF for one in channels))]
        + [kind(*channels) for kind in (m.WheelSpeeds, m.Currents)],
    )
    assert found.speed_rad_s == found.current_a == values
    assert found.encoder_count == tuple(value & 0xFFFF for value in values)


@pytest.mark.parametrize(
    ("wheels", "signs"),
    [((0, 1, 2, 2), (1,) * 4), ((0, 1, 2, 4), (1,) * 4), (range(4), (1, 1, 1, 0)), (range(4), (0, 1, 1, 1))],
)
def test_a_wiring_that_is_none_is_refused(wheels: Sequence[int], signs: Sequence[int]) -> None:
    with pytest.raises(ValueError, match="on the channels"):
        new_client().wire(wheels, signs)


# What arrives


def test_frames_of_another_protocol_are_counted() -> None:
    client = new_client()
    assert take(client, [Frame(0x123, b"12"), Frame(0xFFFF, bytes(64))]) == []
    assert (client.view.out_of_range, client.view.received) == (2, 0)


@pytest.mark.parametrize("number", sorted(m.LENGTHS))
def test_a_message_of_a_wrong_length_is_counted_as_out_of_range(number: int) -> None:
    client = new_client()
    for length in range(9):
        if length != m.LENGTHS[number]:
            assert take(client, [Frame(number, bytes(length))]) == []
    assert (client.view.out_of_range, client.view.received) == (8, 0)


# Lockstep

NONE, AWAITED, DONE, ELSEWHERE = range(4)


def test_a_step_is_done_by_its_answer_alone_and_a_second_answer_is_not_logged() -> None:
    client = new_client()
    assert client.view.step == NONE
    client.step(0)
    take(client, [codec.encode(m.StepDone(40))])
    assert (client.view.step, client.view.tick) == (DONE, 40)
    client.step(5)
    client.step_again()
    assert sent(client) == [m.Step(0, 0), m.Step(40, 5), m.Step(40, 5)]
    take(client, [codec.encode(m.StepDone(40))])  # the step before, which was sent twice
    assert client.view.step == AWAITED
    take(client, [codec.encode(m.StepDone(45))] * 2)
    assert (client.view.step, client.view.tick) == (DONE, 45)
    assert (client.view.sent, client.view.received) == (2, 4)
    assert client.hexdigest() == digest([m.Step(0, 0), m.Step(40, 5)], [m.StepDone(40), m.StepDone(45)])


def test_an_answer_with_another_tick_is_told_with_both() -> None:
    client = new_client()
    client.step(5)
    take(client, [codec.encode(m.StepDone(7))])
    assert (client.view.step, client.view.step_done_tick, client.view.step_target) == (ELSEWHERE, 7, 5)
    assert client.view.tick == 0


def test_the_tick_of_a_robot_that_may_be_another_is_asked_for_as_the_first_time() -> None:
    client = new_client()
    client.step(5)
    take(client, [codec.encode(m.StepDone(5))])
    assert (client.view.tick, sent(client)) == (5, [m.Step(0, 5)])
    client.begin(2)
    client.step(0)
    assert sent(client) == [m.Step(0, 0)]


# The log


def digest(to_robot: list[m.Message], to_host: list[m.Message]) -> str:
    each = [hashlib.sha256(pack(map(codec.encode, way))).digest() for way in (to_robot, to_host)]
    return hashlib.sha256(b"".join(each)).hexdigest()


@given(turns=st.lists(st.tuples(st.lists(any_frames, max_size=8), st.integers(0, 8), st.booleans()), max_size=12))
def test_the_log_has_every_message_in_order_but_for_hello_and_what_was_not_sent(turns: list) -> None:
    client = new_client()
    to_robot: list[Frame] = []
    to_host: list[Frame] = []
    for received, commands, arrives in turns:
        take(client, received)
        valid = [frame for frame in received if codec.decode(frame) is not None]
        to_host += [frame for frame in valid if frame.id < m.HelloRequest.ID and frame.id != m.StepDone.ID]
        for _ in range(commands):
            client.command(REST, REST, 0)
        client.add(m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION]))
        if arrives:
            to_robot += [frame for frame in client.out() if frame.id < m.HelloRequest.ID]
            client.sent()
        else:
            client.unsent()
    ours = [hashlib.sha256(pack(way)).digest() for way in (to_robot, to_host)]
    assert client.hexdigest() == hashlib.sha256(b"".join(ours)).hexdigest()
    assert client.view.sent == len(to_robot)


def test_a_log_that_is_never_taken_stops_the_client_before_it_overflows() -> None:
    client = new_client()
    packed = pack([codec.encode(m.Encoders(1, 2, 3, 4))] * 5000)
    at = client.take(packed, 0, 0)
    assert client.view.log_is_due
    assert 0 < at < len(packed)
    assert client.take(packed, at, 0) == at
    while at < len(packed):
        client.hash_log()
        at = client.take(packed, at, 0)
    assert client.view.received == 5000
    assert client.hexdigest() == digest([], [m.Encoders(1, 2, 3, 4)] * 5000)


def test_what_waits_when_the_robot_is_left_counts_for_nothing() -> None:
    client = new_client()
    client.command(REST, REST, 0)
    client.leave()
    assert (client.view.sent, client.view.out_bytes, sent(client)) == (0, 0, [])
    assert client.hexdigest() == digest([], [])


def test_a_log_begun_anew_has_nothing_to_take_back() -> None:
    client, (ffi, lib) = new_client(), library()
    logs = [ffi.new("uint8_t[]", 4096) for _ in range(4)]
    lib.wheel_client_log(client.handle, logs[0], logs[1], 4096)
    client.command(REST, REST, 0)
    lib.wheel_client_log(client.handle, logs[2], logs[3], 4096)
    client.unsent()
    used = ffi.new("size_t[2]")
    lib.wheel_client_log_take(client.handle, used)
    assert list(used) == [0, 0]


def test_without_a_log_all_else_is_the_same() -> None:
    ffi, lib = library()
    memory = ffi.new("uint64_t[]", lib.wheel_client_size() // 8 + 1)
    bare, client = ffi.cast("wheel_client *", memory), new_client()
    lib.wheel_client_init(bare, m.Mode.SPEED, 0x5A, 1)
    packed = pack(map(codec.encode, [m.Tick(0, 1, 0, m.State.ACTIVE, 1, 0), m.Encoders(1, 2, 3, 4)]))
    for one in (bare, client.handle):
        assert lib.wheel_client_command(one, REST, REST, 0) == 1
        lib.wheel_client_take(one, packed, 0, len(packed), 7)
        lib.wheel_client_estop(one)
    assert bytes(ffi.buffer(lib.wheel_client_view(bare))) == bytes(ffi.buffer(client.view))
