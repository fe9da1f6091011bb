"""What the client of the protocol sends, takes and logs, held against the codec in Python."""

import hashlib
import itertools
import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_protocol import codec
from firmware_protocol.client import Client
from firmware_protocol.extension import library
from firmware_protocol.framing import Frame, pack
from firmware_protocol.generated import messages as m
from firmware_protocol.host_line import HostLine
from hil.core.types import FourWheels
from tests.support.client_rig import digest, feed, new_client, sent, take
from tests.support.examples import share_of_examples
from tests.support.protocol_cases import frames as any_frames

REST = (0.0,) * 4

# Commands

LIMITS = (63.984375, 15.99609375)  # of WHEEL_COMMAND [rad/s], and of torques [N·m]
numbers = (
    st.floats(allow_nan=True, allow_infinity=True, width=64)
    | st.floats(-70.0, 70.0)
    | st.integers(-9000, 9000).map(lambda n: n / 256)
    | st.sampled_from(
        [sign * one for limit in LIMITS for one in (limit, math.nextafter(limit, 99)) for sign in (1, -1)]
    )
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


def filled(left: int) -> Client:
    """Return a client with room for this many bytes more."""
    client, used = new_client(), library()[1].WHEEL_CLIENT_OUT - left
    for _ in range(used % 4):
        client.add(m.Estop.ID, b"\1\0")  # 5 bytes
    for _ in range(used // 4 - used % 4):
        client.add(m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION]))
    assert client.view.out_bytes == used
    return client


@pytest.mark.parametrize(
    ("name", "arguments", "needed", "is_logged"),
    [
        ("command", (REST, REST, 0), 22, True),  # also without torques ahead, so that none is sent alone
        ("request", (m.Request.ARM, 0), 11, True),
        ("step", (5,), 9, True),
        ("step_again", (), 9, False),
        ("add", (m.TimeSyncRequest.ID, b"1", 1), 4, True),
        ("add", (m.HelloRequest.ID, b"1", 1), 4, False),
    ],
)
def test_what_has_no_room_is_refused_and_changes_nothing(
    name: str, arguments: tuple[Any, ...], needed: int, is_logged: bool
) -> None:
    ffi, lib = library()
    call = getattr(lib, f"wheel_client_{name}")
    for left in (needed - 1, needed):
        client = filled(left)
        before = bytes(ffi.buffer(client.view))
        assert (call(client.handle, *arguments) > 0) == (left == needed)
        assert (bytes(ffi.buffer(client.view)) == before) == (left != needed)
        logging, logs = new_client(), [ffi.new("uint8_t[]", left) for _ in range(2)]
        lib.wheel_client_log(logging.handle, *logs, left)
        assert (call(logging.handle, *arguments) > 0) == (left == needed or not is_logged)


@pytest.mark.parametrize(("left", "frames"), [(4, 1), (5, 255)])
def test_an_estop_follows_what_waits_or_takes_its_place(left: int, frames: int) -> None:
    client = filled(left)
    client.estop()
    assert client.view.out_frames == frames
    assert sent(client)[-1] == m.Estop(1, 0)


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


def test_a_wiring_has_each_wheel_once_and_signs_or_changes_nothing() -> None:
    straight = ((0, 1, 2, 3), (1, 1, 1, 1))
    wheels = [(some, straight[1]) for some in itertools.product((0, 1, 2, 3, 4, 255), repeat=4)]
    signs = [(straight[0], some) for some in itertools.product((-128, -2, -1, 0, 1, 2), repeat=4)]
    client, wired = new_client(), library()[1].wheel_client_wire
    for wheel_of, sign_of in wheels + signs:
        is_one = sorted(wheel_of) == [0, 1, 2, 3] and set(sign_of) <= {-1, 1}
        assert wired(client.handle, wheel_of, sign_of) == is_one
        assert not is_one or wired(client.handle, *straight)
        client.command((1.0, 2.0, 3.0, 4.0), REST, 0)
        (command,) = sent(client)
        assert command[:4] == (1.0, 2.0, 3.0, 4.0)
    with pytest.raises(ValueError, match="on the channels"):
        client.wire((0, 1, 2, 2), (1,) * 4)


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


# The log


AHEAD = (0.0, 0.0, 0.0, 0.5)
SENDS: dict[str, Callable[[Client], object]] = {
    "command": lambda client: client.command(REST, REST, 0),
    "command with torques ahead": lambda client: client.command(REST, AHEAD, 0),
    "request": lambda client: client.request(m.Request.IDLE, 0),
    "estop": Client.estop,
    "step": lambda client: client.step(3),
    "step again": Client.step_again,
    "hello": lambda client: client.add(m.HelloRequest.ID, bytes([m.PROTOCOL_VERSION])),
}
NOT_LOGGED = {"step again", "hello"}
turns_of_a_run = st.lists(
    st.tuples(st.lists(any_frames, max_size=8), st.lists(st.sampled_from(list(SENDS)), max_size=8), st.booleans()),
    max_size=12,
)


@given(turns=turns_of_a_run)
def test_the_log_has_every_message_in_order_but_for_hello_repeated_steps_and_what_was_not_sent(turns: list) -> None:
    client = new_client()
    to_robot: list[Frame] = []
    to_host: list[Frame] = []
    for received, sends, arrives in turns:
        take(client, received)
        valid = [frame for frame in received if codec.decode(frame) is not None]
        to_host += [frame for frame in valid if frame.id < m.HelloRequest.ID and frame.id != m.StepDone.ID]
        logged: list[Frame] = []
        for send in sends:
            before = client.view.out_frames
            SENDS[send](client)
            logged += [] if send in NOT_LOGGED else list(client.out())[before:]
        view, waiting = client.view, client.out()
        assert (view.out_frames, view.out_bytes) == (len(list(waiting)), len(waiting.packed))
        assert view.out_serial_bytes == len(HostLine().encode_packed(waiting.packed))
        if arrives:
            to_robot += logged
            client.sent()
        else:
            client.unsent()
    ours = [hashlib.sha256(pack(way)).digest() for way in (to_robot, to_host)]
    assert client.hexdigest() == hashlib.sha256(b"".join(ours)).hexdigest()
    assert client.view.sent == len(to_robot)


@pytest.mark.parametrize(("capacity", "most"), [(131, 3), (132, 3), (133, 4)])
def test_a_log_is_due_from_a_quarter_of_its_room_on(capacity: int, most: int) -> None:
    ffi, lib = library()
    client, logs = new_client(), [ffi.new("uint8_t[]", capacity) for _ in range(2)]
    packed = pack([codec.encode(m.Encoders(1, 2, 3, 4))])  # 11 bytes, as a heartbeat
    for send in (lambda: client.take(packed, 0, 0), lambda: client.request(m.Request.IDLE, 0)):
        lib.wheel_client_log(client.handle, *logs, capacity)
        for count in range(1, most + 1):
            assert not client.view.log_is_due
            send()
            assert client.view.log_is_due == (count == most)


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


def test_a_log_that_was_taken_or_begun_anew_has_nothing_to_take_back() -> None:
    client, (ffi, lib) = new_client(), library()
    logs, used = [ffi.new("uint8_t[]", 4096) for _ in range(4)], ffi.new("size_t[2]")
    lib.wheel_client_log(client.handle, logs[0], logs[1], 4096)
    for forget in (
        lambda: lib.wheel_client_log(client.handle, logs[2], logs[3], 4096),
        lambda: lib.wheel_client_log_take(client.handle, used),
    ):
        client.command(REST, REST, 0)
        forget()
        client.unsent()
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
    lib.wheel_client_unsent(bare)
    lib.wheel_client_log_take(bare, used := ffi.new("size_t[2]"))
    assert list(used) == [0, 0]
